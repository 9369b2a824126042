"""Poses of a board that a calibration lacks: the covariance with one more pose, and advice from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.bundle_adjustment import RigFit, build_equations
from scenetruth.capture.calibration.rig_model import (
    Observations,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    project,
    rotation_matrix,
)
from scenetruth.number_format import format_two_digits
from scenetruth.threads import with_one_blas_thread

__all__ = [
    "ADVISED_TILT_DEG", "advise_pose", "advised_tilts", "covariance_with_pose", "describe_pose", "place_pose",
    "tilt_of",
]  # fmt: skip

Array = NDArray[np.float64]

ADVISED_TILT_DEG = 37.0
_DIRECTIONS = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")
"""Edges and corners of the board, clockwise from the right."""
_EDGE_PX = 4.0
_FEWEST_POINTS = 6
_TILTED_DEG, _TILTED = 25.0, 3
"""Tilt that determines the focal length, and the number of poses with it that are enough."""
_GAIN = 2.0
"""Ratio of the standard deviations of the focal length without and with one more pose, from which it is advised: five
poses that are tilted by 37° have 1.3, three 1.5, and frontal poses 5 to 12.
"""


@with_one_blas_thread
def advise_pose(fit: RigFit, priors: RigPriors) -> str:
    """Return the advice to add a pose, if it would halve the uncertainty of the focal length; else an empty string."""
    poses = list(dict.fromkeys(view.pose for view in fit.given.views if view.target == 0))
    placed = [place_pose(fit.state, pose) for pose in poses]
    tilts = [tilt_of(rotation)[0] for rotation, _ in placed]
    if sum(tilt > _TILTED_DEG for tilt in tilts) >= _TILTED:
        return ""
    index = fit.state.layout.names.index("f")
    before = float(np.sqrt(fit.stated_covariance[index, index]))
    centre = np.median([place for _, place in placed], axis=0)
    found = []
    for tilt in advised_tilts(4):
        names, covariance = covariance_with_pose(fit, priors, rotation_matrix(tilt), centre)
        place = names.index("f")
        found.append((float(np.sqrt(covariance[place, place])), tilt_of(rotation_matrix(tilt))[1]))
    after, farther = min(found)
    if not after * _GAIN < before:
        return ""
    relative = 100 * before / fit.state.value("f")
    return (
        f"the poses of the board ({len(poses)}, tilted by up to {max(tilts):.0f}°) determine the focal length to "
        f"{format_two_digits(before)} px ({format_two_digits(relative)} %): a pose "
        f"{describe_pose(float(centre[2]), farther)}, reduces it to "
        f"{format_two_digits(after)} px"
    )


def advised_tilts(count: int) -> list[Array]:
    """Return rotation vectors of boards tilted in directions around the optical axis."""
    angles = np.arange(count) * 2 * np.pi / count
    return [np.deg2rad(ADVISED_TILT_DEG) * np.array([np.cos(a), np.sin(a), 0.0]) for a in angles]


def describe_pose(depth_mm: float, farther: str) -> str:
    """Return an advised pose in words."""
    part = "corner" if " " in farther else "edge"
    return (
        f"at {depth_mm:.0f} mm, tilted by {ADVISED_TILT_DEG:.0f}° with the {farther} {part} of the board farther away"
    )


def place_pose(state: RigState, pose: int) -> tuple[Array, Array]:
    """Return rotation and centre of a pose of a target in the frame of the stage."""
    number = state.layout.poses.index(pose)
    start = state.layout.names.index(f"pose[{pose}].pitch")
    turn = rotation_matrix(state.values[start : start + 3]) @ state.turns[number]
    return turn, state.values[start + 3 : start + 6]


def tilt_of(rotation: Array) -> tuple[float, str]:
    """Return the tilt of a board in degrees, and which edge of it is farther away."""
    normal = rotation[:, 2] * np.sign(rotation[2, 2])
    tilt = float(np.rad2deg(np.arccos(np.clip(normal[2], -1, 1))))
    # On the plane, z grows against the components of the normal.
    return tilt, "" if tilt < 3 else _direction(-normal[:2])


def _direction(vector: Array) -> str:
    return _DIRECTIONS[round(float(np.arctan2(vector[1], vector[0])) / (np.pi / 4)) % 8]


def covariance_with_pose(fit: RigFit, priors: RigPriors, rotation: Array, centre: Array) -> tuple[Sequence[str], Array]:
    """Return names and covariance of the parameters with images of one more pose at all positions."""
    given, state = fit.given, fit.state
    boards = [view for view in given.views if view.target == 0]
    points = np.unique(np.round(np.concatenate([view.points_mm for view in boards]), 9), axis=0)
    noise = float(np.median(np.concatenate([view.covariance_px2[:, (0, 1), (0, 1)] for view in boards])))
    pose, visit = max(view.pose for view in given.views) + 1, max(view.visit for view in given.views) + 1
    covariance = np.tile(noise * np.eye(2), (len(points), 1, 1))
    views = [
        TargetView(f"new {s}", s, visit + s, pose, points, np.zeros((len(points), 2)), covariance)
        for s in range(len(given.positions_mm))
    ]
    wider = given.selected([*given.views, *views])
    layout = RigLayout.from_observations(wider, priors)
    places = {name: index for index, name in enumerate(state.layout.names)}
    values = np.array([state.values[places[name]] if name in places else 0.0 for name in layout.names])
    start = layout.names.index(f"pose[{pose}].pitch")
    values[start + 3 : start + 6] = centre
    turns = np.array([
        state.turns[state.layout.poses.index(one)] if one in state.layout.poses else rotation for one in layout.poses
    ])  # fmt: skip
    moved = RigState(layout, values, turns)
    pixels = project(wider, moved, derivatives=False)[0]
    seen = []
    for number, view in enumerate(wider.views):
        if view.pose != pose:
            seen.append(view)
            continue
        shown = pixels[wider.first[number] : wider.first[number + 1]]
        inside = (shown > _EDGE_PX) & (shown < np.array([given.width, given.height]) - 1 - _EDGE_PX)
        kept = replace(view, pixels=shown).without(np.asarray(~inside.all(axis=1)))
        if len(kept.pixels) >= _FEWEST_POINTS:
            seen.append(kept)
    if len(seen) == len(given.views):
        return state.layout.names, fit.stated_covariance
    return layout.names, fit.scale * fit.widened(_posterior(fit, replace(wider, views=tuple(seen)), moved))


def _posterior(fit: RigFit, given: Observations, state: RigState) -> Array:
    """Return the covariance of all parameters at a state."""
    free = state.layout.std > 0
    start = np.zeros(state.layout.size)
    count = fit.state.layout.first_position
    start[:count] = fit.start[:count]
    equations = build_equations(given, state, start, free)
    total = equations.information + np.diag(1 / state.layout.std[free] ** 2)
    scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    # More images than those of a fit that is determined.
    inverse = np.linalg.inv(total * scale[:, None] * scale)
    covariance = np.zeros((state.layout.size,) * 2)
    covariance[np.ix_(free, free)] = inverse * scale[:, None] * scale
    return covariance
