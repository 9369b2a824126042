"""Leaves: outline, mesh, veins and texture."""

from scenetruth.scene.leaf.leaf_model import LeafForm

__all__ = ["LeafForm"]
