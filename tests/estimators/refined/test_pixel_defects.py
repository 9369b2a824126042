"""Pixels that must not be used: found, filled, left out, counted."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

import scenetruth as st
from scenetruth.estimators.refined import (
    DefectFilteredFrames,
    fill_defects,
    find_dead_pixels,
    find_saturated_runs,
    spread_defects,
)
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane, turning

PLANE = MovingPlane(seed=2, size=(90, 120), gradient=turning(4e-3, -3e-3, 5e-3))
TRUTH = PLANE.truth()
INSIDE = (slice(14, -14), slice(34, -34))
SETTINGS: dict[str, Any] = {"window_sigma_px": 4, "surface": "plane", "motion": "rigid", "discontinuity_refit": False}


def with_images(recording: xr.Dataset, values: NDArray[Any]) -> xr.Dataset:
    return recording.assign(image=(recording["image"].dims, values, recording["image"].attrs))


def errors(found: xr.Dataset) -> tuple[NDArray[Any], NDArray[Any]]:
    """Errors of depth and velocity, and the same over their standard deviations."""
    plain, scaled = [], []
    for name in ("depth", "velocity"):
        error = (found[name].values - TRUTH[name])[(..., *INSIDE)].reshape(-1, 62, 52)
        plain.append(error)
        scaled.append(error / found[f"{name}_std"].values[(..., *INSIDE)].reshape(-1, 62, 52))
    return np.concatenate(plain), np.concatenate(scaled)


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def noisy() -> xr.Dataset:
    return PLANE.recording(5, 5, noise_std=0.01)


@pytest.fixture(scope="module")
def whole(noisy: xr.Dataset) -> xr.Dataset:
    return st.estimate(noisy, "refined", SETTINGS).sel(t=0)


def test_missing_pixels_cost_their_samples_and_no_more(noisy: xr.Dataset, whole: xr.Dataset) -> None:
    """1 % of the pixels is missing, and 13 samples around each are not used: 12 % of the information."""
    values = noisy["image"].values.copy()
    gone = np.random.default_rng(3).random(values.shape) < 0.01
    values[gone] = np.nan
    found = st.estimate(with_images(noisy, values), "refined", SETTINGS).sel(t=0)
    counts = json.loads(found.attrs["excluded_pixel_counts"])
    assert counts == {"user": 0, "not_finite": int(gone.sum()), "saturated": 0, "dead": 0}
    assert (found["status"].values[INSIDE] == 2).all()
    share = float(found["image_count"].values[INSIDE].mean()) / 25
    assert share == pytest.approx((1 - gone.mean()) ** 13, abs=0.01)
    (before, scaled_before), (after, scaled) = errors(whole), errors(found)
    # In the median: where windows of half the size differ by chance, the standard deviation includes that.
    assert np.median(found["depth_std"].values[INSIDE]) == pytest.approx(
        np.median(whole["depth_std"].values[INSIDE]) / np.sqrt(share), rel=0.02
    )
    # The same noise but for what is lost, which moves errors by √(1/share - 1) of a standard deviation: 0.37.
    moved = (after - before) / (before / scaled_before)
    assert rms(moved) < 0.5
    # Some ten windows share no noise, and four quantities: the rms scatters by 11 %.
    assert rms(scaled_before) == pytest.approx(1.0, abs=0.25)
    assert rms(scaled) == pytest.approx(rms(scaled_before), abs=0.1)


@nightly
@pytest.mark.parametrize("start", ["plane_sweep", "structure_tensor"])
def test_what_lies_under_a_mask_counts_for_nothing(noisy: xr.Dataset, start: str) -> None:
    """Rubbish under a mask, one for each camera, changes nothing at all."""
    mask = np.zeros((5, 90, 120), dtype=bool)
    mask[0, 20:40, 30:60], mask[2, 50:56, 50:58], mask[4, :, 100:] = True, True, True
    rubbish = noisy["image"].values.copy()
    rubbish[np.broadcast_to(mask[:, None], rubbish.shape)] = np.random.default_rng(4).normal(0, 5, 9999).max()
    slow = {**SETTINGS, "initialisation": start}
    both = [
        st.estimate(with_images(noisy, values).assign(exclusion_mask=(("s", "y", "x"), mask)), "refined", slow).sel(t=0)
        for values in (noisy["image"].values, rubbish)
    ]
    xr.testing.assert_identical(both[0].drop_attrs(), both[1].drop_attrs())
    assert json.loads(both[1].attrs["excluded_pixel_counts"])["user"] == 5 * mask.sum()
    if start == "plane_sweep":
        assert (both[1]["status"].values[INSIDE] == 2).all()
        assert rms(errors(both[1])[1]) == pytest.approx(1.0, abs=0.15)


def test_where_most_images_are_masked_nothing_is_told(noisy: xr.Dataset) -> None:
    """A square of 30 px in the sensor's middle moves by 8 px per camera: all five show none of its inner columns."""
    mask = np.zeros((90, 120), dtype=bool)
    mask[20:70, 25:95] = True
    found = st.estimate(noisy.assign(exclusion_mask=(("y", "x"), mask)), "refined", SETTINGS).sel(t=0)
    assert (found["status"].values[38:52, 50:70] == 0).all()
    assert np.isnan(found["depth"].values[38:52, 50:70]).all()
    told = found["status"].values == 2
    scaled = ((found["depth"].values - TRUTH["depth"]) / found["depth_std"].values)[told]
    assert np.mean(np.abs(scaled) > 6) < 5e-3


