"""Projection model of a camera on its stage: parameters, prior standard deviations, observations and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera import Camera, Distortion, StageErrors
from scenetruth.capture.calibration.rig_kernels import project_views
from scenetruth.errors import ArgumentError, Problem
from scenetruth.validated_model import Finite, FrozenModel, NonNegative, Positive

__all__ = [
    "BENDS", "INTRINSICS", "SAME_POINT_MM", "STAGE", "CalibrationError", "CalibrationTarget", "Observations",
    "RigGuess", "RigLayout", "RigPriors", "RigState", "TargetView", "project", "rotation_matrix",
]  # fmt: skip

Array = NDArray[np.float64]

INTRINSICS = ("f", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Intrinsic parameters in their order."""


class CalibrationError(ArgumentError):
    """Observations, images or files that do not make a calibration; lists every problem.

    See Also
    --------
    scenetruth.capture.calibration.calibrate : Raises it.

    Examples
    --------
    >>> from scenetruth.capture.calibration import RigCalibration, CalibrationError
    >>> try:
    ...     RigCalibration.load("no_such_file.yaml")
    ... except CalibrationError as error:
    ...     print(error.source)
    no_such_file.yaml
    """

    _noun = "calibration"
    _of = "in"


STAGE = ("axis_y", "axis_z", "step_scale", "backlash", "aspect")
MOTION = ("pitch", "yaw", "roll", "x", "y", "z")
_TARGET = ("scale", "warp_uu", "warp_uv", "warp_vv")
_BEND = ("bend_uu", "bend_uv", "bend_vv", "bend_uuu", "bend_uuv", "bend_uvv", "bend_vvv")
BENDS = len(_BEND)
_OF_POSE, _OF_POINT = 6 + BENDS, 3
_SIZE_OF_VIEW = 45  # parameters of a view besides the deviations of its points
SAME_POINT_MM = 1e-6
_LEAST_POINTS = 4


class CalibrationTarget(FrozenModel):
    """Tolerances of a calibration target: a board, or a fiducial strip fixed in the scene."""

    name: str = "board"
    """Name in messages and parameter names."""
    half_width_mm: Positive = 30.0
    """Half of the larger side of the target in mm, the unit of length of the warp."""
    scale_std: NonNegative = 1e-3
    """Standard deviation of the relative scale: 1e-3 for a print, 1e-4 for a measured board; 0 for an exact scale."""
    warp_mm: NonNegative = 0.02
    """Standard deviation of each quadratic coefficient of the flatness error, in mm at the half width."""
    bend_mm: NonNegative = 0.0
    """The same of a bend of degree 2 and 3 that is new in every pose, of a board that is held by hand."""
    point_mm: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    """Standard deviations of the deviations of each point in the plane of the target and along its normal, in mm."""


class RigPriors(FrozenModel):
    """Prior standard deviations of the stage and the camera; 0 fixes a parameter at its nominal value."""

    errors: StageErrors = Field(default_factory=lambda: StageErrors(preset="screw_stage"))
    """Errors of the guide, which repeat at every visit, and repeatability and backlash of the moves."""
    visit_errors: StageErrors = Field(default_factory=StageErrors)
    """Angles and straightness that are new at every visit of a position."""
    strip_errors: StageErrors | None = None
    """The same at visits that show a strip, by which they are determined; null: those of other visits."""
    step_std: NonNegative = 1e-4
    """Standard deviation of the relative length of the steps."""
    axis_rad: NonNegative = 5e-3
    """Standard deviation of either angle between the stage axis and the X axis of the camera, in rad."""
    position_um: NonNegative = 0.2
    """Standard deviation along X of each position in µm, without what the repeatability and the backlash add."""
    intrinsics: dict[str, Positive] = Field(default_factory=dict)
    """Standard deviations of intrinsic parameters about their start values, by name; others have no prior."""
    free_distortion: Annotated[tuple[str, ...], Field(max_length=9)] = ("k1", "k2", "p1", "p2")
    """Estimated coefficients of the distortion; the others keep their start values. ``aspect`` is the ratio of the
    focal lengths along y and x less 1.
    """

    @property
    def guide_std(self) -> list[float]:
        """Standard deviations of the pose of a position: rotation vector in rad, and offset in mm."""
        moves = self.errors
        turns = [1e-6 * value for value in (moves.pitch_urad, moves.yaw_urad, moves.roll_urad)]
        return turns + [1e-3 * value for value in (self.position_um, moves.straightness_um, moves.straightness_um)]

    @property
    def visit_std(self) -> list[float]:
        """Standard deviations of what a visit adds to the pose of its position."""
        return self._fresh_std(self.visit_errors)

    @property
    def strip_visit_std(self) -> list[float]:
        """Standard deviations of what a visit that shows a strip adds to the pose of its position."""
        return self._fresh_std(self.visit_errors if self.strip_errors is None else self.strip_errors)

    def _fresh_std(self, fresh: StageErrors) -> list[float]:
        turns = [1e-6 * value for value in (fresh.pitch_urad, fresh.yaw_urad, fresh.roll_urad)]
        along = 1e-3 * float(np.hypot(self.errors.repeatability_um, fresh.repeatability_um))
        return [*turns, along, 1e-3 * fresh.straightness_um, 1e-3 * fresh.straightness_um]


