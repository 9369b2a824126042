"""Means over regions and their differences: stated deviations against draws of the errors."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import scenetruth as st
from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration, add_calibration_errors, region_mean
from scenetruth.errors import ArgumentError
from scenetruth.schema import describe_variable

SHAPE = (60, 80)
SIGMA_PX = 3.0
DRAWS = 400


def made_estimate(visits_mm: float = 0.0) -> xr.Dataset:
    recording = st.make_recording(np.zeros((3, 1, *SHAPE)), focal_length_px=1000, baseline_mm=5)
    x = np.arange(SHAPE[1]) * np.ones(SHAPE)
    depth = 500.0 + 0.5 * x
    velocity = np.stack([0 * depth + 1.0, 0 * depth, 0 * depth - 2.0])
    found = st.make_estimate(
        depth=depth, velocity=velocity, depth_std=np.full(SHAPE, np.hypot(0.2, visits_mm)),
        velocity_std=np.full((3, *SHAPE), 0.01), recording=recording,
    )  # fmt: skip
    if visits_mm:
        common = np.full((1, *SHAPE), visits_mm, dtype=np.float32)
        found["depth_std_common"] = (("t", "y", "x"), common, describe_variable("estimate", "depth_std_common"))
    return found.assign_attrs(settings=json.dumps({"window_sigma_px": SIGMA_PX}))


def rig() -> RigCalibration:
    camera = Camera(width=SHAPE[1], height=SHAPE[0], focal_length_px=1000)
    return RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 2.0, "c_x": 1.0, "k1": 0.5})


def noise(seed: int) -> NDArray[np.float64]:
    """Return errors of windows of a Gaussian: white noise that is smoothed by it, of deviation 1."""
    white = np.random.default_rng(seed).standard_normal(SHAPE)
    return np.asarray(gaussian_filter(white, SIGMA_PX, mode="wrap") * 2 * np.sqrt(np.pi) * SIGMA_PX)


def box(rows: slice, columns: slice) -> NDArray[np.bool_]:
    found = np.zeros(SHAPE, dtype=np.bool_)
    found[rows, columns] = True
    return found


LEFT, RIGHT = box(slice(10, 40), slice(5, 30)), box(slice(20, 50), slice(55, 75))


def test_pixel_part_of_a_mean_and_of_a_difference() -> None:
    estimate = made_estimate()
    mean, difference = (region_mean(estimate, "depth", LEFT, minus=other) for other in (None, RIGHT))
    drawn = [noise(seed) for seed in range(DRAWS)]
    means = np.array([[each[LEFT].mean(), each[RIGHT].mean()] for each in drawn])
    # The deviation of 400 draws is known to 3.5 %.
    assert mean.std_pixel == pytest.approx(0.2 * means[:, 0].std(), rel=0.1)
    assert difference.std_pixel == pytest.approx(0.2 * (means[:, 0] - means[:, 1]).std(), rel=0.1)
    assert mean.std_common == 0
    assert mean.count == (750,)
    assert difference.value == pytest.approx(-0.5 * (64.5 - 17.0), rel=1e-6)
    alone = region_mean(estimate, "depth", LEFT, correlation_px=0)
    assert alone.std == pytest.approx(0.2 / np.sqrt(750), rel=1e-5)
    single = region_mean(estimate, "depth", box(slice(10, 11), slice(12, 13)))
    assert single.std == pytest.approx(0.2, rel=1e-5)


def test_a_wrong_focal_length_is_common_to_all_pixels() -> None:
    """Depth is wrong by df / f: its mean by that of the mean depth, a difference by that of the difference."""
    camera = Camera(width=SHAPE[1], height=SHAPE[0], focal_length_px=1000)
    found = add_calibration_errors(made_estimate(), RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 2.0}))
    mean, difference = (region_mean(found, "depth", LEFT, minus=other) for other in (None, RIGHT))
    assert mean.std_common == pytest.approx(2e-3 * mean.value, rel=1e-3)
    assert difference.std_common == pytest.approx(2e-3 * abs(difference.value), rel=1e-2)
    assert difference.std_pixel == pytest.approx(region_mean(made_estimate(), "depth", LEFT, minus=RIGHT).std, rel=1e-3)
    along = region_mean(found, "velocity", LEFT, component="Z")
    assert along.value == pytest.approx(-2.0)
    assert along.std_common == pytest.approx(2e-3 * 2.0, rel=1e-3)
    assert along.units == "mm/frame"


def test_visits_are_the_same_error_of_all_pixels() -> None:
    found = add_calibration_errors(made_estimate(visits_mm=0.05), rig())
    mean, difference = (region_mean(found, "depth", LEFT, minus=other) for other in (None, RIGHT))
    plain = region_mean(add_calibration_errors(made_estimate(), rig()), "depth", LEFT)
    assert mean.std_common == pytest.approx(np.hypot(plain.std_common, 0.05), rel=1e-3)
    assert difference.std_common < 0.2 * mean.std_common
    assert str(plain).endswith(f" mm (in common: {plain.std_common:.2g})")


def test_bad_arguments() -> None:
    estimate = made_estimate()
    for arguments, message in (
        ({"quantity": "flow"}, "quantity: must be one of depth, velocity, slope, growth_rate"),
        ({"quantity": "growth_rate"}, "must have growth_rate and growth_rate_std"),
        ({"quantity": "velocity"}, "component: must be one of X, Y, Z"),
        ({"component": "Z"}, "component: must be omitted: depth has no components"),
        ({"t": 3}, r"t: must be one of the frames \[0\]"),
        ({"region": LEFT[:-1]}, r"region: must be boolean, of shape \(60, 80\)"),
        ({"minus": ~LEFT & LEFT}, "minus: has no pixel with a valid depth"),
        ({"correlation_px": -1.0}, "correlation_px: must not be negative"),
    ):
        given = {"quantity": "depth", "region": LEFT, **arguments}
        with pytest.raises(ArgumentError, match=message):
            region_mean(estimate, **given)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="correlation_px: is missing, and the estimate states no window_sigma_px"):
        region_mean(estimate.assign_attrs(settings="{}"), "depth", LEFT)
