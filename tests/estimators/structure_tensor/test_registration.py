from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.structure_tensor.registration import (
    find_working_point,
    find_working_point_of_flow,
    registrations_along_surfaces,
)
from scenetruth.schema import STATUS_INVALID


def shifted_noise(disparity: int, seed: int, width: int = 160) -> NDArray[np.float32]:
    """Return five images of a random pattern that moves by whole pixels."""
    pattern = np.random.default_rng(seed).random((24, 5 * width + 40)).astype(np.float32)
    origin = 2 * width
    return np.stack([pattern[:, origin + disparity * s : origin + disparity * s + width] for s in range(-2, 3)])


@settings(max_examples=50, deadline=None)
@given(disparity=some.integers(-40, 40), seed=some.integers(0, 1000))
def test_integer_disparity_is_found(disparity: int, seed: int) -> None:
    assert find_working_point(shifted_noise(disparity, seed)) == disparity


@given(disparity=some.integers(-30, 30), level=some.floats(-1, 1), gain=some.floats(0.1, 2))
@settings(max_examples=20, deadline=None)
def test_brightness_and_contrast_do_not_matter(disparity: int, level: float, gain: float) -> None:
    images = (gain * shifted_noise(disparity, 1) + level).astype(np.float32)
    assert find_working_point(images) == disparity


def test_a_small_textured_object_on_a_dark_background_wins() -> None:
    images = np.full((5, 40, 200), -1, dtype=np.float32)
    patch = np.random.default_rng(0).random((20, 60)).astype(np.float32)
    for index, s in enumerate(range(-2, 3)):
        images[index, 10:30, 70 - 17 * s : 130 - 17 * s] = patch
    assert find_working_point(images) == 17


@pytest.mark.parametrize("value", [0.0, 0.7])
def test_images_without_texture_have_the_working_point_zero(value: float) -> None:
    assert find_working_point(np.full((5, 10, 50), value, dtype=np.float32)) == 0


def test_one_camera_has_the_working_point_zero() -> None:
    assert find_working_point(np.random.default_rng(0).random((1, 10, 50)).astype(np.float32)) == 0


def test_periodic_patterns_take_the_smallest_displacement() -> None:
    x = np.arange(128)
    images = np.stack([np.tile(np.cos(2 * np.pi * (x + 1.0 * s) / 8), (8, 1)) for s in range(-2, 3)]).astype(np.float32)
    assert find_working_point(images) == 1


@settings(max_examples=60, deadline=None)
@given(disparity=some.integers(10, 30), seed=some.integers(0, 10_000), bars=some.integers(1, 12))
def test_no_cell_asks_for_another_disparity_where_cameras_lose_sight(disparity: int, seed: int, bars: int) -> None:
    # Bright bars on a dim pattern: beside the border, what stands in for pixels out of view would match dim places.
    found = registrations_along_surfaces(barred(disparity, seed, bars)[None], np.arange(-2.0, 3.0), 60)
    assert {item.disparity for item in found} == set(range(disparity - 2, disparity + 3))


def barred(disparity: int, seed: int, bars: int) -> NDArray[np.float32]:
    random = np.random.default_rng(seed)
    pattern = 0.02 * random.random((48, 640)).astype(np.float32)
    for start in random.integers(0, 620, bars):
        pattern[:, start : start + 8] = 0.5 + 0.5 * random.random((48, 1))
    return np.stack([pattern[:, 200 + disparity * s : 400 + disparity * s] for s in range(-2, 3)])


@settings(max_examples=25, deadline=None)
@given(disparity=some.integers(10, 30), seed=some.integers(0, 10_000), bars=some.integers(1, 12))
def test_no_disparity_is_false_beside_the_border(disparity: int, seed: int, bars: int) -> None:
    still = np.repeat(barred(disparity, seed, bars)[:, None], 5, axis=1)
    recording = st.make_recording(
        still + np.random.default_rng(seed).normal(0, 0.002, still.shape), 500.0, 5.0, full_scale=1.0
    )
    estimate = st.estimate(recording, tau=0.0, flow_working_point_px=(0, 0))
    known = estimate["status_disparity"].values != STATUS_INVALID
    assert known.any()
    assert np.abs(estimate["disparity"].values[known] - disparity).max() < 1


@settings(max_examples=20, deadline=None)
@given(flow=some.tuples(some.integers(-12, 12), some.integers(-9, 9)), seed=some.integers(0, 1000))
def test_integer_flow_is_found(flow: tuple[int, int], seed: int) -> None:
    pattern = np.random.default_rng(seed).random((140, 180)).astype(np.float32)
    images = np.stack(
        [pattern[40 - flow[1] * t : 100 - flow[1] * t, 50 - flow[0] * t : 130 - flow[0] * t] for t in range(-2, 3)]
    )
    assert find_working_point_of_flow(images) == flow
    # Channels of opposite sign do not cancel.
    assert find_working_point_of_flow(np.stack([images, 1 - images])) == flow


def test_images_at_rest_or_without_texture_have_no_flow() -> None:
    still = np.repeat(np.random.default_rng(0).random((1, 40, 50)), 5, axis=0)
    assert find_working_point_of_flow(still) == (0, 0)
    assert find_working_point_of_flow(np.full((5, 40, 50), 0.3)) == (0, 0)
    assert find_working_point_of_flow(still[:1]) == (0, 0)


def test_periodic_patterns_take_the_smallest_flow() -> None:
    y, x = np.mgrid[:64, :64].astype(np.float64)
    images = np.stack([np.cos(2 * np.pi * (x - 0.2 * t) / 8) * np.cos(2 * np.pi * y / 8) for t in range(5)])
    assert find_working_point_of_flow(images) == (0, 0)
