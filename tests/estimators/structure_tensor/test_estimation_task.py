"""Bad input gets an answer before any work starts, and parts of images stand at the pixels of the camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import binary_dilation

import scenetruth as st
from scenetruth.errors import RecordingError
from scenetruth.schema import REASONS, STATUS_VALID
from tests.helpers.analytic_plane import Plane
from tests.helpers.invalid_borders import touching, with_invalid_pixels


def recording(**changes: Any) -> xr.Dataset:
    shape = changes.pop("shape", (5, 9, 32, 64))
    images = np.random.default_rng(0).random(shape)
    return st.make_recording(images, **{"focal_length_px": 500.0, "baseline_mm": 5.0, **changes})


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((1, 1, 32, 64), r"stage.positions: one image determines neither depth nor motion"),
        ((5, 9, 28, 64), r"camera.height: is too small: filters and window require 29 px \(got 28\)"),
        ((5, 9, 29, 20), r"camera.width: is too small: filters and window require 29 px \(got 20\)"),
    ],
)
def test_too_small_recordings_say_what_is_needed(shape: tuple[int, ...], message: str) -> None:
    with pytest.raises(st.EstimateError, match=message):
        st.estimate(recording(shape=shape))


def test_all_that_is_too_small_is_reported_at_once() -> None:
    with pytest.raises(st.EstimateError) as caught:
        st.estimate(recording(shape=(1, 1, 8, 8)))
    assert len(caught.value.problems) == 3


@pytest.mark.parametrize(
    ("settings", "path"),
    [
        ({"window_taps_px": 24}, "window_taps_px"),
        ({"window_sigma_px": 0.0}, "window_sigma_px"),
        ({"window_sigma_px": float("nan")}, "window_sigma_px"),
        ({"tau": -1.0}, "tau"),
        ({"tau": "guess"}, "tau"),
        ({"noise_std": 0.0}, "noise_std"),
        ({"flow_working_point_px": (1, 2, 3)}, "flow_working_point_px"),
        ({"flow_working_point_px": (0.5, 0)}, "flow_working_point_px"),
        ({"pyramid_levels": -1}, "pyramid_levels"),
        ({"working_point_px": "guess"}, "working_point_px"),
        ({"method": "magic"}, "method"),
        ({"windw": 3}, "windw"),
    ],
)
def test_impossible_settings(settings: dict[str, Any], path: str) -> None:
    with pytest.raises(st.EstimateError, match=path):
        st.estimate(recording(), **settings)


def test_images_without_a_valid_pixel_are_rejected() -> None:
    broken = recording()
    broken["image"].values[1, 2] = np.nan
    broken["image"].values[4, 8] = np.inf
    message = (
        r"image: 2 of \d+ images have no valid pixel \(the first at t = -2, s = -1\): omit these frames or positions"
    )
    with pytest.raises(st.EstimateError, match=message):
        st.estimate(broken)


REACH = 14
"""Half width of the filters and the window."""
PLANE = Plane(velocity=(0.1, 0.05, 0.2), size=(56, 84), focal_length_px=1000.0, depth_mm=500.0)


@pytest.mark.parametrize(
    ("positions", "chosen"),
    [
        ((-1, 0, 1), {"working_point_px": 2}),
        ((-1, 0, 1), {"working_point_px": 2, "flow_working_point_px": (1, -1)}),
        ((-1, 0, 1.2), {"working_point_px": 2}),
        ((-1, 0, 1), {"working_point_px": "per_pixel"}),
        ((-1, 0, 1), {"working_point_px": "per_pixel", "pyramid_levels": 1}),
    ],
)
def test_where_no_window_touches_an_invalid_pixel_the_estimate_is_the_same(
    positions: tuple[float, ...], chosen: dict[str, Any]
) -> None:
    whole = PLANE.recording(positions, 5, 1.0, noise=0.01)
    broken = with_invalid_pixels(whole)
    settings = {"tau": 1e-3, "noise_std": 0.01, **chosen}
    expected, found = (st.estimate(each, settings=settings).isel(t=0) for each in (whole, broken))
    valid = found["valid"].values
    if chosen["working_point_px"] == 2:
        lost = np.zeros(PLANE.size, dtype=bool)
        flow = chosen.get("flow_working_point_px", (0, 0))
        for s, position in enumerate(positions):
            for t in range(-2, 3):
                image = ~np.isfinite(broken["image"].values[s, t + 2])
                if 2 * position % 1:
                    # The spline that shifts the image by a part of a pixel reaches further along the rows.
                    image = binary_dilation(image, np.ones((1, 33)))
                lost |= touching(image, REACH, -round(2 * position) + flow[0] * t, flow[1] * t)
        np.testing.assert_array_equal(valid, expected["valid"].values & ~lost)
        assert (found["invalid_reason"].values[lost] == REASONS.index("border")).all()
    assert valid.sum() > 50
    assert valid.sum() < expected["valid"].values.sum()
    # A shift by a part of a pixel weighs pixels at a distance of more than 16 px by less than 2e-6.
    tolerance = 0.0 if all(2 * position % 1 == 0 for position in positions) else 1e-4
    for name in ("disparity", "depth", "velocity", "flow", "eigenvalues"):
        own, other = (each[name].values[..., valid] for each in (found, expected))
        np.testing.assert_allclose(own, other, rtol=tolerance, atol=tolerance, err_msg=name)
    # The window over the texture is wider than that of the estimate.
    for name in ("depth_std", "disparity_std"):
        np.testing.assert_allclose(found[name].values[valid], expected[name].values[valid], rtol=0.05, err_msg=name)


def test_working_point_without_common_view() -> None:
    with pytest.raises(
        st.EstimateError,
        match="working_point_px: images registered by 12 px per step share only 32 rows and 16 columns",
    ):
        st.estimate(recording(), working_point_px=12)


@pytest.mark.parametrize("positions", [[-10, -5, 0, 5, 5], [10, 5, 0, -5, -10], [-10, -5, 1, 5, 10]])
def test_impossible_stage_positions(positions: list[float]) -> None:
    with pytest.raises((st.EstimateError, st.RecordingError), match=r"stage_x_mm: (must|has positions that coincide)"):
        st.estimate(recording(stage_x_mm=positions))


def test_one_camera_needs_no_baseline() -> None:
    estimate = st.estimate(recording(shape=(1, 9, 32, 64), baseline_mm=0.0))
    assert np.isnan(estimate["depth"]).all()


def test_missing_intrinsics() -> None:
    broken = recording()
    del broken.attrs["focal_length_px"]
    with pytest.raises(st.RecordingError, match=r"attrs.focal_length_px: must be a finite number"):
        st.estimate(broken)


@pytest.mark.parametrize("name", ["s", "t", "stage_x_mm"])
def test_missing_coordinates(name: str) -> None:
    with pytest.raises(st.RecordingError, match=f"{name}: is missing; coordinate required for the images"):
        st.estimate(recording().drop_vars(name))


def test_wrong_order_of_dimensions() -> None:
    with pytest.raises(st.RecordingError, match="image: must have the dimensions"):
        st.estimate(recording().transpose("t", "s", "y", "x"))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integer_images_are_scaled_by_their_full_scale(dtype: type) -> None:
    linear = recording(shape=(5, 9, 36, 40))
    top = np.iinfo(dtype).max
    digital = st.make_recording(np.rint(linear["image"].values * top).astype(dtype), 500.0, 5.0)
    one, two = (st.estimate(data, working_point_px=0)["eigenvalues"].isel(t=0) for data in (linear, digital))
    # Rounding to whole digital numbers: noise of 1/sqrt(12) of a step against a signal of full scale.
    np.testing.assert_allclose(two.isel(rank=0), one.isel(rank=0), rtol=10 / top)


def test_progress_is_told() -> None:
    calls: list[tuple[str, int, int]] = []
    st.estimate(recording(), working_point_px=0, progress=lambda *call: calls.append(call))
    assert calls[0] == ("estimate", 0, calls[-1][2])
    assert [call[1] for call in calls] == list(range(len(calls)))
    assert calls[-1][1] == calls[-1][2]


# Moves in depth, so that a wrong principal point would show as a motion along X.
PLANE = Plane(depth_mm=488.0, velocity=(0.1, -0.05, 0.3), size=(60, 90))
POINT: dict[str, Any] = {"working_point_px": 2, "flow_working_point_px": (0, 0)}


def test_a_crop_gives_the_same_estimate_as_the_whole() -> None:
    recording = PLANE.recording(np.arange(5.0) - 2, 9)
    rows, columns = slice(9, 57), slice(20, 80)
    whole = st.estimate(recording, **POINT).isel(y=rows, x=columns)
    part = st.estimate(recording.isel(y=rows, x=columns), **POINT)
    np.testing.assert_array_equal(part["x"], np.arange(20, 80))
    np.testing.assert_array_equal(part["y"], np.arange(9, 57))
    assert part.attrs["principal_point_px"] == recording.attrs["principal_point_px"]
    both = (part["status"].values == STATUS_VALID) & (whole["status"].values == STATUS_VALID)
    assert both.sum() > 400
    assert part["status"].where(whole["status"] != STATUS_VALID, 0).max() < STATUS_VALID
    for name in ("depth", "velocity", "disparity", "flow", "divergence"):
        np.testing.assert_allclose(
            part[name].values[..., both[0]], whole[name].values[..., both[0]], rtol=1e-4, atol=1e-5, err_msg=name
        )


@pytest.mark.parametrize("pyramid_levels", [0, 1])
def test_every_second_pixel_gives_depth_and_motion_undoubled(pyramid_levels: int) -> None:
    plane = Plane(depth_mm=488.0, velocity=(0.1, -0.05, 0.3), size=(100, 140), wavelengths_px=(12.0, 40.0))
    recording = plane.recording(np.arange(5.0) - 2, 9)
    chosen = slice(3, None, 2)
    settings: dict[str, Any] = {"pyramid_levels": 1} if pyramid_levels else POINT
    estimate = st.estimate(recording.isel(x=chosen, y=chosen), **settings).sel(t=0)
    truth = plane.truth()
    known = estimate["status"].values == STATUS_VALID
    assert known.sum() > 150
    error = {
        name: np.abs(estimate[name].values - truth[name][..., chosen, chosen])[..., known].max()
        for name in ("depth", "velocity", "disparity", "flow", "divergence")
    }
    # Pixels of the camera, though the estimator saw only half of them along either axis.
    assert error["disparity"] < 1e-3
    assert error["flow"] < 1e-3
    assert error["depth"] < 0.3
    assert error["velocity"] < 0.02
    np.testing.assert_array_equal(estimate["registration_disparity"].values[known] % 2, 0)
    assert estimate.attrs["working_point_px"] == 2


def test_uneven_pixels_are_refused() -> None:
    recording = PLANE.recording(np.arange(5.0) - 2, 9)
    with pytest.raises(RecordingError, match="x"):
        st.estimate(recording.isel(x=[*range(40), *range(50, 90)]), **POINT)
