"""Interpolation errors of fine waves: amplitude against simulation, and what is added to the variances."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

import scenetruth as st
from scenetruth.camera import demosaic
from scenetruth.camera.sensor import demosaic_wave
from scenetruth.estimators.channel_noise import DEMOSAICED_NOISE
from scenetruth.estimators.refined import (
    Fit,
    blank_fit,
    compute_phase_error_px,
    enlarge_variances,
    interpolation_error,
    measure_noise_coupling,
)
from scenetruth.schema.variables import MOTION_ACCELERATED_IN_PART, MOTION_PLAIN
from tests.helpers.demosaiced_waves import demosaiced_image, plane_recording, random_waves
from tests.helpers.nightly import by_night, nightly
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


@pytest.mark.parametrize("method", ["bilinear", "malvar"])
def test_aliases_of_demosaicing_follow_from_the_reference(method: Any) -> None:
    """The mean of wave numbers over the power of aliases, relative to that of their squares over all power.

    The filter of aliases passes 0.0014 of the wave, which has 25 to 60 times their power: 2 to 4 %.
    """
    colour, k = (1.0, 0.4, 0.2), (2 * np.pi / 8, 0.0)
    grey = demosaiced_image([(k, colour)], 0.0, (72, 96), "RGGB", method)
    images = shifted_stack(lambda x, y: 0.0 * x)
    coefficients = [np.stack([spline_filter(each, 5, mode="mirror") for each in np.moveaxis(grey, -1, 0)])[:, None]]
    single = replace(
        images,
        coefficients=[each.astype(np.float32) for each in coefficients],
        positions=np.zeros((1, 2)),
        times=np.zeros(1),
        demosaiced=DEMOSAICED_NOISE[method],
    )
    found, _ = compute_phase_error_px(single, SIGMA, 1e-6, aliases=True)
    wave = demosaic_wave(k, colour, "RGGB", method)
    power, along = (np.abs(wave.amplitudes) ** 2).sum(axis=1), np.abs(wave.wave_vectors[:, 0])
    expected = (power * along)[along > np.pi / 2].sum() / (power * along**2).sum()
    assert np.median(found[0, 4:-4, 6:-6]) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("method", "wavelength", "colour"),
    [
        ("bilinear", 8.0, (1.0, 0.4, 0.2)),
        ("malvar", 7.0, (1.0, 1.0, 0.6)),
        *by_night(
            ("malvar", 9.0, (0.2, 1.0, 0.3)), ("binomial", 10.0, (0.3, 1.0, 0.3)), ("binomial", 14.0, (1.0, 1.0, 1.0))
        ),
    ],
)
def test_noise_of_demosaicing_moves_a_fit_as_predicted(
    method: Any, wavelength: float, colour: tuple[float, ...]
) -> None:
    """Drawn noise of sensor pixels, demosaiced, and weighted with the gradient of a wave in Gaussian windows.

    60 draws of about 25 independent windows: the scatter of a mean square is sqrt(2 / (60 * 25)), 4 %, and three times
    that is allowed. The drawn noise has the exact wave, the prediction the demosaiced one.
    """
    k, sigma, shape = 2 * np.pi / wavelength, 6.0, (96, 128)
    wave = demosaiced_image([((k, 0.0), colour)], 0.0, shape, "RGGB", method)
    coefficients = [np.stack([spline_filter(each, 5, mode="mirror") for each in np.moveaxis(wave, -1, 0)])[:, None]]
    images = replace(
        shifted_stack(lambda x, y: 0.0 * x),
        coefficients=[each.astype(np.float32) for each in coefficients],
        positions=np.zeros((1, 2)),
        times=np.zeros(1),
        demosaiced=DEMOSAICED_NOISE[method],
    )
    coupling = np.asarray(measure_noise_coupling(images, sigma, 1e-9))
    slope = -k * np.sin(k * np.arange(shape[1]))[None, :, None] * np.array(colour)
    drawn, squares = np.random.default_rng(1), np.zeros(shape)
    for _ in range(60):
        noise = demosaic(drawn.normal(size=shape), "RGGB", method)
        squares = squares + gaussian_filter((noise * slope).sum(axis=2), sigma) ** 2 / 60
    # Of white noise: the square of the window's weights has the width σ / sqrt 2.
    power = DEMOSAICED_NOISE[method].of_pixels * np.mean(_variances(method))
    white = (
        power
        * gaussian_filter(np.broadcast_to((slope**2).sum(axis=2), shape), sigma / np.sqrt(2))
        / (4 * np.pi * sigma**2)
    )
    inner = (slice(24, -24), slice(24, -24))
    measured = float(np.mean(squares[inner]) / np.mean(white[inner]))
    assert float(np.mean(coupling[inner])) == pytest.approx(measured, rel=0.12)


def _variances(method: Any) -> list[float]:
    """Return the variance of demosaiced noise by colour."""
    noise = demosaic(np.random.default_rng(2).normal(size=(400, 400)), "RGGB", method)
    return [float(np.var(noise[..., channel])) for channel in range(3)]


def test_noise_of_demosaicing_is_no_curvature() -> None:
    """A plane behind ``binomial``, whose noise at low frequencies is several times that of its pixels."""
    drawn, recording = (
        np.random.default_rng(5),
        plane_recording(random_waves(6, 14, (1, 1, 1)), 0.3, "RGGB", "binomial"),
    )
    images = recording["image"].copy()
    noise = [demosaic(drawn.normal(0, 0.02, images.shape[2:4]), "RGGB", "binomial") for _ in range(images.shape[0])]
    images += np.array(noise, dtype=np.float32)[:, None]
    settings: dict[str, Any] = {"window_sigma_px": 4, "discontinuity_refit": False}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        noisy = recording.assign(image=images).assign_attrs(demosaicing="binomial")
        estimate = st.estimate(noisy, "refined", **settings).isel(t=0)
    inner = estimate.isel(y=slice(14, -14), x=slice(20, -20))
    # Curvature of white noise exceeds the test in about 1 % of the windows.
    assert float((inner["surface_model"] == 3).mean()) < 0.04
    scaled = (inner["disparity"] - 0.3) / inner["disparity_std"]
    assert 0.6 < float(np.sqrt((scaled**2).mean())) < 1.2


@nightly
@pytest.mark.parametrize(
    ("wavelengths", "colour", "method"),
    [
        ((6, 12), (1.0, 0.5, 0.2), "malvar"),
        ((5, 7), (1.0, 1.0, 1.0), "bilinear"),
        ((5, 7), (1.0, 0.5, 0.2), "malvar"),
    ],
)
def test_uncertainty_includes_the_bias_of_demosaicing(wavelengths: Any, colour: Any, method: Any) -> None:
    recording = plane_recording(random_waves(wavelengths[0], wavelengths[1], colour), 0.3, "RGGB", method)
    settings: dict[str, Any] = {"window_sigma_px": 4, "discontinuity_refit": False, "surface": "plane"}
    with warnings.catch_warnings():
        # Biases are named as errors of the poses.
        warnings.simplefilter("ignore", st.EstimateWarning)
        estimate = st.estimate(recording.assign_attrs(demosaicing=method), "refined", **settings).isel(t=0)
    inner = {"y": slice(14, -14), "x": slice(20, -20)}
    scaled = ((estimate["disparity"] - 0.3) / estimate["disparity_std"]).isel(inner)
    assert float(estimate["valid"].isel(inner).mean()) > 0.9
    # All errors are biases of one sign; amplitudes are those before interpolation, which removes a part of the aliases.
    # Three draws of the waves gave 0.65 to 0.84, and 1.23 in single windows.
    assert 0.5 < float(np.sqrt((scaled**2).mean())) < 1.0
    assert float(np.abs(scaled).max()) < 1.5
