"""Interpolation errors of fine waves: amplitude against simulation, and what is added to the variances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter

from scenetruth.estimators.refined import Fit, blank_fit, compute_phase_error_px, enlarge_variances, interpolation_error
from scenetruth.schema.variables import MOTION_ACCELERATED_IN_PART, MOTION_PLAIN
from tests.helpers.shifted_stack import Array, shifted_parameters, shifted_stack

SIGMA, NOISE = 5.0, 0.005
INSIDE = (slice(None), slice(12, -12), slice(16, -16))


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize("frequency", [0.3, 0.4])
def test_a_wave_is_displaced_by_the_amplitude_at_a_quarter_of_a_pixel(frequency: float, order: int) -> None:
    at = np.arange(400.0)
    coefficients = spline_filter(np.cos(2 * np.pi * frequency * at)[None], order, mode="mirror")
    inner = np.arange(100.0, 300.0) + 0.25
    values = map_coordinates(coefficients, [0 * inner, inner], order=order, prefilter=False, mode="mirror")
    phase = np.angle(np.exp(-2j * np.pi * frequency * inner) @ values)
    expected = -interpolation_error(frequency, order) / (2 * np.pi * frequency)
    # The first order of the amplitude, without the component at f + 1.
    assert phase / (2 * np.pi * frequency) == pytest.approx(
        expected, rel=2 * interpolation_error(frequency, order) + 0.1
    )


def _wave(frequency: float) -> Callable[[Array, Array], Array]:
    return lambda x, y: 0.2 * np.cos(2 * np.pi * frequency * x) + 0.2 * np.cos(2 * np.pi * 0.1 * y)


@pytest.mark.parametrize("frequency", [0.35, 0.4, 0.45])
def test_the_amplitude_follows_from_the_reference(frequency: float) -> None:
    images = shifted_stack(_wave(frequency), noise=NOISE)
    found, block = compute_phase_error_px(images, SIGMA, NOISE)
    assert found.shape[1:] == (-(-72 // block), -(-96 // block))
    inner = found[:, 6:-6, 6:-6]
    assert np.median(inner[0]) == pytest.approx(interpolation_error(frequency, 5) / (2 * np.pi * frequency), rel=0.1)
    # Along y, the waves are long.
    assert np.median(inner[1]) < 1e-3


def test_noise_is_no_fine_texture() -> None:
    images = shifted_stack(lambda x, y: 0.1 * np.cos(2 * np.pi * x / 10) + 0.1 * np.cos(2 * np.pi * y / 10), noise=0.05)
    found, _ = compute_phase_error_px(images, SIGMA, 0.05)
    inner = found[:, 6:-6, 6:-6]
    assert np.mean(inner > 0) < 0.02


def _fit(theta: Array) -> Fit:
    fit = blank_fit(theta, variances=True)
    fit.variance[:] = 1e-8
    fit.element_variance[:] = 1e-6
    fit.images[:] = 9.0
    fit.residual[:] = np.reshape([NOISE**2, 1e-2], (2, 1, 1))
    return fit


def test_fine_textures_enlarge_the_variances_by_the_errors_of_their_phases() -> None:
    """At a disparity of 6.3 px and a flow of 0.6 px, the phases of nine images follow from 6.3 s and 0.6 t."""
    frequency = 0.4
    images = shifted_stack(_wave(frequency), noise=NOISE)
    theta = shifted_parameters()
    found = enlarge_variances(images, _fit(theta), np.full((72, 96), MOTION_PLAIN, np.int8), SIGMA, accelerated=False)
    amplitude = interpolation_error(frequency, 5) / (2 * np.pi * frequency)
    s, t = np.tile([-1.0, 0.0, 1.0], 3), np.repeat([-1.0, 0.0, 1.0], 3)
    shifts = amplitude * np.sin(2 * np.pi * (0.6 * t - 6.3 * s))
    of_d = (-s @ shifts / 6) ** 2 + 0.5 * amplitude**2 / 6
    of_u = (t @ shifts / 6) ** 2 + 0.5 * amplitude**2 / 6
    added = (found.variance - 1e-8)[INSIDE]
    assert np.median(added[0]) == pytest.approx(of_d, rel=0.25)
    assert np.median(added[3]) * 6.3**2 == pytest.approx(of_u, rel=0.25)
    assert np.median(added[4]) < 1e-2 * np.median(added[3])


def test_textures_longer_than_four_pixels_change_nothing() -> None:
    """An amplitude of 2e-4 px at waves of 5 px, against a standard deviation of 0.002 px."""
    images = shifted_stack(lambda x, y: 0.2 * np.cos(2 * np.pi * x / 5) + 0.2 * np.cos(2 * np.pi * y / 6), noise=NOISE)
    fit = _fit(shifted_parameters())
    # Those of q_Z are larger by (f / d)².
    fit.variance[:] = 4e-6
    fit.variance[5] *= (images.focal / 6.3) ** 2
    in_part = np.full((72, 96), MOTION_ACCELERATED_IN_PART, np.int8)
    found = enlarge_variances(images, fit, in_part, SIGMA, accelerated=False)
    assert np.max(np.sqrt(found.variance / fit.variance)[INSIDE]) < 1.03
