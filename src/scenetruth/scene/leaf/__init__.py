"""Leaves: outline, mesh, veins and texture."""

from scenetruth.scene.leaf.leaf_mesh import LeafMesh, LeafShape
from scenetruth.scene.leaf.leaf_model import LeafForm
from scenetruth.scene.leaf.margin import (
    SHIFTS,
    compute_entire_margin,
    compute_half_width_mm,
    compute_margin,
    solve_shift,
)
from scenetruth.scene.leaf.texture_synthesis import LeafTexture
from scenetruth.scene.leaf.veins import make_main_veins, make_side_veins

__all__ = [
    "SHIFTS", "LeafForm", "LeafMesh", "LeafShape", "LeafTexture", "compute_entire_margin", "compute_half_width_mm",
    "compute_margin", "make_main_veins", "make_side_veins", "solve_shift",
]  # fmt: skip
