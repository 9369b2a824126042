from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from scenetruth.scene.texture import make_band_limited_noise

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
