"""The plug-in package of phase correlation: known shifts, and a rendered scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from tests.helpers.installed_plugins import offer_package
from tests.helpers.scenes import plaid


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offer_package("phase_correlation", tmp_path, monkeypatch)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (-1.25, 2.0)])
def test_shifts_of_a_noise_pattern_are_found(shift: tuple[float, float]) -> None:
    size = 96
    rng = np.random.default_rng(2)
    k_y, k_x = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    # Hardly any wavelength under 5 px; shifted exactly by its phases.
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) * np.exp(-((np.hypot(k_x, k_y) / 0.1) ** 2))
    frames = [
        np.fft.ifft2(spectrum * np.exp(-2j * np.pi * t * (k_x * shift[0] + k_y * shift[1]))).real for t in (-1, 0, 1)
    ]
    images = 0.5 + 0.3 * np.array(frames) / np.abs(frames).max()
    estimate = st.estimate(st.make_recording(images[None], 500.0, 1.0), "phase_correlation", block_px=32)
    error = estimate["flow"].sel(t=0) - np.reshape(shift, (2, 1, 1))
    # What enters and leaves a block of 32 px is in one of its two images only: 5 % of the shift.
    assert float(np.sqrt((error**2).mean())) < 0.01 + 0.05 * np.hypot(*shift)
    assert estimate.attrs["method"] == "phase_correlation"


def test_it_is_scored_on_flow_alone() -> None:
    recording, truth = st.simulate(plaid(8, (4.0, -2.0, 0.0)))
    estimate = st.estimate(recording, "phase_correlation")
    scored = st.score(estimate, truth, recording).regions["all"]
    rms = scored["flow_x"]["rmse"]
    assert rms is not None
    assert rms < 0.1
    assert "depth" not in scored


def test_too_large_blocks_are_refused() -> None:
    recording = st.make_recording(np.zeros((1, 3, 20, 30)), 500.0, 1.0)
    with pytest.raises(st.EstimateError, match=r"estimate\.block_px: must be at most 20"):
        st.estimate(recording, "phase_correlation")
