"""Predicted bias of demosaicing against registrations of demosaiced images, and against estimates of a plane."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.camera.sensor import demosaic_wave, predict_displacement, quintic_spline_response
from tests.helpers.demosaiced_waves import (
    STEPS,
    demosaiced_image,
    measured_displacement,
    plane_recording,
    random_waves,
    tensor_displacement,
)
from tests.helpers.nightly import by_night, nightly

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR")
METHODS = ("bilinear", "malvar")
ALL = (*METHODS, "binomial")
GREY, COLOURED = (1.0, 1.0, 1.0), (1.0, 0.5, 0.2)
INNER = (0, slice(14, -14), slice(20, -20))
numbers = some.floats(-3, 3)


@pytest.mark.parametrize("method", ALL)
@given(k=some.tuples(numbers, numbers), pattern=some.sampled_from(PATTERNS), seed=some.integers(0, 99))
def test_four_waves_are_the_demosaiced_image(method: Any, k: tuple[float, float], pattern: str, seed: int) -> None:
    real, imaginary = np.random.default_rng(seed).normal(size=(2, 3))
    wave = demosaic_wave(k, real + 1j * imaginary, pattern, method)
    y, x = np.indices((10, 11)).astype(float)
    total = sum(
        (amplitudes * np.exp(1j * (k_x * x + k_y * y))[..., None]).real
        for (k_x, k_y), amplitudes in zip(wave.wave_vectors, wave.amplitudes, strict=True)
    )
    expected = demosaiced_image([(k, real + 1j * imaginary)], 0.0, (10, 11), pattern, method)
    np.testing.assert_allclose(np.asarray(total)[3:-3, 3:-3], expected[3:-3, 3:-3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("colour", [GREY, COLOURED, (1, 0, 0), (1, 0.5, -0.3j)], ids=str)
@pytest.mark.parametrize("wavelength", [4.5, 6, 10, 18])
@pytest.mark.parametrize("displacement", [0.25, 1.4])
def test_prediction_is_the_registration(method: Any, colour: Any, wavelength: float, displacement: float) -> None:
    k = (2 * np.pi / wavelength, 0.0)
    predicted = predict_displacement([demosaic_wave(k, colour, "GRBG", method)], displacement)
    measured = measured_displacement([(k, colour)], displacement, 180, "GRBG", method)
    # 180 px are whole periods of every wave and alias: both minimise the same function, to the square root of rounding.
    assert predicted == pytest.approx(measured, abs=1e-6)
    assert abs(predicted - displacement) > 5e-4


@pytest.mark.parametrize("colour", [GREY, COLOURED, (1, 0, 0), (0, 1, 0)], ids=str)
@pytest.mark.parametrize("wavelength", [5, 6, 10])
def test_a_binomial_filter_removes_the_bias(colour: Any, wavelength: float) -> None:
    """Its response to the alias of a wave of λ px is sin⁴(π / λ), relative to that of the wave: 0.12 at 5 px."""
    k = (2 * np.pi / wavelength, 0.0)
    predicted = predict_displacement([demosaic_wave(k, colour, "GRBG", "binomial")], 0.3)
    assert predicted == pytest.approx(measured_displacement([(k, colour)], 0.3, 180, "GRBG", "binomial"), abs=1e-6)
    without = predict_displacement([demosaic_wave(k, colour, "GRBG", "bilinear")], 0.3)
    # The power of the alias, relative to that of the wave, decreases to tan⁸(π / λ).
    assert abs(predicted - 0.3) < 1.5 * np.tan(np.pi / wavelength) ** 8 * abs(without - 0.3) + 1e-7


def test_no_bias_from_whole_periods_of_the_pattern() -> None:
    wave = demosaic_wave((2 * np.pi / 6, 0.3), COLOURED, "RGGB", "bilinear")
    for displacement in (0.0, 2.0, -4.0):
        assert predict_displacement([wave], displacement) == pytest.approx(displacement, abs=1e-7)
    once, again = (predict_displacement([wave], displacement) - displacement for displacement in (0.3, 2.3))
    assert once == pytest.approx(again, abs=1e-7)


def test_bias_is_that_of_the_formula_where_it_is_small() -> None:
    k, d = 2 * np.pi / 30, 0.4
    wave = demosaic_wave((k, 0.0), GREY, "RGGB", "bilinear")
    power, own = (np.abs(wave.amplitudes) ** 2).sum(axis=1), wave.wave_vectors[:, 0]
    expected = (power @ (own * np.sin((k - own) * d))) / (power @ (own**2 * np.cos((k - own) * d)))
    bias = predict_displacement([wave], d) - d
    # The next order is κ² b² / 6 of it.
    assert bias == pytest.approx(expected, rel=2e-3)
    assert abs(bias) > 3e-3


@pytest.mark.parametrize(
    ("method", "colour", "wavelength"),
    [
        ("bilinear", COLOURED, 5.0),
        *by_night(*((method, colour, n) for method in ALL for colour in (GREY, COLOURED) for n in (5.0, 6.0, 8.0))),
    ],
)
def test_structure_tensor_has_the_bias_of_its_filters(method: Any, colour: Any, wavelength: float) -> None:
    k, d = (2 * np.pi / wavelength, 0.0), 0.3
    # With a given noise, channels have equal weights.
    recording = plane_recording([(k, colour)], d, "RGGB", method, (40, 90))
    found = st.estimate(recording, "structure_tensor", working_point_px=0, noise_std=0.01)["disparity"].values[INNER]
    predicted = tensor_displacement([demosaic_wave(k, colour, "RGGB", method)], d)
    assert float(np.mean(found)) == pytest.approx(predicted, abs=1e-4)


@nightly
@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("colour", [GREY, COLOURED], ids=str)
@pytest.mark.parametrize(("wavelengths", "displacement"), [((6, 12), 0.3), ((5, 7), 0.5), ((12, 24), 0.3)])
def test_refined_has_the_bias_of_its_splines(
    method: Any, colour: Any, wavelengths: tuple[float, float], displacement: float
) -> None:
    waves = random_waves(*wavelengths, colour)
    recording = plane_recording(waves, displacement, "RGGB", method)
    settings: dict[str, Any] = {"window_sigma_px": 4, "discontinuity_refit": False, "surface": "plane"}
    with warnings.catch_warnings():
        # Large biases are not proportional to the position, and named as errors of the poses.
        warnings.simplefilter("ignore", st.EstimateWarning)
        found = st.estimate(recording, "refined", **settings)["disparity"].values[INNER]
    predicted = predict_displacement(
        [demosaic_wave(k, amplitudes, "RGGB", method) for k, amplitudes in waves],
        displacement,
        STEPS.tolist(),
        response=quintic_spline_response,
        gradient="mean",
    )
    assert float(np.nanmean(found)) == pytest.approx(predicted, abs=1e-3)


def test_grey_values_average_amplitudes() -> None:
    wave = demosaic_wave((2 * np.pi / 8, 0.0), (1, 1, 1), "RGGB", "bilinear")
    joint, grey = (predict_displacement([wave], 0.3, grey=grey) for grey in (False, True))
    # Aliases of red and blue cancel in part in the mean with green.
    assert abs(grey - 0.3) < abs(joint - 0.3)
    assert predict_displacement([wave], 0.3, weights=(0, 1, 0)) == pytest.approx(
        predict_displacement([wave], 0.3, weights=(0, 1, 0), grey=True), abs=1e-9
    )
