"""Windows on a lattice, compared with windows around every pixel."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined import (
    FIT_LIMITS,
    DefectFilteredFrames,
    ImageStack,
    RefinedState,
    Splines,
    lattice_step,
    refine,
)
from tests.helpers.wavy_plane import MovingPlane, turning

PLANE = MovingPlane(gradient=turning(2e-3, -1e-3, 3e-3))


def refined() -> RefinedState:
    recording = PLANE.recording(3, 5)
    noise = np.random.default_rng(0).normal(0.0, 0.01, recording["image"].shape)
    recording = recording.assign(image=(recording["image"].dims, recording["image"].values + noise))
    images = ImageStack(
        Splines(DefectFilteredFrames(recording), 5).frames(0, 5),
        np.stack([recording["s"].values, np.zeros(3)], axis=-1),
        recording["t"].values.astype(float),
        PLANE.focal_px,
        ((PLANE.size[1] - 1) / 2, (PLANE.size[0] - 1) / 2),
        np.zeros((15, 4)),
    )
    return refine(images, PLANE.start(), RefinedSettings(window_sigma_px=4.5, surface="plane", max_iterations=6))


def test_the_step_follows_the_window() -> None:
    """Half the sampling frequency is beyond the pass band of the window: exp(-4 π² σ² f²) is 4e-9 there."""
    for sigma in (1.5, 2.4, 4.0, 6.0, 9.0):
        step = lattice_step(sigma)
        assert step == 1 or np.exp(-4 * np.pi**2 * sigma**2 / (2 * step) ** 2) < 4e-9
    assert (lattice_step(1.4), lattice_step(6.0)) == (1, 4)


def test_fits_of_the_lattice_are_those_of_every_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    """To a tenth of the standard deviation, the limit of the interpolation error."""
    some = refined().fit
    monkeypatch.setattr(FIT_LIMITS, "lattice_step", 0.0)
    every = refined().fit
    known = np.isfinite(every.theta).all(axis=0)
    assert (np.isfinite(some.theta).all(axis=0) == known).mean() > 0.99
    for place, number in ((0, 0), (6, 3), (9, 4), (12, 5)):
        scaled = (some.theta[place] - every.theta[place]) / np.sqrt(every.variance[number])
        assert np.sqrt(np.nanmean(scaled**2)) < 0.1
        ratio = some.variance[number] / every.variance[number]
        # Standard deviations within 5 %.
        assert np.nanquantile(np.abs(ratio - 1), 0.99) < 0.1
