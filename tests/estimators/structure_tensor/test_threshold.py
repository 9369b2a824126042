"""The threshold τ: who is told that it is too high, and what the one from noise makes known."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.schema import STATUS_VALID

NOISE = 0.002


def patterned(contrast: float, share: float = 1.0) -> xr.Dataset:
    """Return a moving texture on the left ``share`` of the image, and a blank; with the noise of a camera."""
    s, t, y, x = np.meshgrid(np.arange(5) - 2, np.arange(9) - 4, np.arange(80), np.arange(120), indexing="ij")
    moved_x, moved_y = x + 0.3 * s - 0.2 * t, y + 0.15 * t
    texture = np.cos(0.7 * moved_x + 0.2 * moved_y) * np.cos(0.6 * moved_y - 0.3 * moved_x)
    noise = np.random.default_rng(3).normal(0, NOISE, texture.shape)
    return st.make_recording(0.5 + contrast * texture * (x < 120 * share) + noise, 100.0, 1.0)


def full(estimate: xr.Dataset) -> float:
    inner = estimate.isel(t=0, y=slice(14, -14), x=slice(14, -14))
    return float((inner["status"] == STATUS_VALID).mean())


def test_dim_images_are_said_to_need_a_lower_threshold() -> None:
    dim = patterned(0.02)
    with pytest.warns(st.EstimateWarning, match="tau: 0.0012 is too high for .* % of the pixels"):
        lost = st.estimate(dim, working_point_px=0)
    found = st.estimate(dim, working_point_px=0, tau="auto")
    assert full(lost) == 0
    assert full(found) == 1
    # The error bars know what so little contrast is worth: the errors stay within four of them.
    inner = found.isel(t=0, y=slice(14, -14), x=slice(14, -14))
    assert float(abs((inner["disparity"] - 0.3) / inner["disparity_std"]).quantile(0.95)) < 4


def test_the_warning_tells_how_many_pixels() -> None:
    with pytest.warns(st.EstimateWarning) as caught:
        st.estimate(patterned(0.02, share=0.5), working_point_px=0)
    assert caught[0].filename == __file__
    told = float(str(caught[0].message).split(" for ")[1].split(" %")[0])
    # Half of what filters and window can reach; windows of 25 px smear the border.
    assert told == pytest.approx(50, abs=8)


@pytest.mark.parametrize(("contrast", "share"), [(0.3, 1.0), (0.3, 0.3), (0.0, 1.0)])
def test_bright_textures_and_blanks_are_no_reason_for_a_warning(contrast: float, share: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.estimate(patterned(contrast, share), working_point_px=0)


def test_nothing_is_said_of_a_threshold_from_noise() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.estimate(patterned(0.005), working_point_px=0, tau="auto")


def test_a_caller_who_makes_warnings_errors_gets_this_one() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(st.EstimateWarning):
            st.estimate(patterned(0.02), working_point_px=0)


@pytest.mark.parametrize("value", [0, 7, 30000])
def test_nothing_is_said_of_blanks_without_noise(value: int) -> None:
    """What rounding leaves of a blank is no texture, whatever its eigenvalues' ratios."""
    blank = st.make_recording(np.full((1, 3, 7, 7), value, np.uint16), 500.0, 5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.estimate(blank, window_taps_px=3)