@dataclass(frozen=True, eq=False)
class TargetView:
    """Detected points of a target in one image.

    ``name``: Name of the image in messages.
    ``position``: Index of the stage position, from 0.
    ``visit``: Number of the stage move that reached the position; images of one visit share it.
    ``pose``: Number of the pose of the target; images with the target in one place share it.
    ``points_mm``: Points (u, v, w) of the target, shape (n, 3).
    ``pixels``: Detected positions, shape (n, 2).
    ``covariance_px2``: Covariance of each detected position, shape (n, 2, 2).
    ``target``: Index of the target.
    ``direction``: Direction of the move that reached the position: 1 towards +X, -1 towards -X, 0 if unknown.
    """

    name: str
    position: int
    visit: int
    pose: int
    points_mm: Array
    pixels: Array
    covariance_px2: Array
    target: int = 0
    direction: int = 1

    def without(self, excluded: NDArray[np.bool_]) -> TargetView:
        """Return the view without the marked points."""
        kept = ~excluded
        return replace(
            self,
            points_mm=self.points_mm[kept],
            pixels=self.pixels[kept],
            covariance_px2=self.covariance_px2[kept],
        )


@dataclass(frozen=True, eq=False)
class Observations:
    """Views of targets from a camera on a stage, in the order in which they were recorded.

    ``width``, ``height``: Image size in px.
    ``positions_mm``: Nominal X of every stage position in mm, shape (S,).
    ``targets``: Targets and their tolerances.
    ``views``: Detected points of every image.
    ``reference``: Index of the position whose camera frame is that of the results.
    """

    width: int
    height: int
    positions_mm: Array
    targets: tuple[CalibrationTarget, ...]
    views: tuple[TargetView, ...]
    reference: int

    def __post_init__(self) -> None:
        problems = list(_problems_of(self))
        if problems:
            raise CalibrationError(problems)

    def selected(self, views: Sequence[TargetView]) -> Observations:
        """Return the observations with other views."""
        return replace(self, views=tuple(views))

    @cached_property
    def points_mm(self) -> Array:
        """Target points of all views, shape (n, 3)."""
        return np.ascontiguousarray(np.concatenate([view.points_mm for view in self.views]), dtype=np.float64)

    @cached_property
    def pixels(self) -> Array:
        """Detected positions of all views, shape (n, 2)."""
        return np.concatenate([view.pixels for view in self.views])

    @cached_property
    def whitening(self) -> Array:
        """Matrices W with Wᵀ W = C⁻¹ for each detected position, shape (n, 2, 2)."""
        covariance = np.concatenate([view.covariance_px2 for view in self.views])
        return np.linalg.inv(np.linalg.cholesky(covariance))

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """Index of the first point of each view, then the number of points."""
        return np.cumsum([0, *(len(view.pixels) for view in self.views)], dtype=np.int64)


