"""Error of depth and velocity that the uncertainty of a calibration causes, common to the pixels of a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Distortion
from scenetruth.capture.calibration.rig_model import INTRINSICS, RigLayout, rotation_matrix

__all__ = ["CommonError", "Moment", "RigGeometry", "common_error", "triangulate"]

Array = NDArray[np.float64]

_MOTION_STEPS = (1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4)
_INTRINSIC_STEPS = (1e-2, 1e-2, 1e-2, 1e-3, 1e-1, 1e-5, 1e-5, 1.0, 1e-3, 1e-1, 1.0)
_STAGE_STEPS = (1e-6, 1e-6, 1e-6, 1e-4, 1e-6)
_ROUNDS = 12
_LEAST_MODE = 1e-6
"""Modes below this fraction of the largest standard deviation are rounding."""


@dataclass(frozen=True, eq=False)
class RigGeometry:
    """Cameras of a rig: intrinsic parameters, centres and rotations.

    ``intrinsics``: f, c_x, c_y, k1, k2, p1, p2, k3, k4, k5, k6.
    ``centres_mm``: Projection centres in the frame of the stage, shape (S, 3).
    ``rotations``: Rotations whose columns are the camera axes, shape (S, 3, 3).
    ``reference``: Index of the camera whose frame is that of the results.
    ``frame``: Centre and rotation of that frame.
    """

    intrinsics: Array
    centres_mm: Array
    rotations: Array
    reference: int
    frame: tuple[Array, Array]

    @classmethod
    def from_values(
        cls, values: Array, layout: RigLayout, positions_mm: Array, reference: int, visits: Array | None = None
    ) -> RigGeometry:
        """Return the geometry of parameters in the order of a layout; ``visits`` adds motions of shape (S, 6)."""
        stage = values[len(INTRINSICS) : layout.first_position]
        motions = values[layout.first_position : layout.first_visit].reshape(-1, 6)
        visits = np.zeros((len(positions_mm), 6)) if visits is None else visits
        axis = np.array([1.0, stage[0], stage[1]])

        def pose(index: int, move: Array) -> tuple[Array, Array]:
            along = positions_mm[index] * (1 + stage[2]) + move[3]
            centre = along * axis + motions[index, 3:] + np.array([0.0, move[4], move[5]])
            return centre, rotation_matrix(motions[index, :3] + move[:3])

        poses = [pose(index, visits[index]) for index in range(len(positions_mm))]
        frame = pose(reference, np.zeros(6))
        return cls(
            values[: len(INTRINSICS)], np.array([each[0] for each in poses]), np.array([each[1] for each in poses]),
            reference, frame,
        )  # fmt: skip

    @property
    def lens(self) -> Distortion:
        """Lens distortion."""
        return Distortion(**dict(zip(INTRINSICS[3:], self.intrinsics[3:].tolist(), strict=True)))

    def rays(self, pixels: Array) -> Array:
        """Return the directions of reference pixels in the frame of the stage, at unit depth; shape (n, 3)."""
        f, c_x, c_y = self.intrinsics[:3]
        normalised = self.lens.undistort((pixels - [c_x, c_y]) / f)
        return np.asarray(np.column_stack([normalised, np.ones(len(pixels))]) @ self.rotations[self.reference].T)

    def project(self, points_mm: Array) -> Array:
        """Return the pixels of points in the frame of the stage, shape (S, n, 2)."""
        f, c_x, c_y = self.intrinsics[:3]
        inside = np.einsum("snj,sjk->snk", points_mm - self.centres_mm[:, None], self.rotations)
        return np.asarray(f * self.lens.distort(inside[..., :2] / inside[..., 2:]) + [c_x, c_y])

    def to_reference(self, points_mm: Array) -> Array:
        """Return points of the frame of the stage in the frame of the reference camera."""
        centre, rotation = self.frame
        return np.asarray((points_mm - centre) @ rotation)

    def to_stage(self, points_mm: Array) -> Array:
        """Return points of the frame of the reference camera in the frame of the stage."""
        centre, rotation = self.frame
        return np.asarray(points_mm @ rotation.T + centre)


def triangulate(rig: RigGeometry, seen: Array, depth_mm: Array) -> Array:
    """Return the points, in the frame of the reference camera, that the cameras see at given pixels.

    The point lies on the ray of the reference camera; its distance minimises the squared residuals of all cameras.

    ``seen``: Pixels in every camera, shape (S, n, 2).
    ``depth_mm``: Start values, shape (n,).
    """
    rays, origin = rig.rays(seen[rig.reference]), rig.centres_mm[rig.reference]
    depth = np.array(depth_mm, dtype=np.float64)
    for _ in range(_ROUNDS):
        step = _depth_step(rig, origin, rays, depth, seen)
        depth += step
        if not (np.abs(step) > 1e-11 * np.abs(depth)).any():
            break
    return rig.to_reference(origin + depth[:, None] * rays)


def _depth_step(rig: RigGeometry, origin: Array, rays: Array, depth: Array, seen: Array) -> Array:
    """Return one Gauss-Newton step of the depths along the rays."""
    change = 1e-5 * depth
    upper = rig.project(origin + (depth + change)[:, None] * rays)
    lower = rig.project(origin + (depth - change)[:, None] * rays)
    slope = (upper - lower) / (2 * change)[:, None]
    residual = seen - rig.project(origin + depth[:, None] * rays)
    return np.asarray((slope * residual).sum(axis=(0, 2)) / (slope**2).sum(axis=(0, 2)))


@dataclass(frozen=True, eq=False)
class CommonError:
    """Covariance of a quantity at n pixels, as modes: the covariance is the sum of their outer products.

    ``modes``: Modes in the unit of the quantity, the largest first, shape (m, n).
    ``covariance``: Covariance, shape (n, n).
    """

    modes: Array
    covariance: Array

    @classmethod
    def from_covariance(cls, covariance: Array) -> CommonError:
        """Return the modes of a covariance: its scaled eigenvectors."""
        values, vectors = np.linalg.eigh(covariance)
        order = np.argsort(-values)
        order = order[values[order] > _LEAST_MODE**2 * float(np.abs(values).max())]
        modes = (vectors[:, order] * np.sqrt(values[order])).T
        signs = np.where(modes.sum(axis=1) < 0, -1.0, 1.0)[:, None]
        return cls(modes * signs, covariance)

    @property
    def std(self) -> Array:
        """Standard deviation of every pixel, shape (n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def mean_std(self) -> float:
        """Standard deviation of the mean over the pixels."""
        return float(np.sqrt(max(self.covariance.mean(), 0.0)))

    @property
    def rest_rms(self) -> float:
        """Root mean square over the pixels of the standard deviation of the departure from the mean."""
        return float(np.sqrt(max(np.diag(self.covariance).mean() - self.covariance.mean(), 0.0)))

    def contrast(self, weights: Array) -> float:
        """Return the standard deviation of a weighted sum over the pixels, for example of a difference."""
        return float(np.sqrt(max(float(weights @ self.covariance @ weights), 0.0)))


@dataclass(frozen=True, eq=False)
class Moment:
    """Points measured at one time, and the visits of the images.

    ``points_mm``: Points in the frame of the reference camera, shape (n, 3).
    ``visits``: Index in the layout of the visit of each position, where the calibration has estimated them, for example
      by a strip; None for new visits, of which only the tolerances are given.
    """

    points_mm: Array
    visits: tuple[int, ...] | None = None


def common_error(
    values: Array, covariance: Array, layout: RigLayout, positions_mm: Array, reference: int,
    moments: Sequence[Moment], *, visit_std: Array | None = None,
) -> tuple[CommonError, CommonError, CommonError]:  # fmt: skip
    """Return the errors of X, Y and Z of points, or of their displacements, that a calibration causes.

    The covariance is J C Jᵀ, where J is the derivative of the triangulation by every parameter.

    ``values``, ``covariance``: Parameters, at least those before the poses, and their covariance.
    ``moments``: Points at one time; or at two times, for the error of the displacement.
    ``visit_std``: Standard deviations of the motions of a visit (rotation vector in rad, offset in mm), which are new
      at every image of a moment without visits, shape (6,); default: none.
    """
    count = len(positions_mm)
    signs = [1.0] if len(moments) == 1 else [-1.0, 1.0]
    bases = [_visit_motions(values, layout, moment, count) for moment in moments]

    def geometry(changed: Array, number: int, motions: Array) -> RigGeometry:
        return RigGeometry.from_values(changed, layout, positions_mm, reference, bases[number] + motions)

    none = np.zeros((count, 6))
    seen = []
    for number, moment in enumerate(moments):
        rig = geometry(values, number, none)
        seen.append(rig.project(rig.to_stage(moment.points_mm)))

    def slope(number: int, step: float, parameter: int | None, visit: tuple[int, int] | None) -> Array:
        """Return the derivative of the points of a moment by a parameter or a motion of a visit, shape (n, 3)."""
        ends = []
        for sign in (step, -step):
            moved, motions = values, none
            if parameter is not None:
                moved = values.copy()
                moved[parameter] += sign
            if visit is not None:
                motions = none.copy()
                motions[visit] = sign
            start = moments[number].points_mm[:, 2]
            ends.append(triangulate(geometry(moved, number, motions), seen[number], start))
        return np.asarray((ends[0] - ends[1]) / (2 * step))

    steps = np.array([*_INTRINSIC_STEPS, *_STAGE_STEPS, *_MOTION_STEPS * layout.positions])
    columns: dict[int, Array] = {}
    for index in range(layout.first_visit):
        if covariance[index, index] > 0:
            parts = [sign * slope(number, steps[index], index, None) for number, sign in enumerate(signs)]
            columns[index] = np.sum(parts, axis=0)
    points = moments[0].points_mm
    total = np.zeros((3, len(points), len(points)))
    for number, (moment, sign) in enumerate(zip(moments, signs, strict=True)):
        for position, motion in np.ndindex(count, 6):
            visit = None if moment.visits is None else layout.first_visit + 6 * moment.visits[position] + motion
            deviation = 0.0 if visit_std is None else float(visit_std[motion])
            if visit is not None and covariance[visit, visit] > 0:
                part = sign * slope(number, _MOTION_STEPS[motion], None, (position, motion))
                columns[visit] = columns[visit] + part if visit in columns else part
            elif visit is None and deviation > 0:
                each = deviation * slope(number, _MOTION_STEPS[motion], None, (position, motion))
                total += np.einsum("ni,mi->inm", each, each)
    chosen = sorted(columns)
    if chosen:
        jacobian = np.array([columns[index] for index in chosen])
        total += np.einsum("pni,pq,qmi->inm", jacobian, covariance[np.ix_(chosen, chosen)], jacobian)
    x, y, z = (CommonError.from_covariance(part) for part in total)
    return x, y, z


def _visit_motions(values: Array, layout: RigLayout, moment: Moment, count: int) -> Array:
    """Return the motions of the visits of a moment, shape (count, 6)."""
    if moment.visits is None:
        return np.zeros((count, 6))
    starts = [layout.first_visit + 6 * visit for visit in moment.visits]
    return np.array([values[start : start + 6] for start in starts])
