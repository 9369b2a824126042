"""Error of U_Z in figure 2 of the paper, without noise: by wavelength, phase of the pattern, and window.

Run it from the top of the repository: ``python -m benchmarks.figure2_divergence``; the discretisation of the paper
(``divergence: paper``), U_Z = 0.1, at the image centre. "Phase 0" has a maximum of the pattern there, as eq. 13 has.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.jobs import arguments, heading, line
from scenetruth.estimators import estimate
from scenetruth.schema import STATUS_VALID
from scenetruth.validation_studies.paper_figure2 import REFERENCE_DEPTH, pattern_images, pattern_recording

__all__ = ["relative_errors"]

U_Z = 0.1
COLUMNS = ("wavelength, px", "divergence", "σ, px", "taps", "phase 0, %", "mean, %", "median abs, %", "largest, %")
PAPER, CONSISTENT = {"divergence": "paper"}, {"divergence": "consistent"}
CASES: tuple[tuple[float, dict[str, Any]], ...] = (
    *((wavelength, PAPER) for wavelength in (4, 8, 16, 32)),
    *((wavelength, CONSISTENT) for wavelength in (4, 8, 16, 32)),
    *((wavelength, {**PAPER, "window_taps_px": 61}) for wavelength in (16, 32)),
    *((32, {**PAPER, "window_sigma_px": sigma, "window_taps_px": 4 * sigma + 1}) for sigma in (9, 12)),
)


def relative_errors(wavelength_px: float, settings: dict[str, Any], phases: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the relative error of U_Z at the image centre for phases of the pattern, shape (n, 2)."""
    size = int(settings.get("window_taps_px", 25)) + 4
    images = [
        pattern_images(wavelength_px, velocity=(0.0, 0.0, U_Z), phase=(each[0], each[1]), shape=(5, 9, size, size))
        for each in phases
    ]
    recording = pattern_recording(np.concatenate(images, axis=-1))
    found = estimate(recording, working_point_px=0, flow_working_point_px=(0, 0), tau=0.0012, **settings)
    at = {"t": 0, "y": size // 2, "x": slice(size // 2, None, size)}
    velocity, depth, status = (found[name].isel(at).values for name in ("velocity", "depth", "status"))
    error = velocity[2].astype(np.float64) / depth * REFERENCE_DEPTH / U_Z - 1
    return np.asarray(np.where(status == STATUS_VALID, error, np.nan))


def main() -> None:
    """Print the error at phase 0, and statistics over 64 random phases."""
    arguments(__doc__).parse_args()
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, (64, 2))
    print(heading(COLUMNS))
    for wavelength, settings in CASES:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            (first,) = 100 * relative_errors(wavelength, settings, np.zeros((1, 2)))
            every = 100 * relative_errors(wavelength, settings, phases)
        values = (first, np.nanmean(every), np.nanmedian(np.abs(every)), np.nanmax(np.abs(every)))
        window = settings.get("window_sigma_px", 6), settings.get("window_taps_px", 25)
        print(line([f"{wavelength:g}", settings["divergence"], *window, *(f"{value:.2g}" for value in values)]))


if __name__ == "__main__":
    main()
