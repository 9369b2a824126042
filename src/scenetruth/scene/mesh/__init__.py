"""Meshes: every kind of shape is a module that holds its model and its maker."""

from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh

__all__ = ["MeshModel", "MeshSize", "TriangleMesh"]
