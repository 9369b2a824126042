"""Rival minima of textures that repeat, and their absence in others."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.refined import ImageStack, find_ambiguous, find_aperture, image_motion
from tests.helpers.shifted_stack import FLOW, Array, shifted_parameters, shifted_stack

SIGMA, SMALL, NOISE = 4.0, 2.5, 0.01
EVERYWHERE = np.ones((72, 96), dtype=np.bool_)
INSIDE = (slice(12, -12), slice(16, -16))


def _waves(x: Array, y: Array) -> Array:
    """Return 40 waves of 5 to 20 px in all directions."""
    generator = np.random.default_rng(2)
    lengths, angles = np.exp(generator.uniform(np.log(5), np.log(20), 40)), generator.uniform(0, 2 * np.pi, 40)
    phases = generator.uniform(0, 2 * np.pi, 40)
    at = [
        np.cos(2 * np.pi * (np.cos(a) * x + np.sin(a) * y) / n + p)
        for a, n, p in zip(angles, lengths, phases, strict=True)
    ]
    return np.asarray(0.03 * np.sum(at, axis=0))


def _plaid(x: Array, y: Array) -> Array:
    return np.asarray(0.1 * (np.cos(2 * np.pi * x / 8) + np.cos(2 * np.pi * y / 8)))


def _periodic_downwards(x: Array, y: Array) -> Array:
    """Return a texture whose disparity is unique, and whose motion is not."""
    return np.asarray(_waves(x, 0.0 * y) + 0.1 * np.cos(2 * np.pi * y / 8))


def _share(images: ImageStack, theta: Array, prior: float | None = None) -> float:
    aperture = find_aperture(images, theta, SIGMA, ~EVERYWHERE, SMALL, NOISE)
    found = find_ambiguous(images, theta, SIGMA, ~EVERYWHERE, SMALL, NOISE, EVERYWHERE, aperture, prior)
    return float(found[INSIDE].mean())


def test_a_texture_that_repeats_is_ambiguous() -> None:
    assert _share(shifted_stack(_plaid, noise=NOISE), shifted_parameters()) == 1.0


@pytest.mark.parametrize("noise", [0.002, NOISE])
def test_a_texture_without_period_is_not(noise: float) -> None:
    assert _share(shifted_stack(_waves, noise=noise), shifted_parameters()) == 0.0


def test_a_prior_on_motion_decides_between_periods() -> None:
    """Motions of 0.67 px and of about 8 px fit equally well; a prior of 4 px excludes the second."""
    images = shifted_stack(_periodic_downwards, noise=NOISE)
    assert _share(images, shifted_parameters()) == 1.0
    assert _share(images, shifted_parameters(), 4.0) == 0.0
    assert _share(images, shifted_parameters(flow=(FLOW[0], FLOW[1] + 8.0)), 4.0) == 1.0


def test_the_wrong_one_of_two_minima_is_ambiguous_too() -> None:
    """A weak second texture tells the right period; a fit in another period has a rival of less cost."""
    images = shifted_stack(lambda x, y: _periodic_downwards(x, y) + 0.4 * _waves(y, x), noise=NOISE)
    assert _share(images, shifted_parameters()) < 0.05
    assert _share(images, shifted_parameters(flow=(FLOW[0], FLOW[1] + 8.0))) > 0.9


def _board(x: Array, y: Array) -> Array:
    """Return a board with periods (7.75, -6.75) and (5, 9), and waves that repeat after twice the first one only."""
    first, second = np.array([7.75, -6.75]), np.array([5.0, 9.0])
    u, v = np.tensordot(np.linalg.inv(np.stack([first, second], axis=1)), np.stack([x, y]), axes=1)
    generator = np.random.default_rng(4)
    length = 2.0 * np.hypot(*first)
    along = 2.0 * (x * first[0] + y * first[1]) / length
    across = 2.0 * (y * first[0] - x * first[1]) / length
    waves = np.zeros_like(x)
    for order in generator.choice([1, 3], 40):
        period, phase = generator.uniform(6, 20) * generator.choice([-1, 1]), generator.uniform(0, 2 * np.pi)
        waves += np.cos(2 * np.pi * (order * along / length + across / period) + phase)
    squares = np.tanh(4.0 * np.cos(2 * np.pi * u)) * np.tanh(4.0 * np.cos(2 * np.pi * v))
    return np.asarray(0.2 * squares + 0.012 * waves)


def test_the_only_rival_of_equal_cost_is_found_among_many_that_resemble() -> None:
    """The waves tell all periods of the board apart but one, which is not that of the smallest dissimilarity."""
    assert _share(shifted_stack(_board, noise=0.002), shifted_parameters()) > 0.9


def test_the_image_motion_is_that_of_the_points() -> None:
    theta = shifted_parameters()
    theta[12] = 0.5
    images = shifted_stack(_waves)
    found = image_motion(images, theta)
    d, q_z = theta[0, 0, 0], 0.5
    x = 10 - images.centre[0]
    # x' = (x + d t q_X) / (1 + t d q_Z / f), for a short time.
    step = 1e-4
    moved = ((x + FLOW[0] * step) / (1.0 + step * d * q_z / images.focal) - x) / step
    assert found[0, 5, 10] == pytest.approx(moved, abs=1e-5)