def _problems_of(given: Observations) -> list[Problem]:
    """Return the problems of the arrays and indices of observations."""
    problems = []
    if not given.views:
        return [Problem("views", "are missing: no image shows a target; check the board and the images")]
    positions = np.asarray(given.positions_mm, dtype=np.float64)
    if positions.ndim != 1 or not np.isfinite(positions).all():
        problems.append(Problem("positions_mm", "must be a list of finite numbers", given.positions_mm))
    elif len(positions) > 1 and np.diff(np.sort(positions)).min() < 1e-6:
        problems.append(Problem("positions_mm", "coincide: list each position once", positions.tolist()))
    if not 0 <= given.reference < len(positions):
        problems.append(Problem("reference", f"must be an index below {len(positions)}", given.reference))
    names = [target.name for target in given.targets]
    if len(set(names)) < len(names):
        problems.append(Problem("targets", "must have different names", names))
    places: dict[int, int] = {}
    for view in given.views:
        if places.setdefault(view.visit, view.position) != view.position:
            message = f"visit {view.visit} is at the positions {places[view.visit]} and {view.position}; number it anew"
            problems.append(Problem(f"views.{view.name}.visit", message))
        count = len(view.pixels)
        path = f"views.{view.name}"
        if view.points_mm.shape != (count, 3) or view.pixels.shape != (count, 2):
            shapes = (view.points_mm.shape, view.pixels.shape)
            problems.append(Problem(path, "points_mm and pixels must have shapes (n, 3) and (n, 2)", shapes))
            continue
        if count < _LEAST_POINTS:
            problems.append(Problem(path, f"must have at least {_LEAST_POINTS} points; leave the image out", count))
        if not 0 <= view.position < len(positions):
            problems.append(Problem(path, f"position must be an index below {len(positions)}", view.position))
        if not 0 <= view.target < len(given.targets):
            problems.append(Problem(path, f"target must be an index below {len(given.targets)}", view.target))
        if min(view.visit, view.pose) < 0:
            problems.append(Problem(path, "visit and pose must not be negative", (view.visit, view.pose)))
        covariance = view.covariance_px2
        if covariance.shape != (count, 2, 2):
            problems.append(Problem(path, "covariance_px2 must have shape (n, 2, 2)", covariance.shape))
        elif count and not is_covariance(covariance):
            problems.append(Problem(path, "covariance_px2 must be symmetric and positive definite"))
        if not (np.isfinite(view.pixels).all() and np.isfinite(view.points_mm).all()):
            problems.append(Problem(path, "points must be finite; leave missing points out"))
    return problems


