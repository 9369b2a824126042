"""Bias of displacements between demosaiced images, measured and predicted, as tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.demosaicing``.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from benchmarks.jobs import heading, line
from tests.helpers.demosaiced_waves import (
    STEPS,
    Waves,
    measured_displacement,
    plane_recording,
    random_waves,
    tensor_displacement,
)

import scenetruth as st
from scenetruth.camera.sensor import demosaic_wave, predict_displacement, quintic_spline_response

METHODS: tuple[Any, ...] = ("bilinear", "malvar")
COLOURS = {"grey": (1.0, 1.0, 1.0), "coloured": (1.0, 0.5, 0.2), "red": (1.0, 0.0, 0.0)}
WAVELENGTHS = (5.0, 6.0, 8.0, 10.0, 15.0, 24.0)
TEXTURES = ((5.0, 7.0), (6.0, 12.0), (12.0, 24.0))
DISPLACEMENT_PX = 0.3
PATTERN = "RGGB"
PERIOD_PX = 240
INNER = (0, slice(14, -14), slice(20, -20))


def measured(recording: Any, method: str, **settings: Any) -> float:
    """Return the bias of the disparity in px per step, averaged over the inner pixels."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        estimate = st.estimate(recording, method, **settings)
    return float(np.nanmean(estimate["disparity"].values[INNER])) - DISPLACEMENT_PX


def both(of_images: float, predicted: float) -> str:
    """Return two biases in 1e-3 px."""
    return f"{1e3 * of_images:.2f} ({1e3 * predicted:.2f})"


def single_wave(wavelength: float, colour: Any, method: Any) -> list[str]:
    """Return the biases of a registration of two images, and of the structure tensor."""
    waves: Waves = [((2 * np.pi / wavelength, 0.0), colour)]
    behind = [demosaic_wave(k, amplitudes, PATTERN, method) for k, amplitudes in waves]
    registered = measured_displacement(waves, DISPLACEMENT_PX, PERIOD_PX, PATTERN, method) - DISPLACEMENT_PX
    recording = plane_recording(waves, DISPLACEMENT_PX, PATTERN, method, (40, 90))
    tensor = measured(recording, "structure_tensor", working_point_px=0, noise_std=0.01)
    return [
        both(registered, predict_displacement(behind, DISPLACEMENT_PX) - DISPLACEMENT_PX),
        both(tensor, tensor_displacement(behind, DISPLACEMENT_PX) - DISPLACEMENT_PX),
    ]


def texture(wavelengths: tuple[float, float], colour: Any, method: Any) -> list[str]:
    """Return the biases of both methods on a texture of random waves."""
    waves = random_waves(*wavelengths, colour)
    behind = [demosaic_wave(k, amplitudes, PATTERN, method) for k, amplitudes in waves]
    recording = plane_recording(waves, DISPLACEMENT_PX, PATTERN, method)
    refined = measured(recording, "refined", window_sigma_px=4, discontinuity_refit=False, surface="plane")
    predicted = predict_displacement(
        behind, DISPLACEMENT_PX, STEPS.tolist(), response=quintic_spline_response, gradient="mean"
    )
    tensor = measured(recording, "structure_tensor", working_point_px=0, noise_std=0.01)
    return [
        both(refined, predicted - DISPLACEMENT_PX),
        both(tensor, tensor_displacement(behind, DISPLACEMENT_PX) - DISPLACEMENT_PX),
    ]


def main() -> None:
    """Print the tables."""
    print(f"Bias at {DISPLACEMENT_PX} px, in 1e-3 px: measured (predicted).\n")
    print(
        heading(["wavelength, px", "colour", *(f"{m}, {what}" for m in METHODS for what in ("two images", "tensor"))])
    )
    for wavelength in WAVELENGTHS:
        for name, colour in COLOURS.items():
            print(
                line([f"{wavelength:g}", name, *(each for m in METHODS for each in single_wave(wavelength, colour, m))])
            )
    print()
    print(heading(["wavelengths, px", "colour", *(f"{m}, {what}" for m in METHODS for what in ("refined", "tensor"))]))
    for low, high in TEXTURES:
        for name, colour in COLOURS.items():
            cells = [each for m in METHODS for each in texture((low, high), colour, m)]
            print(line([f"{low:g} to {high:g}", name, *cells]))


if __name__ == "__main__":
    main()
