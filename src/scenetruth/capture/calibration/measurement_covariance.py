"""Error of depth and velocity that the uncertainty of a calibration causes, common to the pixels of a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Distortion
from scenetruth.capture.calibration.rig_model import INTRINSICS, RigLayout, rotation_matrix

__all__ = [
    "CommonError", "MeasurementSlopes", "Moment", "RigGeometry", "common_error", "moving_point_modes", "point_modes",
    "triangulate",
]  # fmt: skip

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
    ``aspect``: Ratio of the focal lengths along y and x less 1.
    ``centres_mm``: Projection centres in the frame of the stage, shape (S, 3).
    ``rotations``: Rotations whose columns are the camera axes, shape (S, 3, 3).
    ``reference``: Index of the camera whose frame is that of the results.
    ``frame``: Centre and rotation of that frame.
    """

    intrinsics: Array
    aspect: float
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
            values[: len(INTRINSICS)], float(stage[4]), np.array([each[0] for each in poses]),
            np.array([each[1] for each in poses]), reference, frame,
        )  # fmt: skip

    @property
    def lens(self) -> Distortion:
        """Lens distortion."""
        return Distortion(**dict(zip(INTRINSICS[3:], self.intrinsics[3:].tolist(), strict=True)))

    @property
    def _focal_px(self) -> Array:
        """Focal lengths along x and y."""
        return np.array([self.intrinsics[0], (1.0 + self.aspect) * self.intrinsics[0]])

    def rays(self, pixels: Array) -> Array:
        """Return the directions of reference pixels in the frame of the stage, at unit depth; shape (n, 3)."""
        normalised = self.lens.undistort((pixels - self.intrinsics[1:3]) / self._focal_px)
        return np.asarray(np.column_stack([normalised, np.ones(len(pixels))]) @ self.rotations[self.reference].T)

    def project(self, points_mm: Array) -> Array:
        """Return the pixels of points in the frame of the stage, shape (S, n, 2)."""
        inside = np.einsum("snj,sjk->snk", points_mm - self.centres_mm[:, None], self.rotations)
        return np.asarray(self._focal_px * self.lens.distort(inside[..., :2] / inside[..., 2:]) + self.intrinsics[1:3])

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
    slopes = MeasurementSlopes(values, layout, positions_mm, reference, moments)
    columns = {index: slopes.of_parameter(index) for index in range(layout.first_visit) if covariance[index, index] > 0}
    points = moments[0].points_mm
    total = np.zeros((3, len(points), len(points)))
    for number, moment in enumerate(moments):
        for position, motion in np.ndindex(count, 6):
            visit = None if moment.visits is None else layout.first_visit + 6 * moment.visits[position] + motion
            deviation = 0.0 if visit_std is None else float(visit_std[motion])
            if visit is not None and covariance[visit, visit] > 0:
                part = slopes.of_visit(number, position, motion)
                columns[visit] = columns[visit] + part if visit in columns else part
            elif visit is None and deviation > 0:
                each = deviation * slopes.of_visit(number, position, motion)
                total += np.einsum("ni,mi->inm", each, each)
    chosen = sorted(columns)
    if chosen:
        jacobian = np.array([columns[index] for index in chosen])
        total += np.einsum("pni,pq,qmi->inm", jacobian, covariance[np.ix_(chosen, chosen)], jacobian)
    x, y, z = (CommonError.from_covariance(part) for part in total)
    return x, y, z


class MeasurementSlopes:
    """Derivatives of triangulated points, or of their displacements, by the parameters of a rig."""

    def __init__(
        self, values: Array, layout: RigLayout, positions_mm: Array, reference: int, moments: Sequence[Moment]
    ) -> None:
        self.values, self.layout, self.moments = values, layout, moments
        self._rig = (positions_mm, reference)
        self._none = np.zeros((len(positions_mm), 6))
        self._bases = [_visit_motions(values, layout, moment, len(positions_mm)) for moment in moments]
        self._signs = [1.0] if len(moments) == 1 else [-1.0, 1.0]
        self._steps = np.array([*_INTRINSIC_STEPS, *_STAGE_STEPS, *_MOTION_STEPS * layout.positions])
        self._seen = []
        for number, moment in enumerate(moments):
            rig = self._geometry(values, number, self._none)
            self._seen.append(rig.project(rig.to_stage(moment.points_mm)))

    def _geometry(self, changed: Array, number: int, motions: Array) -> RigGeometry:
        positions_mm, reference = self._rig
        return RigGeometry.from_values(changed, self.layout, positions_mm, reference, self._bases[number] + motions)

    def _points(self, number: int, changed: Array, motions: Array) -> Array:
        start = self.moments[number].points_mm[:, 2]
        return triangulate(self._geometry(changed, number, motions), self._seen[number], start)

    def of_parameter(self, index: int) -> Array:
        """Return the derivative by a parameter before those of the visits, shape (n, 3)."""
        step, total = float(self._steps[index]), np.zeros_like(self.moments[0].points_mm)
        for number, sign in enumerate(self._signs):
            ends = []
            for change in (step, -step):
                moved = self.values.copy()
                moved[index] += change
                ends.append(self._points(number, moved, self._none))
            total += sign * (ends[0] - ends[1]) / (2 * step)
        return total

    def of_visit(self, number: int, position: int, motion: int) -> Array:
        """Return the derivative by a motion of the visit of a position at one of the moments, shape (n, 3)."""
        step, ends = _MOTION_STEPS[motion], []
        for change in (step, -step):
            motions = self._none.copy()
            motions[position, motion] = change
            ends.append(self._points(number, self.values, motions))
        return np.asarray(self._signs[number] * (ends[0] - ends[1]) / (2 * step))

    def of_drift(self, position: int, motion: int) -> Array:
        """Return the derivative of the rates of points by the rate of a motion of a position, shape (n, 3).

        The motion of a point is fitted to the images of all positions and frames: the points of a frame are those that
        all cameras see best, without preference for the reference camera.
        """
        rig, points = self._geometry(self.values, 0, self._none), self.moments[0].points_mm
        stage, step = rig.to_stage(points), 1e-4
        ends = [rig.project(stage + change) for each in np.eye(3) for change in (step * each, -step * each)]
        slopes = np.stack([(ends[2 * n] - ends[2 * n + 1]) / (2 * step) for n in range(3)], axis=-1)
        turn, seen = _MOTION_STEPS[motion], []
        for change in (turn, -turn):
            motions = self._none.copy()
            motions[position, motion] = change
            seen.append(self._geometry(self.values, 0, motions).project(stage))
        residual = (seen[1] - seen[0]) / (2 * turn)
        squares = np.einsum("snij,snik->njk", slopes, slopes)
        sums = np.einsum("snij,sni->nj", slopes, residual)
        return np.asarray(np.linalg.solve(squares, sums[..., None])[..., 0] @ rig.frame[1])


