"""Normals of the smooth surface that a mesh stands for, while it moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.jets import Jet
from scenetruth.scene.jets.slots import A, B
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.motion import PointMap, apply
from scenetruth.scene.surface.start import RestStart, Start, start_of

__all__ = ["corner_normals"]

Floats = NDArray[np.float64]


def corner_normals(mesh: TriangleMesh, start: Start, maps: Sequence[PointMap], t: float) -> Floats:
    """Return the unit normals of the smooth surface at the corners of all faces at time t (in frames).

    They are those of the surface's derivatives, whose error falls with the square of the triangles' size. Normals that
    came with the mesh turn with the surface from where it is at rest: the little by which they differ from the
    derivatives' there, they keep.

    Parameters
    ----------
    mesh
        The mesh at rest.
    start
        Where its points are before anything moves them.
    maps
        How it is deformed, placed and moved, first applied first.
    t
        Time in frames.

    Returns
    -------
    numpy.ndarray
        Of either sense, shape (m, 3, 3); NaN where the derivatives along the surface are parallel.
    """
    moved = _frames(start, maps, t)[start.corners]
    if mesh.corner_normals is None:
        return moved[:, :, 2]
    rest_start = start if isinstance(start, RestStart) else start_of(mesh)
    rest = _frames(rest_start, (), t)[rest_start.corners]
    turned: Floats = np.einsum("mcij,mcik,mck->mcj", moved, rest, mesh.corner_normals)
    return np.where(np.isfinite(turned).all(axis=2, keepdims=True), turned, moved[:, :, 2])


def _frames(start: Start, maps: Sequence[PointMap], t: float) -> Floats:
    """Return right-handed frames (along a, across, normal) of all surface points, rows of shape (k, 3, 3)."""
    time = Jet.variable(np.array([float(t)]), 0, 3)
    points = start.surface(time)
    shape = points[0].coefficients.shape
    fields = [np.broadcast_to(field.coefficients, shape) for field in apply(maps, points, time)]
    one, two = (np.stack([field[slot] for field in fields], axis=1) for slot in (A, B))
    normal = np.cross(one, two)
    with np.errstate(divide="ignore", invalid="ignore"):
        one = one / np.linalg.norm(one, axis=1, keepdims=True)
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([one, np.cross(normal, one), normal], axis=1)