def test_nothing_bad_takes_no_arrays(noisy: xr.Dataset) -> None:
    frames = DefectFilteredFrames(noisy)
    assert np.shares_memory(frames.frames(0, 5), frames.frames(0, 5))
    assert frames.bad(0, 5) == []
    assert sum(frames.counts.values()) == 0


def test_a_dead_pixel_is_found_and_a_star_is_not(noisy: xr.Dataset) -> None:
    values = noisy["image"].values.copy()
    places = [(40, 60), (41, 80), (70, 61)]
    for n, (y, x) in enumerate(places):
        values[..., y, x] = (0.0, 1.0, 0.9)[n]
    # One in one image only, and two that are side by side: no single pixel of the sensor.
    values[0, 0, 20, 20] = 1.0
    values[..., 55, 55:57] = 1.0
    frames = DefectFilteredFrames(with_images(noisy, values))
    frames.frames(0, 5)
    assert frames.counts["dead"] == 25 * len(places)
    bad = frames.bad(0, 5)
    for y, x in places:
        assert bad[0][3, y, x] == 1
    assert bad[0][3, 55, 55] == 0


@pytest.mark.parametrize("still", [False, True])
def test_texture_is_not_dead(still: bool) -> None:
    """Of pixels that have nothing to do with each other, those of a scene at rest too."""
    generator = np.random.default_rng(6)
    values = generator.uniform(0, 1, (9, 60, 80)).astype(np.float32)
    nothing = np.zeros((60, 80), dtype=bool)
    assert not find_dead_pixels(lambda: [(values[0 if still else n], nothing) for n in range(9)]).any()


def test_clipped_pixels_come_in_runs() -> None:
    image = np.full((12, 14), 100, dtype=np.uint8)
    image[2, 2] = 255
    image[5:7, 5:7] = 255
    image[:, 12:] = 0
    expected = np.zeros((12, 14), dtype=bool)
    expected[5:7, 5:7] = True
    np.testing.assert_array_equal(find_saturated_runs(image, 255.0), expected)
    assert not find_saturated_runs(image, 4095.0).any()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_clipped_images_say_how_much_and_black_is_no_fault(dtype: type, noisy: xr.Dataset) -> None:
    """An overexposed half; the other holds black ground: both are digital numbers of full range."""
    values = noisy["image"].values
    full = np.iinfo(dtype).max
    bright = np.where(np.arange(120) < 60, values * 1.8, np.maximum(values - 0.5, 0))
    numbers = np.clip(np.rint(bright * full), 0, full).astype(dtype)
    recording = st.make_recording(numbers, PLANE.focal_px, PLANE.baseline_mm)
    frames = DefectFilteredFrames(recording)
    frames.frames(0, 5)
    assert (numbers == 0).sum() > 1000
    clipped = int((numbers == full).sum())
    assert 0.9 * clipped < frames.counts["saturated"] <= clipped
    assert sum(frames.counts.values()) == frames.counts["saturated"]


def test_an_image_without_any_pixel_is_black() -> None:
    assert (fill_defects(np.full((4, 5), np.nan, np.float32), np.ones((4, 5), bool)) == 0).all()


def test_samples_that_are_used_have_three_per_cent_of_a_filled_pixel() -> None:
    """What `spread` states, from the spline through a single 1."""
    at = np.arange(-20.0, 21.0)
    cardinal = make_interp_spline(at, (at == 0).astype(np.float64), k=5)
    squares = [np.mean(cardinal(np.linspace(k - 0.5, k + 0.5, 1001)) ** 2) for k in range(-6, 7)]
    left = np.sqrt(np.outer(squares, squares))
    single = np.zeros((1, 13, 13), dtype=bool)
    single[0, 6, 6] = True
    out = spread_defects(single)[0] == 1
    assert out.sum() == 13
    assert left[~out].max() == pytest.approx(0.030, abs=0.001)
    assert spread_defects(np.zeros((1, 4, 4), bool)).sum() == 0
    assert spread_defects(np.ones((1, 4, 4), bool)).all()
