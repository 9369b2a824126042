"""Rival minima of textures that repeat, and their absence in others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import ImageStack, find_ambiguous, find_aperture, find_chance_fits, image_motion
from tests.helpers.nightly import by_night
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


def _find(images: ImageStack, theta: Array, prior: float | None = None, noise: float = NOISE) -> NDArray[np.bool_]:
    aperture = find_aperture(images, theta, SIGMA, ~EVERYWHERE, SMALL, noise)
    return find_ambiguous(images, theta, SIGMA, ~EVERYWHERE, SMALL, noise, EVERYWHERE, aperture, prior)


def _share(images: ImageStack, theta: Array, prior: float | None = None, noise: float = NOISE) -> float:
    return float(_find(images, theta, prior, noise)[INSIDE].mean())


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


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_the_mean_image_excludes_rivals_that_noise_conceals_in_single_images(noise: float) -> None:
    """Waves of standard deviation 0.13: at a noise of 0.1, four images leave a rival everywhere."""
    assert _share(shifted_stack(_waves, noise=noise), shifted_parameters(), noise=noise) < 0.1
    assert _share(shifted_stack(_plaid, noise=noise), shifted_parameters(), noise=noise) == 1.0


@pytest.mark.parametrize("contrast", [0.2, 0.4])
def test_the_mean_image_of_a_wrong_period_excludes_no_rival(contrast: float) -> None:
    """It averages out the second texture, which contradicts that period."""
    noise = 0.05

    def texture(x: Array, y: Array) -> Array:
        return np.asarray(_periodic_downwards(x, y) + contrast * _waves(y, x))

    wrong = shifted_parameters(flow=(FLOW[0], FLOW[1] + 8.0))
    assert _share(shifted_stack(texture, noise=noise), wrong, noise=noise) == 1.0


def test_at_the_border_rivals_that_images_contradict_do_not_count() -> None:
    """Windows of a coarse texture resemble others by chance, where few pixels of the rival are inside the images."""

    def coarse(x: Array, y: Array) -> Array:
        generator = np.random.default_rng(3)
        lengths, angles = np.exp(generator.uniform(np.log(14), np.log(40), 40)), generator.uniform(0, 2 * np.pi, 40)
        phases = generator.uniform(0, 2 * np.pi, 40)
        at = [(np.cos(a) * x + np.sin(a) * y) / n + p for a, n, p in zip(angles, lengths, phases, strict=True)]
        return np.asarray(0.03 * np.cos(2 * np.pi * np.array(at)).sum(axis=0))

    assert not _find(shifted_stack(coarse, noise=NOISE), shifted_parameters()).any()
    assert _find(shifted_stack(_plaid, noise=NOISE), shifted_parameters()).all()


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


def _beside_nothing(texture: Callable[[Array, Array], Array]) -> float:
    """Return the share of ambiguous pixels of an island of 12 px, around which no window has a fit."""
    images, theta, island = shifted_stack(texture, noise=NOISE), shifted_parameters(), np.zeros_like(EVERYWHERE)
    island[30:42, 42:54] = True
    aperture = find_aperture(images, theta, SIGMA, ~EVERYWHERE, SMALL, NOISE)
    return float(find_ambiguous(images, theta, SIGMA, ~EVERYWHERE, SMALL, NOISE, island, aperture, None)[island].mean())


def test_islands_of_fits_amid_a_texture_that_repeats_are_ambiguous() -> None:
    """A weak second texture excludes rivals at nine of ten pixels, but windows without a fit do not."""

    def repeating(x: Array, y: Array) -> Array:
        return 2.0 * _plaid(x, y) + 0.3 * _waves(x, y)

    assert _share(shifted_stack(repeating, noise=NOISE), shifted_parameters()) < 0.2
    assert _beside_nothing(repeating) == 1.0
    assert _beside_nothing(_waves) == 0.0


def test_pixels_that_fit_amid_others_that_do_not_fit_by_chance() -> None:
    """In windows of 4 px, shares are those of 33 x 33 px: 6 % of an island of 8 px, and half at a straight border."""
    tested, violated = np.ones((120, 160), dtype=np.bool_), np.ones((120, 160), dtype=np.bool_)
    violated[56:64, 40:48], violated[:, 120:] = False, False
    expected = np.zeros_like(tested)
    expected[56:64, 40:48] = True
    np.testing.assert_array_equal(find_chance_fits(violated, tested, 4.0), expected)
    # A thin leaf before a background that is not tested.
    tested[:, :] = False
    tested[:, 60:63] = True
    assert not find_chance_fits(~tested, tested, 4.0).any()


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


@pytest.mark.parametrize("whole_waves", [1, *by_night(2)])
def test_a_periodic_texture_has_the_same_images_at_several_depths(whole_waves: int) -> None:
    """A plaid at 100 mm, and a finer one so near that each step of the stage displaces it by further whole waves.

    Rays and waves are those of float64: 1e-6 of full scale are left.
    """
    focal_px, baseline_mm, wave_px = 500.0, 1.0, 16.0
    images, depths = [], []
    for disparity_px in (5.0, 5.0 + whole_waves * wave_px):
        depth_mm = focal_px * baseline_mm / disparity_px
        wavelength_mm = wave_px * depth_mm / focal_px
        plaid = {
            "name": "plaid",
            "mesh": {"kind": "plane", "size_mm": [4000, 4000]},
            "pose": {"position_mm": [0, 0, depth_mm]},
            "texture": {"kind": "plaid", "wavelength_mm": [wavelength_mm, wavelength_mm]},
        }
        scene: dict[str, Any] = {
            "camera": {"width": 40, "height": 30, "focal_length_px": focal_px},
            "stage": {"positions": 5, "baseline_mm": baseline_mm},
            "frames": {"count": 1},
            "objects": [plaid],
            "render": {"supersampling": 1},
        }
        found = st.simulate(scene)
        images.append(found.recording["image"].values)
        depths.append(float(found.truth["depth"].max()))
    assert depths[0] > 4 * depths[1]
    np.testing.assert_allclose(images[1], images[0], atol=1e-6)
    assert images[0].std() > 0.1
