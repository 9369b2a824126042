"""Mean image and its noise, and outlines apart from differences of noisy fits."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.refined import MeanImage, blank_fit, find_outlines
from tests.helpers.shifted_stack import DISPARITY, Array, shifted_parameters, shifted_stack

NOISE = 0.02
EVERYWHERE = np.ones((72, 96), dtype=np.bool_)
INSIDE = (slice(12, -12), slice(16, -16))


def _texture(x: Array, y: Array) -> Array:
    return np.asarray(np.cos(2 * np.pi * x / 11) + np.cos(2 * np.pi * y / 13))


def test_the_mean_image_is_the_texture_with_the_noise_of_all_images() -> None:
    """Splines attenuate the noise between pixels, along each axis to half of its variance at most."""
    mean = MeanImage(shifted_stack(_texture, noise=NOISE), shifted_parameters(), EVERYWHERE)
    mean.extend(EVERYWHERE)
    y, x = np.mgrid[:72, :96].astype(np.float64)
    error = (mean.grey - _texture(x, y))[INSIDE]
    np.testing.assert_allclose(mean.share[INSIDE], 1 / 9)
    # The standard error of a variance from 3000 pixels is 3 %.
    assert (NOISE / 3) ** 2 / 4 < error.var() < 1.1 * (NOISE / 3) ** 2
    assert abs(error.mean()) < 5 * NOISE / 3 / np.sqrt(error.size)
    # One camera does not show the first columns; three images show the first pixel, which is too few.
    np.testing.assert_allclose(mean.share[INSIDE[0], 3], 1 / 6)
    assert np.isnan(mean.grey[0, 0])


def test_the_mean_image_is_extended_by_the_pixels_that_are_required() -> None:
    images, half = shifted_stack(_texture, noise=NOISE), EVERYWHERE.copy()
    half[:, 48:] = False
    whole = MeanImage(images, shifted_parameters(), EVERYWHERE)
    whole.extend(EVERYWHERE)
    mean = MeanImage(images, shifted_parameters(), EVERYWHERE)
    mean.extend(half)
    assert np.isfinite(mean.grey[INSIDE][:, :32]).all()
    assert np.isnan(mean.grey[:, 48:]).all()
    mean.extend(EVERYWHERE)
    np.testing.assert_array_equal(mean.grey, whole.grey)
    np.testing.assert_array_equal(mean.coefficients, whole.coefficients)


def test_the_mean_image_is_that_of_the_pixels_allowed() -> None:
    allowed = EVERYWHERE.copy()
    allowed[30:40, 40:60] = False
    mean = MeanImage(shifted_stack(_texture), shifted_parameters(), allowed)
    mean.extend(EVERYWHERE)
    np.testing.assert_array_equal(np.isfinite(mean.grey[INSIDE]), allowed[INSIDE])


@pytest.mark.parametrize("std_px", [0.02, 0.4])
def test_outlines_exceed_the_noise_of_the_fits(std_px: float) -> None:
    """A surface that differs by 1.2 px in the farthest camera, a single pixel without a fit, and noise."""
    theta = shifted_parameters()
    theta[0, :, 60:] = DISPARITY + 1.2
    theta[:, 20, 20] = np.nan
    fit = blank_fit(theta, variances=True)
    fit.variance[:] = 0.0
    fit.variance[0] = std_px**2
    expected = np.zeros_like(EVERYWHERE)
    expected[:, 60] = std_px < 0.1
    np.testing.assert_array_equal(find_outlines(shifted_stack(_texture), fit), expected)