def point_modes(
    values: Array, covariance: Array, layout: RigLayout, positions_mm: Array, reference: int, points_mm: Array
) -> Array:
    """Return the independent errors of points that a calibration causes, without new visits, shape (m, n, 3).

    Every mode is the displacement of all points by one standard deviation of an independent combination of parameters:
    the covariance of the points is the sum of the outer products of the modes.

    ``points_mm``: Points in the frame of the reference camera, shape (n, 3).
    """
    slopes = MeasurementSlopes(values, layout, positions_mm, reference, [Moment(points_mm)])
    free = [index for index in range(layout.first_visit) if covariance[index, index] > 0]
    jacobian = np.array([slopes.of_parameter(index) for index in free]).reshape(-1, len(points_mm), 3)
    return _independent(jacobian, covariance[np.ix_(free, free)])


def moving_point_modes(
    values: Array, covariance: Array, layout: RigLayout, positions_mm: Array, reference: int, points_mm: Array,
    visits: NDArray[np.int64],
) -> tuple[Array, Array]:  # fmt: skip
    """Return the independent errors of points, and of their rates per frame, if every visit was estimated.

    Poses are the means of the visits, relative to which the values of the visits are, and errors of the visits that
    change linearly with time are rates of all points. Shapes (m, n, 3) each.

    ``visits``: Indices in the layout of the visits of every position, by frame, shape (S, T) with two frames or more.
    """
    count, frames = visits.shape
    slopes = MeasurementSlopes(values, layout, positions_mm, reference, [Moment(points_mm)])
    times = np.arange(frames) - (frames - 1) / 2
    matrix = np.zeros((layout.first_visit + 6 * count, len(covariance)))
    matrix[np.arange(layout.first_visit), np.arange(layout.first_visit)] = 1.0
    for position, motion in np.ndindex(count, 6):
        columns = layout.first_visit + 6 * visits[position] + motion
        matrix[layout.first_position + 6 * position + motion, columns] = 1 / frames
        matrix[layout.first_visit + 6 * position + motion, columns] = times / (times**2).sum()
    own = matrix @ covariance @ matrix.T
    free = [index for index in range(len(own)) if own[index, index] > 0]
    # Displacements over half the frames are comparable to those of the mean poses.
    span = frames / 2
    jacobian = np.zeros((len(free), 2, len(points_mm), 3))
    for row, index in enumerate(free):
        if index < layout.first_visit:
            jacobian[row, 0] = slopes.of_parameter(index)
        else:
            jacobian[row, 1] = span * slopes.of_drift(*divmod(index - layout.first_visit, 6))
    modes = _independent(jacobian, own[np.ix_(free, free)])
    return modes[:, 0], modes[:, 1] / span


def _independent(jacobian: Array, covariance: Array) -> Array:
    """Return orthogonal combinations of independent errors, the largest first, shape (m, ...), from (p, ...)."""
    if len(jacobian) == 0:
        return jacobian
    # Parameters have different units: they are scaled before their covariance is decomposed.
    scale = np.sqrt(np.diag(covariance))
    powers, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(powers, 0.0))
    flat = (scale[:, None] * root).T @ jacobian.reshape(len(jacobian), -1)
    _, sizes, shapes = np.linalg.svd(flat, full_matrices=False)
    kept = sizes > _LEAST_MODE * sizes.max(initial=0.0)
    return np.asarray((sizes[kept, None] * shapes[kept]).reshape(-1, *jacobian.shape[1:]))


def _visit_motions(values: Array, layout: RigLayout, moment: Moment, count: int) -> Array:
    """Return the motions of the visits of a moment, shape (count, 6)."""
    if moment.visits is None:
        return np.zeros((count, 6))
    starts = [layout.first_visit + 6 * visit for visit in moment.visits]
    return np.array([values[start : start + 6] for start in starts])
