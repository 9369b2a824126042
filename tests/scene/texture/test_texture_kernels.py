"""Lookups in rasters beside those of SciPy, and between the values of noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from scenetruth.scene.texture import make_band_limited_noise
from scenetruth.scene.texture.texture_kernels import linear_lookup, spline_lookup

BAND = (0.8, 4.0)


@pytest.mark.parametrize("shape", [(24, 36), (11, 17)])
def test_spline_lookup_against_scipy(shape: tuple[int, int]) -> None:
    generator = np.random.default_rng(2)
    coefficients = generator.standard_normal(shape).astype(np.float32)
    uv = generator.uniform(-2, 3, (500, 2))
    expected = map_coordinates(
        coefficients.astype(np.float64),
        [uv[:, 1] * shape[0] - 0.5, uv[:, 0] * shape[1] - 0.5],
        order=3,
        prefilter=False,
        mode="grid-wrap",
    )
    np.testing.assert_allclose(spline_lookup(coefficients, uv), expected, atol=3e-6)


@pytest.mark.parametrize("shape", [(24, 36), (11, 17)])
@pytest.mark.parametrize(("tiled", "mode"), [(True, "grid-wrap"), (False, "nearest")])
def test_linear_lookup_against_scipy(shape: tuple[int, int], tiled: bool, mode: str) -> None:
    generator = np.random.default_rng(3)
    values = generator.random(shape).astype(np.float32)
    uv = generator.uniform(-2, 3, (500, 2))
    expected = map_coordinates(
        values.astype(np.float64), [uv[:, 1] * shape[0] - 0.5, uv[:, 0] * shape[1] - 0.5], order=1, mode=mode
    )
    np.testing.assert_allclose(linear_lookup(values, uv, tiled), expected, atol=1e-6)


def test_spline_coefficients_interpolate_the_values() -> None:
    noise = make_band_limited_noise(BAND, (20, 20), np.random.default_rng(1))
    rows, columns = noise.values.shape
    y, x = np.mgrid[:rows, :columns]
    uv = np.column_stack([(x.ravel() + 0.5) / columns, (y.ravel() + 0.5) / rows])
    # float32 coefficients and weights.
    np.testing.assert_allclose(spline_lookup(noise.coefficients, uv), noise.values.ravel(), atol=5e-6)


def test_noise_between_raster_points_is_the_band_limited_signal() -> None:
    noise = make_band_limited_noise(BAND, (20, 20), np.random.default_rng(4))
    rows, columns = noise.values.shape
    spectrum = np.fft.rfft2(noise.values.astype(np.float64))
    # Exact trigonometric interpolation half a texel off, by the shift theorem.
    k_x, k_y = np.fft.rfftfreq(columns), np.fft.fftfreq(rows)
    shifted = np.fft.irfft2(spectrum * np.exp(2j * np.pi * 0.5 * (k_x[None] + k_y[:, None])), (rows, columns))
    y, x = np.mgrid[:rows, :columns]
    uv = np.column_stack([(x.ravel() + 1.0) / columns, (y.ravel() + 1.0) / rows])
    # A cubic B-spline at 16 samples a wavelength: (1/16)^4 of the amplitude.
    np.testing.assert_allclose(spline_lookup(noise.coefficients, uv), shifted.ravel(), atol=4 * 16**-4 * 4)
