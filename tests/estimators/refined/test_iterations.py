"""The rounds: from how far they arrive, and what they take together."""

from __future__ import annotations

import numpy as np
import pytest

import scenetruth as st
from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined import FIT_LIMITS, DefectFilteredFrames, ImageStack, Splines, refine
from tests.helpers.curved_surface import curved
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane, turning

PLANE = MovingPlane(gradient=turning(2e-3, -1e-3, 3e-3))
SETTINGS = RefinedSettings(window_sigma_px=4.0, surface="plane", max_iterations=12)


def images_of(plane: MovingPlane, cameras: int = 5, frames: int = 9) -> ImageStack:
    recording = plane.recording(cameras, frames)
    splines = Splines(DefectFilteredFrames(recording), 5).frames(0, frames)
    positions = np.stack([recording["s"].values, np.zeros(cameras)], axis=-1)
    times = recording["t"].values.astype(float)
    return ImageStack(
        splines,
        positions,
        times,
        plane.focal_px,
        ((plane.size[1] - 1) / 2, (plane.size[0] - 1) / 2),
        np.zeros((len(positions) * len(times), 4)),
    )


@pytest.mark.parametrize(
    "off",
    [
        (-1.0, 0.1, -0.1, 0.0),
        pytest.param((0.0, -0.15, 0.15, -0.5), marks=nightly),
        pytest.param((1.0, 0.0, 0.0, 0.0), marks=nightly),
        pytest.param((0.5, 0.0, 0.0, 0.5), marks=nightly),
    ],
)
def test_rounds_arrive_from_starts_that_are_off(off: tuple[float, ...]) -> None:
    """By 1 px of disparity, 1.2 px per frame of motion, 2 mm per frame of U_Z: waves are 5 to 20 px long."""
    images, truth = images_of(PLANE), PLANE.start()
    inside = (slice(None), slice(14, -14), slice(34, -34))
    found = refine(images, truth + np.reshape(off, (4, 1, 1)), SETTINGS)
    best = refine(images, truth, SETTINGS)
    difference = np.abs(found.fit.theta - best.fit.theta)[[0, 6, 9, 12]][inside]
    # They end when nothing moves by a thousandth of a pixel in the outermost images, 2 steps and 4 frames away.
    assert (difference.max(axis=(1, 2)) < [1e-3, 5e-5, 5e-5, 5e-3]).mean() == 1.0
    assert found.rounds <= SETTINGS.max_iterations


def test_bands_of_rows_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    images, start = images_of(PLANE), PLANE.start()
    whole = refine(images, start, SETTINGS)
    monkeypatch.setattr(FIT_LIMITS, "scratch_bytes", 1.0)
    parts = refine(images, start, SETTINGS)
    for one, other in zip(whole.fit, parts.fit, strict=True):
        np.testing.assert_array_equal(one, other)


def test_threads_change_nothing() -> None:
    import numba

    images, start = images_of(PLANE), PLANE.start()
    both = refine(images, start, SETTINGS)
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone = refine(images, start, SETTINGS)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(both.fit.theta, alone.fit.theta)


@nightly
def test_a_curved_surface_is_told_from_a_plane() -> None:
    """A plane in a window of sigma w is off by bend w² / 2, here 0.02 px, where it is curved; else curvature costs."""
    inside = {"y": slice(14, -14), "x": slice(34, -34)}
    recording, truth = curved(2e-3, 0.01)
    found = {
        surface: st.estimate(recording, "refined", window_sigma_px=5, surface=surface, discontinuity_refit=False).isel(
            t=0
        )
        for surface in ("auto", "plane", "curved")
    }
    rms = {}
    for surface, each in found.items():
        error = (each["disparity"] - truth).isel(inside).values
        rms[surface] = np.sqrt(np.mean(error**2))
    assert rms["plane"] > 0.015
    assert rms["auto"] < 0.6 * rms["plane"]
    assert rms["auto"] == pytest.approx(rms["curved"], rel=0.1)
    flat, _ = curved(0.0, 0.01)
    plain, either = (
        st.estimate(flat, "refined", window_sigma_px=5, surface=surface, discontinuity_refit=False)["disparity"] - 8.0
        for surface in ("plane", "auto")
    )
    plain, either = (each.isel({**inside, "t": 0}) for each in (plain, either))
    assert np.sqrt(np.mean(either**2)) < 1.1 * np.sqrt(np.mean(plain**2))
