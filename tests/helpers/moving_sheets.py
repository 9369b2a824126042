"""Sheets to be moved, and derivatives of maps by central differences in extended precision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.built_scene import SceneBody
from scenetruth.scene.deformation import DeformationModel, Surroundings
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.motion import MotionModel, PointMap
from scenetruth.scene.reference_configuration import SheetConfiguration
from scenetruth.scene.taylor import Jet
from scenetruth.scene.texture import SurfaceTexture

LENGTH, WIDTH = 40.0, 24.0
HOUR = Surroundings((0.0, LENGTH), 3600.0)
"""A leaf of 40 mm, one frame an hour."""


def sheet(columns: int, rows: int, length: float = LENGTH, width: float = WIDTH) -> SheetConfiguration:
    """A flat sheet from X = 0 to its length, Y to either side, whose faces point to -Z."""
    a, b = np.meshgrid(np.linspace(0, length, columns + 1), np.linspace(-width / 2, width / 2, rows + 1))
    number = np.arange(a.size).reshape(a.shape)
    corner, right, below, across = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate([np.stack(part, axis=-1).reshape(-1, 3) for part in _halves(corner, right, below, across)])
    return SheetConfiguration(np.stack([a.ravel(), b.ravel()], axis=1), faces.astype(np.int32))


def _halves(corner: Any, right: Any, below: Any, across: Any) -> tuple[tuple[Any, ...], ...]:
    return (corner, below, right), (right, below, across)


def body(start: SheetConfiguration, maps: Sequence[PointMap]) -> SceneBody:
    texture: SurfaceTexture = None  # type: ignore[assignment]
    flat = start.material_mm
    chart = flat[start.faces]
    mesh = TriangleMesh(np.column_stack([flat, np.zeros(len(flat))]), start.faces, chart, material_mm=flat)
    return SceneBody("leaf", mesh, start, chart, texture, maps)


def made(entry: Any, around: Surroundings = HOUR) -> PointMap:
    """The map of a motion, about the point (1, -2, 3) mm, or of a deformation."""
    if isinstance(entry, DeformationModel):
        return entry.point_map(around)
    motion: MotionModel = entry
    return motion.point_map((1.0, -2.0, 3.0))


def positions(maps: Sequence[PointMap], points: NDArray[Any], t: Any) -> NDArray[Any]:
    """Positions in the precision of the points, shape (n, 3)."""
    fields: Any = tuple(np.ascontiguousarray(points.T))
    time = np.array([t], dtype=points.dtype)
    for item in maps:
        fields = item(fields, time)
    return np.stack([np.broadcast_to(field, (len(points),)) for field in fields], axis=1)


def differences(maps: Sequence[PointMap], points: NDArray[np.float64], t: float, exponent: int = 6) -> tuple[Any, Any]:
    """Velocity and acceleration from central differences of positions in 80 bits, three steps extrapolated to zero.

    ``exponent``: Of the largest step, 2^-exponent frames. What remains is of the order step^6 = 4e-15 of the sixth
    derivative for the smallest step of the default, for the acceleration also rounding of 1e-19 / step^2 = 7e-15 of the
    positions.
    """
    start, centre = points.astype(np.longdouble), np.longdouble(t)

    def at(time: Any) -> Any:
        return positions(maps, start, time)

    here = at(centre)
    steps = [np.longdouble(2.0 ** -(exponent + n)) for n in range(3)]
    first = [(at(centre + h) - at(centre - h)) / (2 * h) for h in steps]
    second = [(at(centre + h) - 2 * here + at(centre - h)) / h**2 for h in steps]
    return _extrapolated(first), _extrapolated(second)


def _extrapolated(estimates: list[Any]) -> Any:
    one, two, three = estimates
    coarse, fine = (4 * two - one) / 3, (4 * three - two) / 3
    return (16 * fine - coarse) / 15


def surface(maps: Sequence[PointMap], a: NDArray[np.float64], b: NDArray[np.float64], t: float) -> list[Jet]:
    """The coordinates of a flat sheet's points as jets in t, a, b."""
    time = Jet.variable(np.array([t]), 0, 3)
    fields: Any = (Jet.variable(a, 1, 3), Jet.variable(b, 2, 3), Jet.constant(np.zeros_like(a), 3))
    for item in maps:
        fields = item(fields, time)
    return [Jet(np.array(np.broadcast_to(field.coefficients, (10, len(a))))) for field in fields]


def metric(fields: list[Jet]) -> NDArray[np.float64]:
    """E, F, G of a surface, shape (3, n)."""
    one, two = (np.stack([field.first(index) for field in fields]) for index in (1, 2))
    return np.stack([(one * one).sum(0), (one * two).sum(0), (two * two).sum(0)])
