"""Residuals by aliases of demosaicing are separated from noise, of any power of both."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.refined import project_aliases, separate

CAMERAS, FRAMES, PIXELS = 5, 3, 2000
S, T = np.tile(np.arange(CAMERAS) - 2.0, FRAMES)[:, None], np.repeat(np.arange(FRAMES) - 1.0, CAMERAS)[:, None]


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("along", [0, 1], ids=["x", "y"])
def test_aliases_are_separated_from_noise(noise: float, along: int) -> None:
    """Amplitudes of any phase at every pixel, at disparities around 5.3 px, with motions of 0.4 and 0.7 px per frame.

    Of the power of aliases, the prior leaves (1 / 8.5)² as residual, which is 2.4 % of that of noise with 8 of 14
    degrees of freedom. The means have standard errors of 1 to 2 %.
    """
    drawn = np.random.default_rng(1)
    disparity = 5.3 + 0.1 * drawn.random(PIXELS)
    positions = 50.0 - disparity * S + 0.4 * T, 40.0 + 0.7 * T + 0.0 * disparity
    amplitude = drawn.normal(size=(2, PIXELS))
    phase = np.pi * positions[along]
    aliases = amplitude[0] * np.cos(phase) + amplitude[1] * np.sin(phase)
    images = 7.0 + aliases + noise * drawn.normal(size=(len(S), PIXELS))
    sums = project_aliases(images, *positions)
    excess, *powers = separate(sums.mean(axis=1))
    left = np.mean(np.var(aliases, axis=0, ddof=1))
    allowed = 0.05 * (1.0 + noise**2)
    assert excess == pytest.approx(left, abs=allowed)
    assert sums[2].mean() / sums[3].mean() == pytest.approx(noise**2, abs=0.04 * (1.0 + noise**2))
    # The mean square of the amplitudes is 1, twice the power of one carrier; half of it may be that of another one.
    assert 0.6 - 3 * allowed < powers[along] < 1.2 + 3 * allowed
    assert powers[1 - along] < 0.5 + 3 * allowed


def test_noise_alone_has_no_aliases() -> None:
    """The standard error of the excess is below 1 % of the noise."""
    drawn = np.random.default_rng(2)
    positions = 50.0 - 5.3 * S + np.zeros(PIXELS), 40.0 + 0.7 * T + np.zeros(PIXELS)
    found = separate(project_aliases(drawn.normal(size=(len(S), PIXELS)), *positions).mean(axis=1))
    assert np.all(found < [0.02, 0.1, 0.1])


def test_aliases_of_equal_phase_in_all_images_are_no_residual() -> None:
    positions = 50.0 - 6.0 * S + np.zeros(PIXELS), 40.0 + 0.0 * S + np.zeros(PIXELS)
    images = 1.0 + np.cos(np.pi * positions[0]) * np.random.default_rng(3).normal(size=PIXELS)
    np.testing.assert_allclose(separate(project_aliases(images, *positions).mean(axis=1)), 0.0, atol=1e-12)
