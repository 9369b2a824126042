"""Bad input to `estimate` gets an answer before any work starts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st


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


def test_images_that_are_not_finite() -> None:
    broken = recording()
    broken["image"].values[1, 2, 3, 4] = np.nan
    with pytest.raises(st.EstimateError, match="image: contains 1 values that are not finite in float32"):
        st.estimate(broken)


def test_working_point_without_common_view() -> None:
    with pytest.raises(
        st.EstimateError,
        match="working_point_px: images registered by 12 px per step share only 32 rows and 16 columns",
    ):
        st.estimate(recording(), working_point_px=12)


@pytest.mark.parametrize("positions", [[-10, -5, 0, 5, 5], [10, 5, 0, -5, -10], [-10, -5, 1, 5, 10]])
def test_impossible_stage_positions(positions: list[float]) -> None:
    with pytest.raises(st.EstimateError, match="stage_x_mm: must"):
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
