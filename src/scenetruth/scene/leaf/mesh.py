"""Leaves as meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.leaf.form import LeafForm
from scenetruth.scene.leaf.outline import entire_margin
from scenetruth.scene.leaf.shape import shape_of
from scenetruth.scene.leaf.sheet import leaf_sheet
from scenetruth.scene.mesh import MeshSize, TriangleMesh

__all__ = ["LeafMesh"]

# The teeth and the triangles along the margin leave about so much of the area to equal triangles (measured).
_MORE_FACES = 0.98
_MARGIN_POINTS, _SKETCHED_POINTS = 400, 48


class LeafMesh(LeafForm):
    """A leaf: X along the midrib from the base (the origin) to the tip, Y across, upper side towards -Z.

    In the flat it is a sheet with coordinates (a, b) in mm; undulation, fold, bending across and bending along give
    it its form, in this order.
    """

    kind: Literal["leaf"]
    """``leaf``."""

    def size(self, folder: Path) -> MeshSize:
        """Return about how large the mesh will be, by the area of the leaf; see `MeshModel`."""
        a, b = entire_margin(self, _MARGIN_POINTS).T
        area = 2 * abs(float(np.trapezoid(b, a)))
        if self.petiole is not None:
            area += self.petiole.length_mm * self.petiole.diameter_mm
        faces = int(_MORE_FACES * area / (np.sqrt(3) / 4 * self.resolution_mm**2)) + 2
        return MeshSize(faces // 2 + 2 * int(self.length_mm / self.resolution_mm) + 2, faces)

    def sketch(self, folder: Path, most_faces: int) -> TriangleMesh:
        """Return strips between midrib and margin, without teeth; see `MeshModel`."""
        rim = entire_margin(self, _MARGIN_POINTS)
        rim = rim[np.unique(np.linspace(0, len(rim) - 1, _SKETCHED_POINTS).astype(np.int64))]
        if self.petiole is not None:
            stalk = np.array([[-self.petiole.length_mm, self.petiole.diameter_mm / 2]])
            rim = np.concatenate([stalk, rim])
        middle = np.column_stack([rim[:, 0], np.zeros(len(rim))])
        material = np.concatenate([middle, rim, rim * (1, -1)])
        count = len(rim)
        here = np.arange(count - 1)
        halves = []
        for side, turned in ((count, False), (2 * count, True)):
            # Positive areas turn from a to b, as of the mesh itself.
            one = np.column_stack([here, here + 1, side + here + 1])
            two = np.column_stack([here, side + here + 1, side + here])
            faces = np.concatenate([one, two])
            halves.append(faces if turned else faces[:, ::-1])
        return self._mesh(material, np.concatenate(halves).astype(np.int32))

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the leaf; its chart is the flat sheet itself, petiole included, and an image covers the blade.

        Raises
        ------
        SceneError
            If its margin meets itself; paths count from the mesh.
        """
        return self._mesh(*leaf_sheet(self))

    def _mesh(self, material: NDArray[np.float64], faces: NDArray[np.int32]) -> TriangleMesh:
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
            source=self,
        )
