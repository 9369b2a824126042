"""Predicted bias of demosaicing against registrations of demosaiced images, and against estimates of a plane."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.camera.sensor import demosaic_wave, predict_displacement
from tests.helpers.demosaiced_waves import (
    demosaiced_image,
    measured_displacement,
    plane_recording,
    random_waves,
    tensor_displacement,
)
from tests.helpers.demosaicing_windows import refined_map, tensor_map
from tests.helpers.nightly import by_night, nightly

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR")
METHODS = ("bilinear", "malvar")
ALL = (*METHODS, "binomial")
GREY, COLOURED = (1.0, 1.0, 1.0), (1.0, 0.5, 0.2)
INNER = (0, slice(14, -14), slice(20, -20))
SMALL = (56, 80)
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


WITHOUT_GAINS: dict[str, Any] = {"photometric_model": "none"}


RED = (1, 0, 0)


@nightly
@pytest.mark.parametrize(
    ("method", "colour", "wavelengths", "settings"),
    [
        (method, colour, wavelengths, settings)
        for method in METHODS
        for colour in (GREY, COLOURED, RED)
        for wavelengths in ((5, 7), (12, 24))
        for settings in ({}, WITHOUT_GAINS)
        # Where aliases are as strong as the texture, no residuals are noise, and iterations end before convergence.
        if (method, colour, settings) != ("malvar", RED, WITHOUT_GAINS)
    ],
)
def test_refined_has_the_bias_of_its_windows(
    method: Any, colour: Any, wavelengths: tuple[float, float], settings: dict[str, Any]
) -> None:
    """Biases of windows at even pixels are interpolated; with both patterns, these have the mean over all pixels."""
    waves, found, predicted = random_waves(*wavelengths, colour, seed=5), [], []
    settings = settings | {"window_sigma_px": 4, "discontinuity_refit": False, "surface": "plane"}
    for pattern in ("RGGB", "BGGR"):
        recording = plane_recording(waves, 0.3, pattern, method, SMALL).assign_attrs(demosaicing=method)
        with warnings.catch_warnings():
            # Large biases are not proportional to the position, and named as errors of the poses.
            warnings.simplefilter("ignore", st.EstimateWarning)
            estimate = st.estimate(recording, "refined", tolerance_px=1e-5, max_iterations=50, **settings)
        behind = [demosaic_wave(k, amplitudes, pattern, method) for k, amplitudes in waves]
        gains = "photometric_model" not in settings
        found.append(estimate["disparity"].values[INNER])
        predicted.append(refined_map(behind, 0.3, SMALL, 4.0, gains=gains)[INNER[1:]])
    valid = np.isfinite(found)
    if (method, colour, wavelengths) == ("malvar", RED, (5, 7)):
        assert not valid.any()
        return
    assert valid.mean() > 0.4
    difference = (np.array(found) - np.array(predicted))[valid]
    # Steps end below 1e-5 px at 90 % of the pixels, and each leaves up to 0.8 of the step before.
    assert abs(float(difference.mean())) < 2e-4
    bias = np.array(found)[valid] - 0.3
    assert abs(float(bias.mean())) > 4e-4


@pytest.mark.parametrize(
    ("method", "colour", "wavelengths"),
    [
        ("bilinear", (1, 0, 0), (5, 7)),
        *by_night(
            *(
                (method, colour, wavelengths)
                for method in METHODS
                for colour in (GREY, COLOURED, (1, 0, 0))
                for wavelengths in ((5, 7), (6, 12), (12, 24))
            )
        ),
    ],
)
def test_structure_tensor_has_the_bias_of_its_windows(
    method: Any, colour: Any, wavelengths: tuple[float, float]
) -> None:
    waves = random_waves(*wavelengths, colour, seed=5)
    recording = plane_recording(waves, 0.3, "GRBG", method, SMALL)
    found = st.estimate(recording, "structure_tensor", working_point_px=0, noise_std=0.01)["disparity"].values[INNER]
    behind = [demosaic_wave(k, amplitudes, "GRBG", method) for k, amplitudes in waves]
    difference = found - tensor_map(behind, 0.3, SMALL)[INNER[1:]]
    # The derivative of the scale, which the prediction does not have, takes part of single residuals.
    assert abs(float(difference.mean())) < 2e-4


def test_grey_values_average_amplitudes() -> None:
    wave = demosaic_wave((2 * np.pi / 8, 0.0), (1, 1, 1), "RGGB", "bilinear")
    joint, grey = (predict_displacement([wave], 0.3, grey=grey) for grey in (False, True))
    # Aliases of red and blue cancel in part in the mean with green.
    assert abs(grey - 0.3) < abs(joint - 0.3)
    assert predict_displacement([wave], 0.3, weights=(0, 1, 0)) == pytest.approx(
        predict_displacement([wave], 0.3, weights=(0, 1, 0), grey=True), abs=1e-9
    )
