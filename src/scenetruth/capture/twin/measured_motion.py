"""Motion of a twin: the simplest of translation, rigid motion, affine motion and a smooth field that fits a surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.twin.measured_surface import smooth_map

__all__ = ["MeasuredMotion", "fit_motion"]

Floats = NDArray[np.float64]
MotionType = Literal["static", "translation", "rigid", "affine", "field"]

_MOST_MEAN_SQUARE = 1.2
_MOST_EXCESS = 1.1
_LEAST_PIXELS = 50
_PARAMETERS = {"static": 0, "translation": 3, "rigid": 6, "affine": 12}
_CORRELATED_PX, _LEAST_GAIN = 450.0, 3.0


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """Velocity field of one surface, in the world frame.

    ``kind``: Type of the motion. ``centre_mm``: Mean of the points of the fit.
    ``translation``: Velocity of the centre in mm per frame.
    ``gradient``: Velocity gradient per frame, shape (3, 3): antisymmetric for a rigid motion.
    ``mean_square``: Mean square of the residuals in standard deviations.
    ``field``: Velocity on the canvas in mm per frame, shape (3, h, w), for the type ``field``.
    """

    kind: MotionType
    centre_mm: Floats
    translation: Floats
    gradient: Floats
    mean_square: float = float("nan")
    field: Floats | None = None

    def velocity(self, points_mm: Floats) -> Floats:
        """Return the velocity at points on the canvas, shape (h, w, 3), in mm per frame."""
        if self.field is not None:
            return np.moveaxis(self.field, 0, -1)
        return np.asarray(self.translation + (points_mm - self.centre_mm) @ self.gradient.T)

    def positions(self, points_mm: Floats, velocity: Floats, t: float) -> Floats:
        """Return where points of t = 0 are at a time in frames, shape (n, 3).

        ``velocity``: Velocity of the points at t = 0, shape (n, 3).
        """
        if self.kind in ("static", "translation", "field"):
            return np.asarray(points_mm + t * velocity)
        from scipy.linalg import expm

        offset = points_mm - self.centre_mm
        return np.asarray(self.centre_mm + offset @ expm(t * self.gradient).T + t * self.translation)

    def to_entries(self) -> list[dict[str, Any]] | None:
        """Return the motion entries of a scene file; None if the motion needs positions of all vertices."""
        if self.kind == "static":
            return []
        if self.kind in ("affine", "field"):
            return None
        entries: list[dict[str, Any]] = []
        turn = np.array([self.gradient[2, 1], self.gradient[0, 2], self.gradient[1, 0]])
        angle = float(np.linalg.norm(turn))
        if self.kind == "rigid" and angle > 0:
            entries.append(
                {
                    "kind": "rotation",
                    "axis": (turn / angle).tolist(),
                    "rate_deg_per_frame": float(np.rad2deg(angle)),
                    "point_mm": self.centre_mm.tolist(),
                }
            )
        entries.append({"kind": "velocity", "velocity_mm_per_frame": self.translation.tolist()})
        return entries


def fit_motion(points_mm: Floats, velocity: Floats | None, std: Floats | None) -> MeasuredMotion:
    """Fit the simplest motion that agrees with measured velocities within their standard deviations.

    A motion with more parameters is taken if it fits better than by chance. A smooth field is taken if the mean square
    of the residuals of the best is above 1.2, and by more than 10 % above that of the field.

    ``points_mm``: Points of the canvas, shape (h, w, 3); ``velocity``, ``std``: Shape (3, h, w), NaN where invalid.
    """
    still = MeasuredMotion("static", np.zeros(3), np.zeros(3), np.zeros((3, 3)))
    if velocity is None:
        return still
    valid = np.asarray(np.isfinite(velocity).all(axis=0) & np.isfinite(points_mm).all(axis=-1))
    if valid.sum() < _LEAST_PIXELS:
        return still
    deviation = _usable_std(velocity, std, valid)
    points, rates, weight = points_mm[valid], velocity[:, valid].T, 1 / deviation[:, valid].T
    centre = points.mean(axis=0)
    smooth = np.stack(
        [smooth_map(np.where(valid, each, np.nan), scale) for each, scale in zip(velocity, deviation, strict=True)]
    )
    least = float(np.mean(((rates - smooth[:, valid].T) * weight) ** 2))
    limit = max(_MOST_MEAN_SQUARE, _MOST_EXCESS * least)
    fits: tuple[tuple[MotionType, Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]], ...]
    fits = (("translation", _fit_translation), ("rigid", _fit_rigid), ("affine", _fit_affine))
    best: MeasuredMotion | None = None
    for kind, fit in fits:
        translation, gradient = fit(points - centre, rates, weight)
        residual = rates - translation - (points - centre) @ gradient.T
        found = MeasuredMotion(kind, centre, translation, gradient, float(np.mean((residual * weight) ** 2)))
        if best is None or _improves(best, found, rates.size):
            best = found
    assert best is not None
    if best.mean_square <= limit:
        return best
    return MeasuredMotion("field", centre, rates.mean(axis=0), np.zeros((3, 3)), least, smooth)


def _improves(simple: MeasuredMotion, other: MeasuredMotion, values: int) -> bool:
    """Return whether a motion with more parameters fits better than by chance.

    The sum of squares over independent values, of which a window of 6 px has one for each component, falls by the
    number of parameters by chance; three times as much is required.
    """
    if simple.mean_square <= 0:
        return False
    gain = (simple.mean_square - other.mean_square) * values / _CORRELATED_PX / max(1.0, other.mean_square)
    return gain > _LEAST_GAIN * (_PARAMETERS[other.kind] - _PARAMETERS[simple.kind])


def _usable_std(velocity: Floats, std: Floats | None, valid: NDArray[np.bool_]) -> Floats:
    """Return standard deviations without zeros and gaps."""
    found = np.empty(velocity.shape)
    for number in range(3):
        given = None if std is None else std[number]
        good = valid if given is None else valid & np.isfinite(given) & (given > 0)
        if given is None or not good.any():
            found[number] = max(float(np.std(velocity[number][valid])), 1e-9)
            continue
        typical = float(np.median(given[good]))
        found[number] = np.where(good, np.maximum(np.where(good, given, 1.0), 0.3 * typical), typical)
    return found


def _fit_translation(offset: Floats, rates: Floats, weight: Floats) -> tuple[Floats, Floats]:
    return np.asarray((rates * weight**2).sum(axis=0) / (weight**2).sum(axis=0)), np.zeros((3, 3))


def _fit_rigid(offset: Floats, rates: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return velocity and antisymmetric gradient by least squares."""
    x, y, z = offset.T
    zero = np.zeros_like(x)
    rows = (
        np.stack([zero, z, -y], axis=-1),
        np.stack([-z, zero, x], axis=-1),
        np.stack([y, -x, zero], axis=-1),
    )
    normal, right = np.zeros((6, 6)), np.zeros(6)
    for number, turn in enumerate(rows):
        matrix = np.column_stack([np.tile(np.eye(3)[number], (len(x), 1)), turn]) * weight[:, number, None]
        normal += matrix.T @ matrix
        right += matrix.T @ (rates[:, number] * weight[:, number])
    found = np.asarray(np.linalg.lstsq(normal, right, rcond=1e-10)[0], dtype=np.float64)
    a, b, c = found[3:]
    return found[:3], np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def _fit_affine(offset: Floats, rates: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return velocity and gradient by least squares; gradients along the normal of a plane are least."""
    matrix = np.column_stack([np.ones(len(offset)), offset])
    found = np.empty((4, 3))
    for number in range(3):
        scaled = matrix * weight[:, number, None]
        size = np.maximum(np.sqrt((scaled**2).sum(axis=0)), 1e-300)
        found[:, number] = np.linalg.lstsq(scaled / size, rates[:, number] * weight[:, number], rcond=1e-3)[0] / size
    return found[0], found[1:].T.copy()
