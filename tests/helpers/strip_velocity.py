"""Velocity of points that a drawn rig sees at visits which a fiducial strip has measured, with its stated errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import StageErrors
from scenetruth.capture import RigCalibration, add_calibration_errors, region_mean
from scenetruth.capture.calibration import (
    CalibrationTarget,
    RigGeometry,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    calibrate,
    project,
    rotation_matrix,
)
from scenetruth.capture.rectification import ideal_principal_point, step_factor
from tests.helpers.drawn_rigs import DrawnRig, draw_rig

__all__ = ["velocity_errors"]

Array = NDArray[np.float64]

FRAMES, POSITIONS = 5, 5
TIMES = np.arange(FRAMES) - (FRAMES - 1) / 2
VELOCITY = np.array([0.3, -0.2, 0.5])
DEPTH_MM = 660.0
STRIP = CalibrationTarget(name="strip", half_width_mm=45.0, scale_std=1e-4, warp_mm=0.0)
ANEW = RigPriors(
    errors=StageErrors(preset="screw_stage", backlash_um=0.0),
    visit_errors=StageErrors(pitch_urad=20, yaw_urad=20, roll_urad=20, straightness_um=1, repeatability_um=1),
)
# Every 40th pixel of 640 x 480.
COLUMNS, ROWS = np.arange(20, 640, 40), np.arange(20, 480, 40)


def velocity_errors(seed: int) -> dict[str, tuple[float, float]]:
    """Return the error of mean velocities, and of a difference, and their stated standard deviations."""
    rig = draw_rig(seed, poses=6, priors=ANEW)
    views, motions = _strip_views(rig, seed)
    fit = calibrate(rig.observations, guess=5040.0, priors=ANEW, strip=STRIP, strip_views=views)
    first = views[0].visit
    listed = tuple(tuple(first + position * FRAMES + t for t in range(FRAMES)) for position in range(POSITIONS))
    found = replace(fit, measured_visits=listed).measured()
    errors = _fitted_velocity(rig, found, motions) - VELOCITY
    estimate = _estimate(found)
    whole = np.ones((len(ROWS), len(COLUMNS)), dtype=bool)
    left = whole & (np.arange(len(COLUMNS)) < len(COLUMNS) / 2)
    result = {}
    for number, component in enumerate("XYZ"):
        stated = region_mean(estimate, "velocity", whole, component=component, correlation_px=0).std_common
        result[component] = float(errors[..., number].mean()), stated
    apart = region_mean(estimate, "velocity", left, minus=~left, component="Z", correlation_px=0).std_common
    result["Z, left less right"] = float(errors[left, 2].mean() - errors[~left, 2].mean()), apart
    return result


def _strip_views(rig: DrawnRig, seed: int) -> tuple[list[TargetView], Array]:
    """Return views of a strip at new visits, position by position, and the true motions of the visits, (s, t, 6)."""
    generator = np.random.default_rng([seed, 99])
    first = max(rig.truth.layout.visits) + 1
    u, v = np.meshgrid(np.linspace(-36, 36, 17), [-27.0, 27.0])
    points = np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])
    covariance = np.tile(1e-4 * np.eye(2), (len(points), 1, 1))
    views = [
        TargetView(f"strip {n}", n // FRAMES, first + n, 1000, points, np.zeros((len(points), 2)), covariance, 1)
        for n in range(POSITIONS * FRAMES)
    ]
    given = replace(rig.observations, targets=(*rig.observations.targets, STRIP), views=tuple(views))
    layout = RigLayout.from_observations(given, ANEW)
    values = np.zeros(layout.size)
    values[: layout.first_visit] = rig.truth.values[: layout.first_visit]
    motions = np.array(ANEW.visit_std) * generator.standard_normal((len(views), 6))
    values[layout.first_visit : layout.first_target] = motions.ravel()
    values[layout.first_target + 4] = 1e-4 * generator.standard_normal()
    values[layout.first_pose + 5] = DEPTH_MM
    turn = rotation_matrix(np.array([0.03, -0.02, 0.01]))
    pixels = project(given, RigState(layout, values, turn[None]), derivatives=False)[0]
    pixels = pixels + 0.01 * generator.standard_normal(pixels.shape)
    parts = np.split(pixels, given.first[1:-1])
    moved = [replace(view, pixels=part) for view, part in zip(views, parts, strict=True)]
    return moved, motions.reshape(POSITIONS, FRAMES, 6)


def _fitted_velocity(rig: DrawnRig, found: RigCalibration, motions: Array) -> Array:
    """Return velocities fitted to the images of points by the true rig, with the poses of a calibration, (y, x, 3)."""
    true, layout = rig.truth.values.copy(), rig.truth.layout
    block = slice(layout.first_position, layout.first_visit)
    true[block] += motions.mean(axis=1).ravel()
    shared = (found.positions_mm, found.reference)
    own = found.values[found.layout.first_visit :][: motions.size].reshape(motions.shape)
    apart = motions - motions.mean(axis=1, keepdims=True)
    exact = [RigGeometry.from_values(true, layout, *shared, apart[:, t]) for t in range(FRAMES)]
    fitted = [RigGeometry.from_values(found.values, found.layout, *shared, own[:, t]) for t in range(FRAMES)]
    pixels = np.stack(np.meshgrid(COLUMNS, ROWS), axis=-1).reshape(-1, 2)
    rays = exact[0].lens.undistort((pixels - exact[0].intrinsics[1:3]) / exact[0].intrinsics[0])
    points = DEPTH_MM * np.column_stack([rays, np.ones(len(pixels))])
    seen = [each.project(each.to_stage(points + t * VELOCITY)) for each, t in zip(exact, TIMES, strict=True)]

    def residual(state: Array) -> Array:
        parts = [
            each.project(each.to_stage(state[:, :3] + t * state[:, 3:])) - image
            for each, t, image in zip(fitted, TIMES, seen, strict=True)
        ]
        return np.concatenate([part.transpose(1, 0, 2).reshape(len(state), -1) for part in parts], axis=1)

    state = np.concatenate([points, np.tile(VELOCITY, (len(points), 1))], axis=1)
    for _ in range(3):
        steps = 1e-4 * np.eye(6)
        slopes = np.stack([(residual(state + step) - residual(state - step)) / 2e-4 for step in steps], axis=-1)
        squares = np.einsum("nij,nik->njk", slopes, slopes)
        sums = np.einsum("nij,ni->nj", slopes, residual(state))
        state = state - np.linalg.solve(squares, sums[..., None])[..., 0]
    return np.asarray(state[:, 3:].reshape(len(ROWS), len(COLUMNS), 3))


def _estimate(found: RigCalibration) -> xr.Dataset:
    """Return an estimate of a plane that moves, with the errors of a calibration."""
    images = np.zeros((3, 1, 480, 640), dtype=np.uint8)
    recording = st.make_recording(
        images, found.value("f"), 5.0 * step_factor(found), principal_point_px=ideal_principal_point(found)
    ).isel(y=ROWS, x=COLUMNS)
    shape = (len(ROWS), len(COLUMNS))
    velocity = np.broadcast_to(VELOCITY[:, None, None], (3, *shape)).copy()
    made = st.make_estimate(
        depth=np.full(shape, DEPTH_MM), velocity=velocity, depth_std=np.full(shape, 1e-3),
        velocity_std=np.full((3, *shape), 1e-5), recording=recording,
    )  # fmt: skip
    return add_calibration_errors(made, found)
