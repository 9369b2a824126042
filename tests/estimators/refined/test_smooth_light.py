"""Errors by highlights that slide over a surface are stated; fits without the smooth part of images show them."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import Fit, Quantities, SmoothLight, blank_fit
from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane

NOISE_STD = 0.003
SIZE = (56, 64)
SLIDE_PX = 0.6
"""Shift of the highlight against the surface, per camera."""


def shining(height: float, seed: int = 0) -> tuple[xr.Dataset, MovingPlane]:
    """A plane with a Gaussian highlight of 8 px in its middle, which follows the camera."""
    plane = MovingPlane(size=SIZE, slopes=(0.0, 0.0), waves=24)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
    images = np.empty((5, 3, *SIZE))
    disparity = plane.focal_px * plane.baseline_mm / plane.depth_mm
    for i, s in enumerate(centred_indices(5)):
        for j, t in enumerate(centred_indices(3)):
            middle = SIZE[1] / 2 - (disparity - SLIDE_PX) * s
            glow = height * np.exp(-((x - middle) ** 2 + (y - SIZE[0] / 2) ** 2) / (2 * 8.0**2))
            images[i, j] = plane.image((plane.baseline_mm * s, 0.0), t) + glow
    images += np.random.default_rng(seed).normal(0.0, NOISE_STD, images.shape)
    return make_recording(images, plane.focal_px, plane.baseline_mm), plane


def scores(recording: xr.Dataset, plane: MovingPlane) -> NDArray[np.float64]:
    """Return valid errors of disparity in units of their stated standard deviations."""
    found = st.estimate(recording, "refined").isel(t=0)
    valid = found["valid"].values == 1
    assert valid.mean() > 0.9
    error = found["disparity"].values - plane.focal_px * plane.baseline_mm / plane.depth_mm
    return np.asarray(np.abs(error / found["disparity_std"].values)[valid])


@nightly
def test_error_by_a_sliding_highlight_is_stated() -> None:
    z = scores(*shining(0.3))
    # Without the comparison, 2.7 % are beyond 6.
    assert np.mean(z > 6) < 0.005
    assert np.sqrt(np.mean(z**2)) < 1.5


def example(change: NDArray[np.float64], explained: NDArray[np.bool_], whole: NDArray[np.bool_]) -> SmoothLight:
    """A comparison at every pixel of fits to 40 x 48 px whose disparity changes."""
    shape = change.shape
    values, variances = np.zeros((16, *shape)), np.full((16, *shape), 1.0)
    values[0] = change
    return SmoothLight(Quantities(values, variances, 6), explained, whole, 2.0, 1)


def blank(shape: tuple[int, int]) -> Fit:
    fit = blank_fit(np.zeros((15, *shape)), variances=True)
    fit.variance[:], fit.element_variance[:], fit.element[:] = 0.5, 0.5, 0.0
    return fit


def test_systematic_changes_are_added_where_one_surface_explains_the_images() -> None:
    shape = (40, 48)
    change = np.where(np.arange(48) < 24, 4.0, 0.3) * np.ones(shape)
    everywhere = np.ones(shape, dtype=bool)
    explained = everywhere & (np.arange(40) < 20)[:, None]
    added = example(change, explained, everywhere).added(blank(shape), ~everywhere).variance - 0.5
    assert added[0, :16, :16].min() > 10
    # Beyond the reach of the mean, at nodes that are not explained or do not change.
    assert added[0, 36:].max() == 0
    assert added[0, :, 44:].max() == 0
    assert added[1:].max() == 0


def test_single_windows_are_compared_one_by_one() -> None:
    shape = (40, 48)
    change = np.zeros(shape)
    change[10, 10], change[10, 12], change[30, 30] = 5.0, 2.0, 7.0
    everywhere = np.ones(shape, dtype=bool)
    explained = everywhere.copy()
    explained[30, 30] = False
    near = everywhere & (np.arange(48) < 40)
    added = example(change, explained, everywhere).added(blank(shape), near).variance[0] - 0.5
    expected = np.zeros(shape)
    expected[10, 10] = 25.0
    np.testing.assert_allclose(added, expected)
