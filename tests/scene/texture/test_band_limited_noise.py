from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from scenetruth.scene.texture.band_limited_noise import make_band_limited_noise
from scenetruth.scene.texture.texture_kernels import linear_lookup, spline_lookup

BAND = (0.8, 4.0)


@pytest.mark.parametrize("exponent", [-2.0, 0.0, 1.0])
def test_spectrum_is_zero_outside_the_band_and_follows_its_exponent_inside(exponent: float) -> None:
    noise = make_band_limited_noise(BAND, (60, 40), np.random.default_rng(5), exponent=exponent, peak=4.5)
    rows, columns = noise.values.shape
    power = np.abs(np.fft.fft2(noise.values.astype(np.float64))) ** 2
    pitch = noise.period[0] / columns
    frequency = np.hypot(np.fft.fftfreq(rows, pitch)[:, None], np.fft.fftfreq(columns, pitch)[None])
    inside = (frequency >= 1 / BAND[1] * (1 - 1e-9)) & (frequency <= 1 / BAND[0] * (1 + 1e-9))
    # Outside only float32 rounding remains: 2^-24 relative, squared, spread evenly over all frequencies.
    assert power[~inside].sum() / power.sum() < 1e-13
    edges = np.linspace(1 / BAND[1], 1 / BAND[0], 6)
    centres, means, counts = [], [], []
    for low, high in pairwise(edges):
        ring = (frequency >= low) & (frequency < high) & inside
        centres.append(np.exp(np.log(frequency[ring]).mean()))
        means.append(power[ring].mean() / (frequency[ring] ** exponent).mean())
        counts.append(ring.sum() / 2)
    # Each ring's mean power scatters by 1/sqrt(n) for n independent modes; 5 of these, and 2 % for the limited peaks.
    level = np.average(means, weights=counts)
    assert np.all(np.abs(np.array(means) / level - 1) < 5 / np.sqrt(counts) + 0.02)


@pytest.mark.parametrize("peak", [3.0, 4.0])
def test_variance_mean_and_extremes(peak: float) -> None:
    noise = make_band_limited_noise(BAND, (60, 40), np.random.default_rng(6), peak=peak)
    assert noise.values.std() == pytest.approx(1, abs=1e-6)
    assert noise.values.mean() == pytest.approx(0, abs=1e-6)
    assert np.abs(noise.values).max() <= peak * 1.015


def test_same_generator_state_same_noise_other_state_other_noise() -> None:
    one, two, three = (make_band_limited_noise(BAND, (20, 20), np.random.default_rng(n)).values for n in (1, 1, 2))
    assert (one == two).all()
    assert abs(np.corrcoef(one.ravel(), three.ravel())[0, 1]) < 0.2


def test_spline_coefficients_interpolate_the_values() -> None:
    noise = make_band_limited_noise(BAND, (20, 20), np.random.default_rng(1))
    rows, columns = noise.values.shape
    y, x = np.mgrid[:rows, :columns]
    uv = np.column_stack([(x.ravel() + 0.5) / columns, (y.ravel() + 0.5) / rows])
    # float32 coefficients and weights.
    np.testing.assert_allclose(spline_lookup(noise.coefficients, uv), noise.values.ravel(), atol=5e-6)


def test_spline_lookup_against_scipy() -> None:
    generator = np.random.default_rng(2)
    coefficients = generator.standard_normal((24, 36)).astype(np.float32)
    uv = generator.uniform(-2, 3, (500, 2))
    expected = map_coordinates(
        coefficients.astype(np.float64),
        [uv[:, 1] * 24 - 0.5, uv[:, 0] * 36 - 0.5],
        order=3,
        prefilter=False,
        mode="grid-wrap",
    )
    np.testing.assert_allclose(spline_lookup(coefficients, uv), expected, atol=3e-6)


@pytest.mark.parametrize(("tiled", "mode"), [(True, "grid-wrap"), (False, "nearest")])
def test_linear_lookup_against_scipy(tiled: bool, mode: str) -> None:
    generator = np.random.default_rng(3)
    values = generator.random((24, 36)).astype(np.float32)
    uv = generator.uniform(-2, 3, (500, 2))
    expected = map_coordinates(
        values.astype(np.float64), [uv[:, 1] * 24 - 0.5, uv[:, 0] * 36 - 0.5], order=1, mode=mode
    )
    np.testing.assert_allclose(linear_lookup(values, uv, tiled), expected, atol=1e-6)


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
