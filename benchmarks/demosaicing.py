"""Bias of displacements between demosaiced images, measured and predicted, as tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.demosaicing``.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

import scenetruth as st
from benchmarks.jobs import heading, line
from scenetruth.camera.sensor import demosaic_wave, predict_displacement
from tests.helpers.demosaiced_waves import (
    Waves,
    measured_displacement,
    plane_recording,
    random_waves,
    tensor_displacement,
)
from tests.helpers.demosaicing_windows import refined_map, tensor_map

METHODS: tuple[Any, ...] = ("bilinear", "malvar")
COLOURS = {"grey": (1.0, 1.0, 1.0), "coloured": (1.0, 0.5, 0.2), "red": (1.0, 0.0, 0.0)}
WAVELENGTHS = (5.0, 6.0, 8.0, 10.0, 15.0, 24.0)
TEXTURES = ((5.0, 7.0), (6.0, 12.0), (12.0, 24.0))
DISPLACEMENT_PX = 0.3
PATTERN = "RGGB"
PERIOD_PX = 240
SEEDS = (1, 2)
REFINED: dict[str, Any] = {
    "window_sigma_px": 4,
    "discontinuity_refit": False,
    "surface": "plane",
    "tolerance_px": 1e-5,
    "max_iterations": 50,
}
INNER = (0, slice(14, -14), slice(20, -20))


def disparity(recording: Any, method: str, **settings: Any) -> Any:
    """Return the estimated disparity in px per step."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        return st.estimate(recording, method, **settings)["disparity"].values


def both(of_images: float, predicted: float) -> str:
    """Return two biases in 1e-3 px."""
    if np.isnan(of_images):
        return "none valid"
    return f"{1e3 * of_images:.2f} ({1e3 * predicted:.2f})"


def single_wave(wavelength: float, colour: Any, method: Any) -> list[str]:
    """Return the biases of a registration of two images, and of the structure tensor."""
    waves: Waves = [((2 * np.pi / wavelength, 0.0), colour)]
    behind = [demosaic_wave(k, amplitudes, PATTERN, method) for k, amplitudes in waves]
    registered = measured_displacement(waves, DISPLACEMENT_PX, PERIOD_PX, PATTERN, method) - DISPLACEMENT_PX
    recording = plane_recording(waves, DISPLACEMENT_PX, PATTERN, method, (40, 90))
    tensor = disparity(recording, "structure_tensor", working_point_px=0, noise_std=0.01)[INNER]
    return [
        both(registered, predict_displacement(behind, DISPLACEMENT_PX) - DISPLACEMENT_PX),
        both(float(tensor.mean()) - DISPLACEMENT_PX, tensor_displacement(behind, DISPLACEMENT_PX) - DISPLACEMENT_PX),
    ]


def texture(wavelengths: tuple[float, float], colour: Any, method: Any, seed: int) -> list[tuple[float, float]]:
    """Return measured and predicted biases of both methods on a texture of random waves.

    ``refined`` fits windows at even pixels and interpolates between: two patterns have each colour at all distances.
    """
    waves, found = random_waves(*wavelengths, colour, seed=seed), []
    for pattern in (PATTERN, PATTERN[::-1]):
        behind = [demosaic_wave(k, amplitudes, pattern, method) for k, amplitudes in waves]
        recording = plane_recording(waves, DISPLACEMENT_PX, pattern, method).assign_attrs(demosaicing=method)
        shape = (recording.sizes["y"], recording.sizes["x"])
        estimates = (
            disparity(recording, "refined", **REFINED),
            disparity(recording, "structure_tensor", working_point_px=0, noise_std=0.01),
        )
        predicted = (
            refined_map(behind, DISPLACEMENT_PX, shape, REFINED["window_sigma_px"]),
            tensor_map(behind, DISPLACEMENT_PX, shape),
        )
        found.append([(one[INNER], of[None][INNER]) for one, of in zip(estimates, predicted, strict=True)])
    return [mean_biases(each) for each in zip(*found, strict=True)]


def mean_biases(maps: Any) -> tuple[float, float]:
    """Return the mean bias of estimates, and of predictions at their valid pixels; NaN without valid pixels."""
    measured, predicted = (np.concatenate([pair[n].ravel() for pair in maps]) for n in (0, 1))
    valid = np.isfinite(measured)
    if not valid.any():
        return float("nan"), float("nan")
    return float(measured[valid].mean()) - DISPLACEMENT_PX, float(predicted[valid].mean()) - DISPLACEMENT_PX


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
    differences: dict[int, list[float]] = {}
    for seed in SEEDS:
        for low, high in TEXTURES:
            for name, colour in COLOURS.items():
                cells = [each for m in METHODS for each in texture((low, high), colour, m, seed)]
                differences.setdefault(seed, []).extend(abs(one - other) for one, other in cells)
                if seed == SEEDS[0]:
                    print(line([f"{low:g} to {high:g}", name, *(both(*each) for each in cells)]))
    print("\nLargest difference in 1e-3 px, by draw of the waves:")
    print(", ".join(f"{seed}: {1e3 * np.nanmax(each):.3f}" for seed, each in differences.items()))


if __name__ == "__main__":
    main()
