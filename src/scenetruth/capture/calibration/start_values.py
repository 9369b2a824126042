"""Start values of a calibration: focal length and target poses from homographies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.bundle_adjustment import solve
from scenetruth.capture.calibration.rig_model import (
    INTRINSICS,
    CalibrationError,
    Observations,
    RigGuess,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    project,
)
from scenetruth.errors import Problem

__all__ = ["complete_guess", "fit_homography", "start_state", "with_other_tilts"]

Array = NDArray[np.float64]

_FLAT = 1e-2
"""Largest departure from a plane, relative to the size of the target, for which a homography starts the pose."""
_POSE_ROUNDS = 12
_LEAST_DECREASE = 1e-6
_AMBIGUOUS_TILT = 0.3
"""Angle in rad to the viewing direction below which both tilts of a board have nearly the same image."""


def start_state(given: Observations, priors: RigPriors, guess: RigGuess) -> RigState:
    """Return start values of all parameters: a nominal stage, and the pose of every target from its images."""
    layout = RigLayout.from_observations(given, priors)
    values = np.zeros(layout.size)
    whole = complete_guess(given, guess)
    values[0], values[1:3] = whole.focal_length_px, whole.principal_point_px
    if whole.distortion is not None:
        values[3 : len(INTRINSICS)] = [getattr(whole.distortion, name) for name in INTRINSICS[3:]]
    turns = np.tile(np.eye(3), (len(layout.poses), 1, 1))
    state = RigState(layout, values, turns)
    for number, pose in enumerate(layout.poses):
        views = [view for view in given.views if view.pose == pose]
        state = _place(given, state, number, views)
    return state


def complete_guess(given: Observations, guess: RigGuess) -> RigGuess:
    """Return start values with the image centre and the focal length of the images where they lack them."""
    centre = guess.principal_point_px or ((given.width - 1) / 2, (given.height - 1) / 2)
    focal = guess.focal_length_px or _focal_length(given, np.asarray(centre))
    return guess.model_copy(update={"principal_point_px": centre, "focal_length_px": focal})


def fit_homography(points: Array, pixels: Array) -> Array:
    """Return the homography that maps points (n, 2) to pixels (n, 2): the direct linear transform, normalised."""
    one, to_one = _normalised(points)
    other, to_other = _normalised(pixels)
    zero = np.zeros((len(points), 3))
    ones = np.column_stack([one, np.ones(len(one))])
    upper = np.hstack([ones, zero, -other[:, :1] * ones])
    lower = np.hstack([zero, ones, -other[:, 1:] * ones])
    # The eigenvector of the 9 x 9 matrix is as exact as a start value needs.
    design = np.vstack([upper, lower])
    homography = np.linalg.svd(design, full_matrices=False)[2][-1].reshape(3, 3)
    homography = np.linalg.inv(to_other) @ homography @ to_one
    return np.asarray(homography / np.linalg.norm(homography))


def _normalised(points: Array) -> tuple[Array, Array]:
    mean = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.sqrt(((points - mean) ** 2).sum(axis=1).mean())), 1e-300)
    matrix = np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])
    return (points - mean) * scale, matrix


def _focal_length(given: Observations, centre: Array) -> float:
    """Return the focal length for which all images of planes fit a pinhole (Zhang 2000), centred and undistorted."""
    rows, right = [], []
    for view in given.views:
        if not _is_flat(view):
            continue
        shift = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1]])
        h = shift @ fit_homography(view.points_mm[:, :2], view.pixels)
        h /= np.linalg.norm(h[:2, :2])
        rows += [h[0, 0] * h[0, 1] + h[1, 0] * h[1, 1], (h[:2, 0] ** 2).sum() - (h[:2, 1] ** 2).sum()]
        right += [-h[2, 0] * h[2, 1], h[2, 1] ** 2 - h[2, 0] ** 2]
    over = float(np.dot(rows, right) / np.dot(rows, rows)) if rows else np.nan
    if not over > 0:
        msg = "is not determined by the images: set it from the data sheet, or tilt the board by 35 to 40°"
        raise CalibrationError([Problem("guess.focal_length_px", msg)])
    return float(1 / np.sqrt(over))


def _is_flat(view: TargetView) -> bool:
    return bool(np.ptp(view.points_mm[:, 2]) <= _FLAT * np.ptp(view.points_mm[:, :2]))


def _place(given: Observations, state: RigState, number: int, views: list[TargetView]) -> RigState:
    """Return the state with the pose of one target: the better of two tilts, refined over all images of the pose."""
    layout = state.layout
    start = layout.pose(number)
    free = np.zeros(layout.size, dtype=bool)
    free[start : start + 6] = True
    first = min(views, key=lambda view: (abs(given.positions_mm[view.position]), -len(view.pixels)))
    if not _is_flat(first):
        msg = "is not flat: its pose cannot be started; use points in a plane"
        raise CalibrationError([Problem(f"views.{first.name}.points_mm", msg)])
    chosen = given.selected(views)
    best: tuple[float, RigState] | None = None
    for rotation, translation in _poses(state, first, float(given.positions_mm[first.position])):
        values, turns = state.values.copy(), state.turns.copy()
        turns[number], values[start + 3 : start + 6] = rotation, translation
        candidate, equations, _ = solve(chosen, RigState(layout, values, turns), values, free, _POSE_ROUNDS)
        if best is None or equations.cost < best[0]:
            best = (equations.cost, candidate)
    assert best is not None
    if not np.isfinite(project(chosen, best[1], derivatives=False)[0]).all():
        msg = "shows no possible pose of the target; check the board and the focal length"
        raise CalibrationError([Problem(f"views.{first.name}", msg)])
    return best[1]


def _poses(state: RigState, view: TargetView, x_mm: float) -> list[tuple[Array, Array]]:
    """Return two poses of a plane in one image: that of its homography, and the other with nearly the same image."""
    f, c_x, c_y = state.values[:3]
    plane = view.points_mm[:, 2].mean()
    camera = state.camera(10, 10)
    normalised = camera.ray_directions(view.pixels)[:, :2]
    seen = np.isfinite(normalised).all(axis=1)
    if seen.sum() < 4:
        normalised, seen = (view.pixels - [c_x, c_y]) / f, np.ones(len(view.pixels), dtype=bool)
    h = fit_homography(view.points_mm[seen, :2], normalised[seen])
    h /= np.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1]))
    centroid = np.append(view.points_mm[seen, :2].mean(axis=0), 1.0)
    if (h @ centroid)[2] < 0:
        h = -h
    rotation = np.column_stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])])
    left, _, right = np.linalg.svd(rotation)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    translation = h[:, 2]
    middle = rotation @ np.array([*centroid[:2], 0]) + translation
    flipped = _flipped(rotation, middle)
    moved = np.array([x_mm, 0.0, 0.0])
    pair = []
    for turn in (rotation, flipped):
        shift = middle - turn @ np.array([*centroid[:2], 0]) - turn[:, 2] * plane
        pair.append((turn, shift + moved))
    return pair


def _flipped(rotation: Array, middle: Array) -> Array:
    """Return the rotation with the other tilt: the normal is reflected about the viewing direction of the middle."""
    viewing, normal = middle / np.linalg.norm(middle), rotation[:, 2]
    return _turn_between(normal, 2 * (normal @ viewing) * viewing - normal) @ rotation


def with_other_tilts(given: Observations, state: RigState, start: Array) -> RigState:
    """Return the state after exchanges of the tilts of nearly frontal poses that decrease the cost of all images.

    The tilt of a single image depends on the principal point, which only all images determine.

    ``start``: Prior means, shape (P,).
    """
    layout, free = state.layout, state.layout.std > 0
    state, equations, _ = solve(given, state, start, free)
    cost, before = equations.cost, np.inf
    while cost < before:
        before = cost
        for number, pose in enumerate(layout.poses):
            places = [given.positions_mm[view.position] for view in given.views if view.pose == pose]
            at = layout.pose(number) + 3
            middle = state.values[at : at + 3] - [float(np.mean(places)), 0.0, 0.0]
            rotation = state.turns[number]
            if abs(rotation[:, 2] @ middle) < np.cos(_AMBIGUOUS_TILT) * np.linalg.norm(middle):
                continue
            turns = state.turns.copy()
            turns[number] = _flipped(rotation, middle)
            other, equations, _ = solve(given, RigState(layout, state.values, turns), start, free)
            if equations.cost < cost:
                state, cost = other, equations.cost
        if cost > (1 - _LEAST_DECREASE) * before:
            break
    return state


def _turn_between(one: Array, other: Array) -> Array:
    """Return the rotation that takes one unit vector to another by the shortest turn."""
    axis, cosine = np.cross(one, other), float(one @ other)
    w = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + w + w @ w / max(1 + cosine, 1e-12))
