"""Rigs drawn from their prior distributions, with exact projections of a board and Gaussian noise of the corners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import StageErrors
from scenetruth.capture.calibration import (
    CalibrationTarget,
    CommonError,
    Moment,
    Observations,
    RigCalibration,
    RigFit,
    RigGeometry,
    RigGuess,
    RigLayout,
    RigPriors,
    RigSolution,
    RigState,
    TargetView,
    adjust,
    common_error,
    describe_fit,
    project,
    rotation_matrix,
    start_state,
    triangulate,
)

__all__ = ["DrawnRig", "assess_draw", "board_points", "depth_errors", "described", "draw_rig", "fit_draw", "summarise"]

Array = NDArray[np.float64]

TRUE_INTRINSICS = (5016.0, 331.7, 228.4, -0.6, 8.0, 1e-3, -8e-4, 0.0, 0.0, 0.0, 0.0)
SIZE = (640, 480)
SCREW = RigPriors(errors=StageErrors(preset="screw_stage", backlash_um=0.0))
BOARD = CalibrationTarget(half_width_mm=36.0, scale_std=1e-4, warp_mm=0.02)


@dataclass(frozen=True, eq=False)
class DrawnRig:
    """A rig with its true parameters and noisy observations."""

    observations: Observations
    truth: RigState
    priors: RigPriors


def board_points(columns: int = 11, rows: int = 8, square_mm: float = 6.0) -> Array:
    """Return the inner corners of a checkerboard about its centre, shape (n, 3)."""
    u = (np.arange(columns) - (columns - 1) / 2) * square_mm
    v = (np.arange(rows) - (rows - 1) / 2) * square_mm
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return np.column_stack([grid, np.zeros(len(grid))])


def draw_rig(
    seed: int,
    *,
    poses: int = 12,
    positions: int = 5,
    noise_px: float = 0.01,
    tilt_deg: tuple[float, float] = (33.0, 42.0),
    priors: RigPriors = SCREW,
    board: CalibrationTarget = BOARD,
    points: Array | None = None,
    scale_error: float | None = None,
) -> DrawnRig:
    """Return a rig whose errors are drawn from the prior distributions; every fourth pose is tilted by up to 10°."""
    generator = np.random.default_rng([seed, 37])
    x_mm = np.array([5.0 * (s - (positions - 1) // 2) for s in range(positions)])
    points = board_points() if points is None else points
    empty = np.zeros((len(points), 2))
    covariance = np.tile(noise_px**2 * np.eye(2), (len(points), 1, 1))
    views = tuple(
        TargetView(f"p{pose}_s{s}", s, pose * positions + s, pose, points, empty, covariance)
        for pose in range(poses)
        for s in range(positions)
    )
    given = Observations(*SIZE, x_mm, (board,), views, (positions - 1) // 2)
    layout = RigLayout.from_observations(given, priors)
    values = np.zeros(layout.size)
    drawn = np.isfinite(layout.std) & (layout.std > 0)
    values[drawn] = layout.std[drawn] * generator.standard_normal(int(drawn.sum()))
    values[:11] = TRUE_INTRINSICS
    if scale_error is not None:
        values[layout.first_target] = scale_error
    turns = np.empty((poses, 3, 3))
    for pose in range(poses):
        tilt = np.deg2rad(generator.uniform(*tilt_deg) if pose % 4 else generator.uniform(0, min(10.0, tilt_deg[1])))
        about = generator.uniform(0, 2 * np.pi)
        axis = tilt * np.array([np.cos(about), np.sin(about), 0.0])
        spin = np.array([0.0, 0.0, generator.uniform(-0.3, 0.3)])
        turns[pose] = rotation_matrix(axis) @ rotation_matrix(spin)
        start = layout.pose(pose)
        # The board's centre stays near the axis, so that the corners lie in all images.
        values[start + 3 : start + 6] = [generator.uniform(-3, 3), generator.uniform(-3, 3), 660]
        values[start + 5] += generator.uniform(-35, 35)
    truth = RigState(layout, values, turns)
    exact, _ = project(given, truth, derivatives=False)
    seen, start = [], 0
    for view in views:
        pixels = exact[start : start + len(points)]
        start += len(points)
        outside = np.asarray(((pixels <= 6) | (pixels >= np.array(SIZE) - 7)).any(axis=1))
        noisy = pixels + noise_px * generator.standard_normal(pixels.shape)
        seen.append(replace(view, pixels=noisy).without(outside))
    return DrawnRig(given.selected(seen), truth, priors)


def depth_errors(truth: RigState, estimate: RigState, given: Observations, grid: Array, depth_mm: float) -> Array:
    """Return the error of the depth at reference pixels of a frontal plane, calibration alone; shape (n,)."""
    layout, shared = truth.layout, (given.positions_mm, given.reference)
    exact = RigGeometry.from_values(truth.values, layout, *shared)
    fitted = RigGeometry.from_values(estimate.values, layout, *shared)
    rays = exact.lens.undistort((grid - exact.intrinsics[1:3]) / exact.intrinsics[0])
    points = depth_mm * np.column_stack([rays, np.ones(len(grid))])
    seen = exact.project(exact.to_stage(points))
    return np.asarray(triangulate(fitted, seen, points[:, 2])[:, 2] - points[:, 2])


DEPTH_MM = 660.0
PARAMETERS = {"f": "f", "c_x": "c_x", "c_y": "c_y", "axis y": "axis_y", "axis z": "axis_z", "step": "step_scale"}
_NORMAL_95 = 1.959964


def grid_pixels(columns: int = 5, rows: int = 4) -> NDArray[np.float64]:
    """Return reference pixels over the whole image, row by row, shape (n, 2)."""
    x, y = np.linspace(0, SIZE[0] - 1, columns), np.linspace(0, SIZE[1] - 1, rows)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def patterns(grid: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return weights over the grid by name; each weighted sum of depth errors is one figure."""
    n = len(grid)
    x, y = grid[:, 0] - grid[:, 0].mean(), grid[:, 1] - grid[:, 1].mean()
    corners = [int(np.argmin((grid - corner) ** 2 @ [1, 1])) for corner in ((0, 0), (SIZE[0], 0), (0, SIZE[1]), SIZE)]
    pixel = np.eye(n)
    found = {"mean depth": np.full(n, 1 / n), "depth of a pixel": pixel[n // 2]}
    found["tilt along x"], found["tilt along y"] = x / (x**2).sum() * SIZE[0] / 2, y / (y**2).sum() * SIZE[1] / 2
    for name, index in zip(("upper left", "upper right", "lower left", "lower right"), corners, strict=True):
        found[f"{name} corner less mean"] = pixel[index] - 1 / n
    found["left less right"] = pixel[corners[0]] - pixel[corners[1]]
    return found


def described(fit: RigFit, priors: RigPriors) -> RigCalibration:
    """Return the calibration of a fit."""
    return describe_fit(RigSolution(fit, priors, (), fit.given))


def fit_draw(rig: DrawnRig, **options: Any) -> RigFit:
    """Return the fit of a drawn rig, from a focal length with an error of 0.5 %."""
    state = start_state(rig.observations, rig.priors, RigGuess(focal_length_px=5040.0))
    return adjust(rig.observations, state, **options)


def assess_draw(rig: DrawnRig, fit: RigFit) -> dict[str, tuple[float, float]]:
    """Return error and stated standard deviation by name."""
    truth, layout, given = rig.truth, fit.state.layout, rig.observations
    covariance = fit.widened(fit.covariance)
    std = dict(zip(layout.names, np.sqrt(np.diag(covariance)), strict=True))
    found = {name: (fit.state.value(key) - truth.value(key), float(std[key])) for name, key in PARAMETERS.items()}
    grid = grid_pixels()
    errors = depth_errors(truth, fit.state, given, grid, DEPTH_MM)
    rays = fit.state.camera(*SIZE).ray_directions(grid)
    stated: CommonError = common_error(
        fit.state.values, covariance, layout, given.positions_mm, given.reference, [Moment(DEPTH_MM * rays)]
    )[2]
    for name, weights in patterns(grid).items():
        found[name] = (float(weights @ errors), stated.contrast(weights))
    return found


def summarise(draws: Sequence[Mapping[str, tuple[float, float]]]) -> list[tuple[str, float, float, float]]:
    """Return name, standard deviation of z about 0, share within 95 % bars, and median stated deviation."""
    rows = []
    for name in draws[0]:
        error, std = np.array([draw[name] for draw in draws]).T
        z = error / std
        rows.append(
            (name, float(np.sqrt((z**2).mean())), float((np.abs(z) < _NORMAL_95).mean()), float(np.median(std)))
        )
    return rows