def is_covariance(matrices: Array) -> bool:
    """Return whether symmetric 2 x 2 matrices, shape (n, 2, 2), are finite and positive definite."""
    a, b, c, d = (matrices[:, i, j] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
    if not np.isfinite(matrices).all():
        return False
    return bool((a > 0).all() and (np.abs(b - c) <= 1e-9 * (a + d)).all() and (a * d - b * c > 0).all())


@dataclass(frozen=True, eq=False)
class RigLayout:
    """Places of the parameters in one vector, their names and prior standard deviations."""

    positions: int
    visits: tuple[int, ...]
    targets: int
    poses: tuple[int, ...]
    std: Array
    """Prior standard deviations: infinite without a prior, 0 for a fixed parameter."""
    names: tuple[str, ...]
    points: tuple[dict[tuple[int, ...], int], ...] = field(default=(), repr=False)
    """For each target, the offset of each point that has deviations, by its place."""

    @classmethod
    def from_observations(cls, given: Observations, priors: RigPriors) -> RigLayout:
        """Return the layout for observations and priors."""
        visits = tuple(sorted({view.visit for view in given.views}))
        poses = tuple(sorted({view.pose for view in given.views}))
        names, std = [*INTRINSICS, *STAGE], []
        for name in INTRINSICS:
            free = name in ("f", "c_x", "c_y") or name in priors.free_distortion
            std.append(priors.intrinsics.get(name, np.inf) if free else 0.0)
        std += [priors.axis_rad, priors.axis_rad, priors.step_std, 1e-3 * priors.errors.backlash_um]
        std += [np.inf if "aspect" in priors.free_distortion else 0.0]
        guide, anew, seen = priors.guide_std, priors.visit_std, priors.strip_visit_std
        with_strip = {view.visit for view in given.views if view.target > 0}
        for index in range(len(given.positions_mm)):
            names += [f"position[{index}].{name}" for name in MOTION]
            std += guide
        for visit in visits:
            names += [f"visit[{visit}].{name}" for name in MOTION]
            std += seen if visit in with_strip else anew
        for target in given.targets:
            names += [f"{target.name}.{name}" for name in _TARGET]
            std += [target.scale_std, *(target.warp_mm,) * 3]
        shown = {view.pose: given.targets[view.target] for view in given.views}
        for pose in poses:
            names += [f"pose[{pose}].{name}" for name in (*MOTION, *_BEND)]
            std += [*[np.inf] * 6, *[shown[pose].bend_mm] * BENDS]
        points: list[dict[tuple[int, ...], int]] = []
        for index, target in enumerate(given.targets):
            points.append({})
            if not any(target.point_mm):
                continue
            places = {place for view in given.views if view.target == index for place in _places(view)}
            for number, place in enumerate(sorted(places)):
                points[-1][place] = len(names)
                names += [f"{target.name}.point[{number}].{name}" for name in "uvw"]
                std += [target.point_mm[0], *target.point_mm]
        return cls(
            len(given.positions_mm), visits, len(given.targets), poses, np.array(std), tuple(names), tuple(points)
        )

    @property
    def first_position(self) -> int:
        """Offset of the first position."""
        return len(INTRINSICS) + len(STAGE)

    @property
    def first_visit(self) -> int:
        """Offset of the first visit."""
        return self.first_position + 6 * self.positions

    @property
    def first_target(self) -> int:
        """Offset of the first target."""
        return self.first_visit + 6 * len(self.visits)

    @property
    def first_pose(self) -> int:
        """Offset of the first pose; parameters before it describe the rig and the targets, without their points."""
        return self.first_target + 4 * self.targets

    def pose(self, number: int) -> int:
        """Return the offset of a pose by its index in ``poses``: rotation vector, translation, bend."""
        return self.first_pose + _OF_POSE * number

    @property
    def first_point(self) -> int:
        """Offset of the deviations of the points."""
        return self.pose(len(self.poses))

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.names)

    def offsets(self, views: Sequence[TargetView]) -> NDArray[np.int64]:
        """Return the offsets of position, visit, target and pose of each view, shape (views, 4)."""
        visits = {visit: number for number, visit in enumerate(self.visits)}
        poses = {pose: number for number, pose in enumerate(self.poses)}
        rows = [
            (
                self.first_position + 6 * view.position,
                self.first_visit + 6 * visits[view.visit],
                self.first_target + 4 * view.target,
                self.pose(poses[view.pose]),
            )
            for view in views
        ]
        return np.array(rows, dtype=np.int64)

    def columns(self, views: Sequence[TargetView]) -> NDArray[np.int64]:
        """Return the parameters of the derivatives of each view but those by its points, shape (views, 45)."""
        common, sizes = np.arange(self.first_position), (6, 6, 4, _OF_POSE)
        rows = [
            np.concatenate([common, *(start + np.arange(size) for start, size in zip(row, sizes, strict=True))])
            for row in self.offsets(views)
        ]
        return np.array(rows, dtype=np.int64)

    def point_columns(self, view: TargetView) -> NDArray[np.int64]:
        """Return the parameters of the deviations of the points of a view, shape (points or 0, 3)."""
        offsets = self.points[view.target] if self.points else {}
        if not offsets:
            return np.empty((0, 3), dtype=np.int64)
        return np.array([offsets[place] for place in _places(view)])[:, None] + np.arange(3)

    def gather(self, given: Observations, slopes: Array, other: Array) -> Array:
        """Return the sums over the points of the products of derivatives (n, 2, 48) with columns (n, 2, m): (P, m)."""
        found, columns = np.zeros((self.size, other.shape[2])), self.columns(given.views)
        for number, view in enumerate(given.views):
            part = slice(given.first[number], given.first[number + 1])
            block = slopes[part, :, :_SIZE_OF_VIEW].reshape(-1, _SIZE_OF_VIEW)
            found[columns[number]] += block.T @ other[part].reshape(-1, other.shape[2])
            points = self.point_columns(view)
            if len(points):
                found[points] += np.einsum("nij,nik->njk", slopes[part, :, _SIZE_OF_VIEW:], other[part])
        return found

    def information(self, given: Observations, slopes: Array) -> Array:
        """Return the sums over the points of the products of derivatives (n, 2, 48) with themselves: (P, P)."""
        found, columns = np.zeros((self.size, self.size)), self.columns(given.views)
        for number, view in enumerate(given.views):
            rows, points = slopes[given.first[number] : given.first[number + 1]], self.point_columns(view)
            block = rows[:, :, :_SIZE_OF_VIEW].reshape(-1, _SIZE_OF_VIEW)
            found[np.ix_(columns[number], columns[number])] += block.T @ block
            if len(points):
                single = rows[:, :, _SIZE_OF_VIEW:]
                cross = np.einsum("nij,nik->njk", single, rows[:, :, :_SIZE_OF_VIEW]).reshape(-1, _SIZE_OF_VIEW)
                found[np.ix_(points.ravel(), columns[number])] += cross
                found[np.ix_(columns[number], points.ravel())] += cross.T
                found[points[:, :, None], points[:, None, :]] += np.einsum("nij,nik->njk", single, single)
        return found


