"""Errors of estimates by a calibration: against the triangulation of single points, and of moving elements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st_
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.capture import RigCalibration, add_calibration_errors
from scenetruth.capture.calibration import RigGeometry, triangulate
from scenetruth.errors import ArgumentError
from scenetruth.schema import describe_variable
from scenetruth.storage import load_store, save_store
from tests.helpers.nightly import nightly
from tests.helpers.skewed_rigs import CAMERA, skewed_rig
from tests.helpers.strip_velocity import velocity_errors

Array = NDArray[np.float64]
DEPTH_MM = 400.0
_SCALES = {"f": 0.5, "c_x": 0.5, "c_y": 0.5, "k1": 0.01, "k2": 1.0, "p1": 1e-4, "p2": 1e-4}
_SCALES |= {"axis_y": 3e-4, "axis_z": 3e-4, "step_scale": 1e-4}


def uncertain_rig(seed: int, only: str | None = None) -> RigCalibration:
    """Return a rig with a correlated covariance of lens, axis and positions, or of one parameter alone."""
    rig = skewed_rig(seed)
    scale = np.zeros(len(rig.names))
    for number, name in enumerate(rig.names):
        motion = [1e-5, 1e-5, 1e-5, 2e-4, 1e-3, 1e-3]
        scale[number] = _SCALES.get(name, 0.0)
        if name.startswith("position["):
            scale[number] = motion[(number - rig.layout.first_position) % 6]
    if only is not None:
        scale[np.array(rig.names) != only] = 0.0
    mixing = np.random.default_rng(seed).normal(size=(len(scale), len(scale))) / np.sqrt(len(scale))
    covariance = np.outer(scale, scale) * (mixing @ mixing.T + 0.3 * np.eye(len(scale)))
    return RigCalibration(
        rig.width, rig.height, rig.positions_mm, rig.reference, rig.names, rig.values, covariance, rig.prior_std
    )  # fmt: skip


def ideal_axes(rig: RigCalibration) -> Array:
    x = rig.axis
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def estimate_of(
    rig: RigCalibration, slopes: tuple[float, float] = (0.4, -0.2), turning: tuple[float, float, float] = (0, 0, 0)
) -> xr.Dataset:
    """Return an estimate of an inclined plane that moves and turns, without errors, on the ideal rig."""
    from scenetruth.capture.rectification import ideal_principal_point, step_factor

    point = ideal_principal_point(rig)
    focal, step = rig.value("f"), 4.0 * step_factor(rig)
    recording = st.make_recording(
        np.zeros((3, 1, CAMERA.height, CAMERA.width)), focal, step, principal_point_px=point
    )  # fmt: skip
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    x, y = (x - point[0]) / focal, (y - point[1]) / focal
    depth = DEPTH_MM / (1 - slopes[0] * x - slopes[1] * y)
    points = np.stack([x * depth, y * depth, depth - DEPTH_MM])
    turn = np.reshape(turning, (3, 1, 1)) * np.ones_like(points)
    velocity = np.reshape([0.5, -0.3, -2.0], (3, 1, 1)) + np.cross(turn, points, axis=0)
    made = st.make_estimate(
        depth=depth, velocity=velocity, depth_std=np.full_like(depth, 0.01), recording=recording,
        velocity_std=np.full_like(velocity, 1e-4),
    )  # fmt: skip
    flat = np.reshape(slopes, (2, 1, 1)) * np.ones((2, *depth.shape))
    more: dict[str, Any] = {"slope": flat, "slope_std": 0 * flat + 1e-3, "rotation_rate": turn}
    more |= {"growth_rate": 0 * depth, "growth_rate_std": 0 * depth + 1e-9}
    dims = {"slope": "slope_component", "slope_std": "slope_component", "rotation_rate": "component"}
    for name, values in more.items():
        lead = (dims[name],) if name in dims else ()
        made[name] = ((*lead, "t", "y", "x"), np.expand_dims(values, -3), describe_variable("estimate", name))
    return made.assign_coords(slope_component=["X", "Y"])


def points_of(estimate: xr.Dataset, rows: NDArray[Any], columns: NDArray[Any]) -> tuple[Array, Array]:
    """Return points and velocities at pixels, shape (n, 3)."""
    c_x, c_y = estimate.attrs["principal_point_px"]
    depth = estimate["depth"].values[0, rows, columns]
    rays = np.stack([columns - c_x, rows - c_y, np.full(len(rows), estimate.attrs["focal_length_px"])], axis=-1)
    return rays / rays[:, 2:] * depth[:, None], estimate["velocity"].values[:, 0, rows, columns].T


@nightly
@given(seed=st_.integers(0, 10**6))
@settings(deadline=None, max_examples=5)
def test_depth_and_velocity_against_single_points(seed: int) -> None:
    rig = uncertain_rig(seed)
    estimate = estimate_of(rig, turning=(0.01, 0.02, -0.01))
    found = add_calibration_errors(estimate, rig)
    generator = np.random.default_rng(seed)
    rows, columns = generator.integers(0, CAMERA.height, 25), generator.integers(0, CAMERA.width, 25)
    points, velocity = points_of(estimate, rows, columns)
    axes = ideal_axes(rig)
    real = points @ axes.T
    assert CAMERA.distortion is not None
    pixels = CAMERA.focal_px * CAMERA.distortion.distort(real[:, :2] / real[:, 2:]) + CAMERA.principal_point
    along_z = rig.point_errors(pixels, real[:, 2], visit_std=np.zeros(6))[2]
    common = found["depth_std_common"].values[0, rows, columns]
    # The frame of the single points is turned by 4 mrad, and their errors along X and Y are of the same size.
    np.testing.assert_allclose(common, along_z.std, rtol=0.02)
    np.testing.assert_allclose(found["depth_std"].values[0, rows, columns], np.hypot(common, 0.01), rtol=1e-5)
    moved = rig.point_errors(pixels, real[:, 2], displacement_mm=velocity @ axes.T, visit_std=np.zeros(6))
    for component in range(3):
        stated = found["velocity_std_common"].values[component, 0, rows, columns]
        np.testing.assert_allclose(stated, moved[component].std, rtol=0.03, atol=0.02 * moved[2].std.max())


@pytest.mark.parametrize("parameter", ["f", "c_x", "k1", "p2", "position[2].yaw", "position[0].z", "axis_z"])
def test_slope_and_growth_of_a_turning_element(parameter: str) -> None:
    """One wrong parameter: triangles on the plane are triangulated from their true images, before and after a frame."""
    names = {"position[2].yaw": "position[2]", "position[0].z": "position[0]"}
    rig = skewed_rig(7)
    own = [name for name in rig.names if name.startswith(names.get(parameter, parameter))]
    only = own[0] if parameter not in names else own[1 if "yaw" in parameter else 5]
    rig = uncertain_rig(7, only)
    turning = (0.02, -0.05, 0.03)
    estimate = estimate_of(rig, turning=turning)
    found = add_calibration_errors(estimate, rig)
    index = rig.names.index(only)
    changed = rig.values.copy()
    changed[index] += np.sqrt(rig.covariance[index, index])
    true, wrong = (
        RigGeometry.from_values(values, rig.layout, rig.positions_mm, rig.reference) for values in (rig.values, changed)
    )
    axes = ideal_axes(rig)
    turn = np.array(turning)
    for row, column in ((10, 12), (36, 48), (60, 80)):
        (point,), _ = points_of(estimate, np.array([row]), np.array([column]))
        corners = point + np.array([[-1, -1, -0.2], [2, -1, 1.0], [-1, 2, -0.8]]) * 0.03
        velocity = np.array([0.5, -0.3, -2.0]) + np.cross(turn, corners - [0, 0, DEPTH_MM])
        areas, normals = [], []
        for h in (-0.5, 0.5):
            for rig_now in (true, wrong):
                moved = corners + h * velocity
                seen = true.project(true.to_stage(moved @ axes.T))
                there = triangulate(rig_now, seen, moved[:, 2]) @ axes
                normal = np.cross(there[1] - there[0], there[2] - there[0])
                areas.append(np.linalg.norm(normal))
                normals.append(normal)
        # Of the wrong cameras: ln(after / before), less that of the true cameras.
        growth = np.log(areas[3] / areas[1]) - np.log(areas[2] / areas[0])
        stated = found["growth_rate_std_common"].values[0, row, column]
        # Areas of 0.004 mm², triangulated to 1e-9 mm.
        assert stated == pytest.approx(abs(growth), rel=0.05, abs=2e-7)
        slopes = [-(normals[k] + normals[k + 2])[:2] / (normals[k] + normals[k + 2])[2] for k in (0, 1)]
        slope = found["slope_std_common"].values[:, 0, row, column]
        np.testing.assert_allclose(slope, np.abs(slopes[1] - slopes[0]), rtol=0.02, atol=1e-6)


def test_parts_add_to_those_of_the_method(tmp_path: Path) -> None:
    rig = uncertain_rig(3)
    estimate = estimate_of(rig)
    shape = ("t", "y", "x")
    visits = np.full(estimate["depth"].shape, 0.006, dtype=np.float32)
    estimate["depth_std_common"] = (shape, visits, describe_variable("estimate", "depth_std_common"))
    estimate["depth"][0, 4, 5] = np.nan
    found = add_calibration_errors(estimate, rig)
    pixel = np.sqrt(found["depth_std"].values ** 2 - found["depth_std_common"].values ** 2)
    valid = np.isfinite(estimate["depth"].values)
    np.testing.assert_allclose(pixel[valid], np.sqrt(0.01**2 - 0.006**2), rtol=1e-3)
    assert np.isnan(found["depth_std"][0, 4, 5])
    assert int(np.isnan(found["depth_std"]).sum()) == 1
    save_store(found, tmp_path / "estimate.zarr")
    xr.testing.assert_identical(load_store(tmp_path / "estimate.zarr"), found)
    with pytest.raises(ArgumentError, match="contains the errors of a calibration already"):
        add_calibration_errors(found, rig)


def test_a_calibration_without_errors_adds_none() -> None:
    rig = skewed_rig(1)
    estimate = estimate_of(rig)
    found = add_calibration_errors(estimate, rig)
    assert found["calibration_modes"].sizes["mode"] == 0
    assert float(found["depth_std_common"].max()) == 0
    np.testing.assert_allclose(found["depth_std"], estimate["depth_std"], rtol=1e-6)


def test_files_and_mosaics_are_read(tmp_path: Path) -> None:
    """Every second pixel, of a focal length of half as many pixels."""
    rig = uncertain_rig(5)
    estimate = estimate_of(rig)
    whole = add_calibration_errors(estimate, rig.save(tmp_path / "calibration.yaml"))
    half = estimate.isel(x=slice(1, None, 2), y=slice(0, None, 2))
    half = half.assign_coords(x=np.arange(half.sizes["x"]), y=np.arange(half.sizes["y"]))
    c_x, c_y = estimate.attrs["principal_point_px"]
    focal = estimate.attrs["focal_length_px"] / 2
    half = half.assign_attrs(focal_length_px=focal, principal_point_px=[(c_x - 1) / 2, c_y / 2])
    found = add_calibration_errors(half, rig)
    np.testing.assert_allclose(found["depth_std"], whole["depth_std"][:, ::2, 1::2], rtol=1e-4)


def test_other_calibrations_are_rejected() -> None:
    rig = uncertain_rig(2)
    estimate = estimate_of(rig)
    for attrs, message in (
        ({"focal_length_px": 1001.0}, "focal_length_px: is 1001 px, but 1000 px in the calibration"),
        ({"principal_point_px": [40.0, 30.0]}, "principal_point_px: is .* px in the calibration"),
        ({"baseline_mm": 4.1}, "baseline_mm: is 4.1 mm, but the steps of the calibration are 4.00"),
    ):
        with pytest.raises(ArgumentError, match=message):
            add_calibration_errors(estimate.assign_attrs(attrs), rig)
    with pytest.raises(ArgumentError, match="must have depth and depth_std"):
        add_calibration_errors(estimate.drop_vars(["depth", "depth_std"]), rig)


@nightly
def test_velocity_of_drawn_rigs_with_a_strip() -> None:
    """Calibrations from noisy corners; points are seen at visits whose poses a strip has shown."""
    draws = [velocity_errors(seed) for seed in range(100)]
    for name in draws[0]:
        error, std = np.array([draw[name] for draw in draws]).T
        z = error / std
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=5 / np.sqrt(2 * len(z))), name
