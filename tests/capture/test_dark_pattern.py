"""Pattern of dark frames: contained once in images of the same camera, and not in those of another."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.capture import PatternMatch, frame_moments

Floats = NDArray[np.float64]
SHAPE = (120, 160)


def pattern(seed: int, std: float) -> Floats:
    return std * np.random.default_rng([seed, 1]).standard_normal(SHAPE)


def frames(fixed: Floats, light: Floats, count: int, seed: int) -> list[Floats]:
    """Return frames with read noise of 1.5 DN and shot noise, of a gain of 0.4 DN per electron."""
    draw = np.random.default_rng([seed, 2])
    return [
        np.rint(50 + fixed + light + np.sqrt(1.5**2 + 0.4 * light) * draw.standard_normal(SHAPE))
        for _ in range(count)
    ]  # fmt: skip


def matched(fixed: Floats, dark: Floats, seed: int = 3) -> PatternMatch:
    match = PatternMatch(frame_moments(frames(dark, np.zeros(SHAPE), 8, seed)))
    # Smooth areas beside texture, as in images of a board.
    light = np.full(SHAPE, 60.0)
    light[:, 80:] = 900 + 300 * np.random.default_rng(seed).standard_normal((SHAPE[0], 80)).clip(-2, 2)
    for image in frames(fixed, light, 12, seed + 1):
        match.add(image)
    return match


@pytest.mark.parametrize("std", [0.7, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_own_and_foreign_patterns(std: float, seed: int) -> None:
    own, foreign = pattern(seed, std), pattern(seed + 50, std)
    slope, deviation = matched(own, own).slope()
    assert abs(slope - 1) < 4 * deviation + 0.03  # the centre of the window has 1 / 81 of its own weight
    assert deviation < 0.2
    slope, deviation = matched(own, foreign).slope()
    assert abs(slope) < 4 * deviation
    assert slope < 1 - 4 * deviation


def test_a_pattern_below_its_uncertainty_is_not_tested() -> None:
    none = np.zeros(SHAPE)
    match = matched(none, none)
    assert not match.measurable
    assert match.slope()[1] == np.inf


def test_images_without_noise_do_not_count() -> None:
    """Rounding hides the pattern in them."""
    own = pattern(1, 3.0)
    match = PatternMatch(frame_moments(frames(own, np.zeros(SHAPE), 8, 1)))
    match.add(np.full(SHAPE, 300))
    assert match.slope()[1] == np.inf
