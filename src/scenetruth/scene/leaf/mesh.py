"""Leaves as meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from scenetruth.scene.leaf.form import LeafForm
from scenetruth.scene.leaf.outline import entire_margin
from scenetruth.scene.leaf.shape import shape_of
from scenetruth.scene.leaf.sheet import leaf_sheet
from scenetruth.scene.mesh import TriangleMesh

__all__ = ["LeafMesh"]


class LeafMesh(LeafForm):
    """A leaf: X along the midrib from the base (the origin) to the tip, Y across, upper side towards -Z.

    In the flat it is a sheet with coordinates (a, b) in mm; undulation, fold, bending across and bending along give
    it its form, in this order.
    """

    kind: Literal["leaf"]
    """``leaf``."""

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the leaf; its chart is the flat sheet itself, petiole included, and an image covers the blade.

        Raises
        ------
        SceneError
            If its margin meets itself; paths count from the mesh.
        """
        material, faces = leaf_sheet(self)
        shape = shape_of(self)
        a, b = material.T
        vertices = np.column_stack(shape((a, b, np.zeros_like(a)), np.zeros(1)))
        behind, half = float(entire_margin(self)[:, 0].min()), self.full_width_mm / 2
        image = (material - (behind, -half)) / (self.length_mm - behind, 2 * half)
        return TriangleMesh(
            vertices,
            faces,
            chart_mm=material[faces],
            uv=image[faces],
            crease_deg=60.0,
            material_mm=material,
            shape=shape,
        )
