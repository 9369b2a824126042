"""Suggestions that follow from the covariance of a calibration: poses to add or replace, tolerances that dominate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration import (
    RigCalibration,
    RigFit,
    RigPriors,
    refit,
    rotation_matrix,
)
from scenetruth.capture.calibration.added_poses import (
    advised_tilts,
    covariance_with_pose,
    describe_pose,
    place_pose,
    tilt_of,
)
from scenetruth.capture.report.error_budget import CORNERS, POSES, VISITS, DepthBudget, depth_grid, depth_slopes
from scenetruth.threads import with_one_blas_thread

__all__ = ["BoardCoverage", "PoseEffect", "Suggestion", "assess_poses", "cover", "place_targets", "suggest"]

Array = NDArray[np.float64]

_DEPTH_SHARE = 0.05
_FEWEST_POINTS = 6
_CELLS = (4, 3)  # columns and rows of parts of the image
_NOTABLE = 0.02
_MOST = 4


@dataclass(frozen=True)
class PoseEffect:
    """A pose of the board and its effect.

    ``tilt_deg``: Angle between the normal of the board and the optical axis.
    ``farther``: Edge or corner of the board that is farther away; empty for a frontal board.
    ``depth_mm``: Distance of its centre.
    ``images``, ``points``, ``rms_px``: Images used, their points, and their residuals.
    ``without_mm``: Standard deviation of the mean depth without the pose; NaN if the others determine too little.
    """

    pose: int
    tilt_deg: float
    farther: str
    depth_mm: float
    images: int
    points: int
    rms_px: float
    without_mm: float


@dataclass(frozen=True)
class Suggestion:
    """A change, and the standard deviation of the mean depth with it in mm."""

    text: str
    after_mm: float


@dataclass(frozen=True, eq=False)
class BoardCoverage:
    """Parts of the image and of the depth range in which points of the board were seen.

    ``counts``: Number of points in every part of the image, shape (rows, columns).
    ``share``: Area of the convex hull of the points, as a share of the image.
    ``depth_mm``: Smallest and largest distance of a point.
    """

    counts: NDArray[np.int64]
    share: float
    depth_mm: tuple[float, float]

    def words(self, surface_mm: tuple[float, float] | None) -> list[str]:
        """Return what is not covered; ``surface_mm`` is the depth range of the measured surface."""
        found = [f"Points of the board surround {100 * self.share:.0f} % of the image."]
        rows, columns = self.counts.shape
        empty = [
            " ".join(dict.fromkeys((_name(row, rows, ("upper", "middle", "lower")), _name(column, columns, _SIDES))))
            for row, column in np.argwhere(self.counts < _FEWEST_POINTS).tolist()
        ]
        if empty:
            found.append(f"No points of the board in parts of the image: {', '.join(dict.fromkeys(empty))}.")
        low, high = self.depth_mm
        text = f"Points of the board lie between {low:.0f} and {high:.0f} mm"
        if surface_mm is None:
            return [*found, f"{text}."]
        near, far = surface_mm
        outside = near < low - 1e-9 or far > high + 1e-9
        range_text = f"the surface between {near:.0f} and {far:.0f} mm"
        tail = f", {range_text}" + (": take poses at its whole range." if outside else ".")
        return [*found, text + tail]


_SIDES = ("left", "centre left", "centre right", "right")


def _name(place: int, count: int, names: tuple[str, ...]) -> str:
    return names[place * len(names) // count]


def cover(fit: RigFit) -> BoardCoverage:
    """Return which parts of image and depth range the boards of a fit cover."""
    from scipy.spatial import ConvexHull

    given = fit.given
    pixels = np.concatenate([view.pixels for view in given.views if view.target == 0])
    columns, rows = _CELLS
    column = np.clip(pixels[:, 0] / given.width * columns, 0, columns - 1).astype(int)
    row = np.clip(pixels[:, 1] / given.height * rows, 0, rows - 1).astype(int)
    counts = np.zeros((rows, columns), dtype=np.int64)
    np.add.at(counts, (row, column), 1)
    depths = np.concatenate(
        [place[:, 2] for place, view in zip(place_targets(fit), given.views, strict=True) if view.target == 0]
    )
    share = float(ConvexHull(pixels).volume) / (given.width * given.height)
    return BoardCoverage(counts, share, (float(depths.min()), float(depths.max())))


def place_targets(fit: RigFit) -> list[Array]:
    """Return the points of every view in the frame of the stage in mm, each of shape (n, 3)."""
    found = []
    for view in fit.given.views:
        rotation, centre = place_pose(fit.state, view.pose)
        found.append(view.points_mm @ rotation.T + centre)
    return found


@with_one_blas_thread
def assess_poses(
    fit: RigFit, priors: RigPriors, calibration: RigCalibration, budget: DepthBudget
) -> tuple[PoseEffect, ...]:
    """Return the poses of the board, and the error of the depth without each of them."""
    mean_std = _mean_std(calibration, budget)
    found = []
    for pose in fit.state.layout.poses:
        views = [view for view in fit.given.views if view.pose == pose]
        if not views or any(view.target != 0 for view in views):
            continue
        others = [view for view in fit.given.views if view.pose != pose]
        rest = refit(fit.given.selected(others), fit, priors) if others else None
        rotation, centre = place_pose(fit.state, pose)
        names = {view.name for view in views}
        used = [view for view in fit.views if view.name in names]
        points = sum(view.points for view in used)
        squares = sum(view.points * view.rms_px**2 for view in used)
        tilt, farther = tilt_of(rotation)
        found.append(
            PoseEffect(
                pose, tilt, farther, float(centre[2]), len(views), points, float(np.sqrt(squares / max(points, 1))),
                np.nan if rest is None else mean_std(rest.state.layout.names, fit.scale * fit.widened(rest.covariance)),
            )
        )  # fmt: skip
    return tuple(found)


def _mean_std(calibration: RigCalibration, budget: DepthBudget) -> Callable[[Sequence[str], Array], float]:
    """Return a function from a covariance and its names to the standard deviation of the mean depth."""
    slopes, _ = depth_slopes(calibration, depth_grid(calibration), budget.depth_mm)
    means = np.array([values.mean() for values in slopes.values()])
    visits = budget.total.mean_std**2 - budget.calibration.mean_std**2

    def std(names: Sequence[str], covariance: Array) -> float:
        places = {name: index for index, name in enumerate(names)}
        rows = [places[name] for name in slopes]
        return float(np.sqrt(max(means @ covariance[np.ix_(rows, rows)] @ means + visits, 0.0)))

    return std


@with_one_blas_thread
def suggest(
    fit: RigFit, priors: RigPriors, calibration: RigCalibration, budget: DepthBudget, poses: tuple[PoseEffect, ...]
) -> list[Suggestion]:
    """Return changes that reduce the error of the depth, the most effective first."""
    before = budget.total.mean_std
    found = [
        Suggestion(_halve(part.title), part.halved_mm)
        for part in budget.parts
        if part.halved_mm < (1 - _NOTABLE) * before
    ]
    found += _best_pose(fit, priors, calibration, budget)
    known = [pose for pose in poses if np.isfinite(pose.without_mm)]
    found = sorted(found, key=lambda one: one.after_mm)[:_MOST]
    if len(known) > 3:
        least = min(known, key=lambda pose: pose.without_mm)
        text = f"Pose {least.pose} contributes least: replace this pose first"
        found.append(Suggestion(text, least.without_mm))
    return found


def _halve(title: str) -> str:
    if title == CORNERS:
        return "Halve the noise of the detected points: more light, a sharper image, or four times as many images"
    if title == POSES:
        return "Halve the errors of whole images: stiff board at rest, fixed focus, even light, or four times the poses"
    if title == VISITS:
        return "Halve the repeatability of the stage in the measurement, or add a fiducial strip"
    return f"Halve the tolerance of: {title}"


def _best_pose(fit: RigFit, priors: RigPriors, calibration: RigCalibration, budget: DepthBudget) -> list[Suggestion]:
    """Return the pose of the board whose images would reduce the error most."""
    boards = [view for view in fit.given.views if view.target == 0]
    centres = np.array([place_pose(fit.state, pose)[1] for pose in dict.fromkeys(view.pose for view in boards)])
    middle = np.median(centres, axis=0)
    mean_std = _mean_std(calibration, budget)
    tilts = advised_tilts(8)
    found: list[tuple[float, Array, Array]] = [
        (mean_std(*covariance_with_pose(fit, priors, rotation_matrix(tilt), middle)), tilt, middle) for tilt in tilts
    ]
    _, tilt, _ = min(found, key=lambda each: each[0])
    for share in (-_DEPTH_SHARE, _DEPTH_SHARE):
        centre = middle * (1 + share)
        found.append((mean_std(*covariance_with_pose(fit, priors, rotation_matrix(tilt), centre)), tilt, centre))
    after, tilt, centre = min(found, key=lambda each: each[0])
    if not after < (1 - _NOTABLE / 2) * budget.total.mean_std:
        return []
    _, farther = tilt_of(rotation_matrix(tilt))
    return [Suggestion(f"Add a pose {describe_pose(float(centre[2]), farther)}", after)]
