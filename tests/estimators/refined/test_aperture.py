"""The structure tensor of the reference against textures whose directions are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenetruth as st
from scenetruth.estimators.refined import compute_normal_flow, find_aperture
from scenetruth.schema import make_recording
from tests.helpers.shifted_stack import DISPARITY, FLOW, Array, shifted_parameters, shifted_stack

SIGMA, SMALL, NOISE = 4.0, 2.0, 0.01
NOWHERE = np.zeros((72, 96), dtype=np.bool_)
INSIDE = (slice(8, -8), slice(8, -8))


def _stripes(angle: float) -> Array:
    along = np.array([np.cos(angle), np.sin(angle)])
    return along


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, 45.0, 130.0])
def test_stripes_determine_the_motion_along_their_gradient_only(angle_deg: float) -> None:
    along = _stripes(np.radians(angle_deg))
    images = shifted_stack(lambda x, y: 0.2 * np.cos(2 * np.pi * (along[0] * x + along[1] * y) / 9), noise=NOISE)
    found = find_aperture(images, shifted_parameters(), SIGMA, NOWHERE, SMALL, NOISE)
    # A threshold of three standard errors is exceeded by chance.
    assert found.normal[INSIDE].mean() > 0.99
    assert found.disparity[INSIDE].all()
    assert np.abs(np.einsum("k,kyx->yx", along, found.direction)[INSIDE]).min() > 0.999


def test_stripes_along_the_stage_determine_no_disparity() -> None:
    images = shifted_stack(lambda _, y: 0.2 * np.cos(2 * np.pi * y / 9), noise=NOISE)
    found = find_aperture(images, shifted_parameters(), SIGMA, NOWHERE, SMALL, NOISE)
    assert not found.disparity[INSIDE].any()
    assert found.normal[INSIDE].all()


def test_a_weak_second_texture_counts_from_its_noise_on() -> None:
    """Amplitudes of 0.03 and of 0.001 across stripes of 0.2, in noise of 0.01."""
    strong, amplitudes = 0.2, ((0.03, 1.0), (0.001, 0.0))
    for weak, share in amplitudes:

        def texture(x: Array, y: Array, weak: float = weak) -> Array:
            return np.asarray(strong * np.cos(2 * np.pi * x / 9) + weak * np.cos(2 * np.pi * y / 7))

        found = find_aperture(shifted_stack(texture, noise=NOISE), shifted_parameters(), SIGMA, NOWHERE, SMALL, NOISE)
        assert found.motion[INSIDE].mean() == pytest.approx(share, abs=0.01)


def test_noise_alone_is_no_texture() -> None:
    images = shifted_stack(lambda x, _: 0.0 * x, noise=NOISE)
    found = find_aperture(images, shifted_parameters(), SIGMA, NOWHERE, SMALL, NOISE)
    assert (found.motion | found.disparity)[INSIDE].mean() < 0.01
    assert found.normal[INSIDE].mean() < 0.02


def test_small_windows_contain_the_pixels_of_their_own_surface_only() -> None:
    """Stripes on the left at another disparity than waves on the right: across the edge, texture does not count."""
    images = shifted_stack(
        lambda x, y: 0.2 * np.cos(2 * np.pi * x / 9) + np.where(x > 48, 0.2 * np.cos(2 * np.pi * y / 7), 0.0)
    )
    theta = shifted_parameters()
    theta[0, :, 49:] += 2.0
    beside = (slice(8, -8), slice(44, 47))
    full = find_aperture(images, theta, SIGMA, NOWHERE, SMALL, NOISE)
    own = find_aperture(images, theta, SIGMA, ~NOWHERE, SMALL, NOISE)
    assert full.motion[beside].all()
    assert own.normal[beside].all()


def test_the_normal_flow_is_the_shortest_with_its_component() -> None:
    generator = np.random.default_rng(0)
    flow, angle = generator.normal(size=(2, 5, 6)), generator.uniform(0, np.pi, (5, 6))
    direction = np.stack([np.cos(angle), np.sin(angle)])
    normal = compute_normal_flow(flow, direction)
    np.testing.assert_allclose((normal * direction).sum(axis=0), (flow * direction).sum(axis=0), atol=1e-14)
    np.testing.assert_allclose(normal[0] * direction[1] - normal[1] * direction[0], 0.0, atol=1e-14)


def test_stripes_without_period_give_disparity_and_the_normal_component_of_motion() -> None:
    """Waves of several lengths along one direction: depth is valid, and the flow is that along the gradient."""
    along = _stripes(np.radians(25.0))

    def texture(x: Array, y: Array) -> Array:
        at = along[0] * x + along[1] * y
        return np.asarray(
            sum(0.05 * np.cos(2 * np.pi * at / length + length) for length in (5.1, 7.3, 11.9, 17.0, 26.3))
        )

    frames = np.arange(-1.0, 2.0)
    generator = np.random.default_rng(5)
    y, x = np.mgrid[:72, :96].astype(np.float64)
    images = [[texture(x + DISPARITY * s - FLOW[0] * t, y - FLOW[1] * t) for t in frames] for s in (-1.0, 0.0, 1.0)]
    recording = make_recording(0.5 + np.array(images) + 1e-3 * generator.normal(size=(3, 3, 72, 96)), 1000.0, 4.0)
    found = st.estimate(recording, "refined", window_sigma_px=4, discontinuity_refit=False, motion="translation")
    found = found.sel(t=0).isel(y=slice(20, -20), x=slice(24, -24))
    normal = found["status"].values == 1
    assert normal.mean() > 0.9
    assert (found["status_disparity"].values[normal] == 2).all()
    assert (found["status_motion"].values[normal] == 1).all()
    assert not found["valid"].values[normal].any()
    assert np.abs(found["disparity"].values[normal] - DISPARITY).max() < 0.02
    expected = (FLOW[0] * along[0] + FLOW[1] * along[1]) * along
    # The motion along the stripes is arbitrary, up to the search range, and the noise of their direction acts on it.
    assert np.abs(found["flow"].values[:, normal] - expected[:, None]).max() < 0.1
    assert np.isfinite(found["velocity"].values[:, normal]).all()
    assert np.isnan(found["velocity_std"].values[:, normal]).all()
    assert np.isfinite(found["depth_std"].values[normal]).all()


EVERYWHERE = ~NOWHERE
# Shown by at least half of the images: within the disparity of the farthest camera and the windows.
SEEN = (slice(8, -8), slice(16, -16))


def test_the_mean_image_reveals_a_texture_that_noise_conceals() -> None:
    """Gradient energy of 1 standard error in one image, of 6 in the mean of nine."""

    def texture(x: Array, y: Array) -> Array:
        return np.asarray(0.03 * np.cos(2 * np.pi * x / 9) + 0.03 * np.cos(2 * np.pi * y / 9))

    images, noise = shifted_stack(texture, noise=0.03), 0.03
    alone = find_aperture(images, shifted_parameters(), SIGMA, NOWHERE, SMALL, noise)
    found = find_aperture(images, shifted_parameters(), SIGMA, NOWHERE, SMALL, noise, EVERYWHERE)
    assert alone.motion[SEEN].mean() < 0.3
    assert (found.motion & found.disparity)[SEEN].mean() > 0.95


def test_the_mean_image_leaves_excluded_images_out() -> None:
    """Images that show something else change nothing if they are excluded, whatever their place is."""

    def texture(x: Array, y: Array) -> Array:
        return np.asarray(0.05 * np.cos(2 * np.pi * x / 9) + 0.05 * np.cos(2 * np.pi * y / 9))

    images = shifted_stack(texture, noise=0.03)
    excluded = frozenset({(0, 1), (2, 0), (2, 2)})
    found = []
    for value in (0.0, 7.0):
        coefficients = [part.copy() for part in images.coefficients]
        for frame, camera in excluded:
            coefficients[frame][:, camera] += np.float32(value)
        stack = replace(images, coefficients=coefficients, left_out=excluded)
        found.append(find_aperture(stack, shifted_parameters(), SIGMA, NOWHERE, SMALL, 0.03, EVERYWHERE))
    assert found[0].motion[SEEN].mean() > 0.9
    for name in ("motion", "disparity", "normal"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_the_mean_image_does_not_invent_a_direction() -> None:
    images = shifted_stack(lambda x, _: 0.1 * np.cos(2 * np.pi * x / 9), noise=0.03)
    found = find_aperture(images, shifted_parameters(), SIGMA, NOWHERE, SMALL, 0.03, EVERYWHERE)
    assert found.normal[SEEN].mean() > 0.99
    bare = find_aperture(
        shifted_stack(lambda x, _: 0.0 * x, noise=0.03), shifted_parameters(), SIGMA, NOWHERE, SMALL, 0.03, EVERYWHERE
    )
    assert (bare.motion | bare.disparity)[SEEN].mean() < 0.02
