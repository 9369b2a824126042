"""Gaussian means, compared with SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from scenetruth.estimators.refined.kernels.smoothing import gaussian_mean


@pytest.mark.parametrize(("sigma", "truncate"), [(1.0, 2.5), (3.0, 4.0), (12.0, 4.0)])
def test_means_are_those_of_scipy(sigma: float, truncate: float) -> None:
    """Also where windows are wider than the map."""
    values = np.random.default_rng(0).normal(size=(40, 70))
    expected = ndimage.gaussian_filter(values, sigma, truncate=truncate)
    np.testing.assert_allclose(gaussian_mean(values, sigma, truncate), expected, atol=1e-14)
    single = gaussian_mean(values.astype(np.float32), sigma, truncate)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, expected, atol=1e-6)
    flags = values > 0
    np.testing.assert_allclose(
        gaussian_mean(flags, sigma, truncate).max(), gaussian_mean(1.0 * flags, sigma, truncate).max()
    )