def _places(view: TargetView) -> list[tuple[int, ...]]:
    """Return the places of the points of a view on its target, in units in which they are whole numbers."""
    return [tuple(place) for place in np.rint(view.points_mm / SAME_POINT_MM).astype(np.int64).tolist()]


@dataclass(frozen=True, eq=False)
class RigState:
    """Values of all parameters; rotations of targets are relative to reference rotations.

    ``values``: Parameters in the order of the layout; the rotation vectors of the poses are zero between iterations.
    ``turns``: Reference rotation of each pose, shape (poses, 3, 3).
    """

    layout: RigLayout
    values: Array
    turns: Array = field(repr=False)

    def value(self, name: str) -> float:
        """Return the value of a parameter."""
        return float(self.values[self.layout.names.index(name)])

    def moved(self, step: Array) -> RigState:
        """Return the state after a step of all parameters, with the rotations of the poses absorbed."""
        values, turns = self.values + step, self.turns.copy()
        for number in range(len(self.layout.poses)):
            start = self.layout.pose(number)
            turns[number] = rotation_matrix(values[start : start + 3]) @ turns[number]
            values[start : start + 3] = 0.0
        return RigState(self.layout, values, turns)

    def camera(self, width: int, height: int) -> Camera:
        """Return the camera with its lens distortion."""
        f, c_x, c_y, *coefficients = (float(value) for value in self.values[: len(INTRINSICS)])
        named = dict(zip(INTRINSICS[3:], coefficients, strict=True))
        lens = Distortion(**named) if any(coefficients) else None
        return Camera(width=width, height=height, focal_length_px=f, principal_point_px=(c_x, c_y), distortion=lens)


def project(given: Observations, state: RigState, *, derivatives: bool) -> tuple[Array, Array]:
    """Return the pixels of all points, shape (n, 2), and their derivatives, shape (n or 0, 2, 48)."""
    numbers = {pose: number for number, pose in enumerate(state.layout.poses)}
    turns = state.turns[[numbers[view.pose] for view in given.views]]
    travel = np.array([(given.positions_mm[view.position], view.direction) for view in given.views], dtype=np.float64)
    half = np.array([given.targets[view.target].half_width_mm for view in given.views])
    pixels = np.empty((len(given.points_mm), 2))
    slopes = np.empty((len(given.points_mm) if derivatives else 0, 2, _SIZE_OF_VIEW + _OF_POINT))
    offsets = state.layout.offsets(given.views)
    points = given.points_mm
    if any(state.layout.points):
        moves = [state.values[state.layout.point_columns(view)] for view in given.views]
        points = points + np.concatenate(
            [
                move if len(move) else np.zeros((len(view.pixels), 3))
                for move, view in zip(moves, given.views, strict=True)
            ]
        )
    project_views(points, given.first, offsets, state.values, np.ascontiguousarray(turns), travel, half, pixels, slopes)
    return pixels, slopes


def rotation_matrix(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector in rad."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


class RigGuess(FrozenModel):
    """Start values of the intrinsic parameters."""

    focal_length_px: Positive | None = None
    """Focal length, for example from data sheets; null: from the images."""
    principal_point_px: tuple[Finite, Finite] | None = None
    """Principal point; null: the image centre."""
    distortion: Distortion | None = None
    """Distortion; null: none."""
