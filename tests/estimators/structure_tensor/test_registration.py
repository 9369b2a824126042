"""Registration of images, also of motions of many pixels per frame, and in tiles."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.structure_tensor import (
    CELL,
    Rectangle,
    find_working_point,
    find_working_point_of_flow,
    registrations_along_surfaces,
    split_into_tiles,
)
from scenetruth.schema import STATUS_INVALID, STATUS_VALID
from tests.helpers.analytic_plane import Plane
from tests.helpers.nightly import by_night, nightly


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


STAGE = np.arange(5.0) - 2


def median_errors(plane: Plane, frames: int, **settings: Any) -> tuple[dict[str, float], float]:
    estimate = st.estimate(plane.recording(STAGE, frames), **settings).sel(t=0)
    truth = plane.truth()
    known = estimate["status"].values == STATUS_VALID
    return {
        name: float(np.median(np.abs(estimate[name].values - truth[name])[..., known]))
        for name in ("disparity", "flow", "divergence", "velocity")
    }, float(known.mean())


FAST = Plane(velocity=(2.1, -1.6, 0.3), size=(104, 120))


@pytest.mark.parametrize("settings", [{"flow_working_point_px": (4, -3)}, {}, {"pyramid_levels": 1}], ids=str)
def test_registration_in_time(settings: dict[str, Any]) -> None:
    """Flow (4.2, -3.2) px per frame."""
    found, known = median_errors(FAST, 9, **settings)
    assert known >= 0.2
    assert found["disparity"] <= 1e-4
    assert found["flow"] <= 1e-4
    # Of u_z = 6e-4: a registered frame sees the scene expand about another point, and a flow that grows with u_z.
    assert found["divergence"] <= 0.05 * 6e-4
    assert found["velocity"] <= 0.01


def test_without_registration_it_fails() -> None:
    found, _ = median_errors(FAST, 9, flow_working_point_px=(0, 0), tau=0.0)
    assert found["flow"] >= 1


@pytest.mark.parametrize("levels", [2, *by_night(1)])
def test_coarse_to_fine_finds_flows_that_vary_over_the_image(levels: int) -> None:
    """A near camera: from -5 to 5 px per frame, of which no single integer flow suits more than a part."""
    plane = Plane(
        focal_length_px=100, depth_mm=100.0, velocity=(0.0, 0.0, -6.0), size=(150, 180), wavelengths_px=(9, 40)
    )
    _, part = median_errors(plane, 5)
    found, known = median_errors(plane, 5, pyramid_levels=levels)
    assert known >= 0.3
    assert found["flow"] <= 0.05
    assert part < known
    assert found["velocity"] <= 0.2


def test_points_registered_by_hand_and_by_the_images_agree() -> None:
    by_hand = st.estimate(FAST.recording(STAGE, 9), working_point_px=2, flow_working_point_px=(4, -3))
    by_images = st.estimate(FAST.recording(STAGE, 9), working_point_px="auto", flow_working_point_px="auto")
    assert [2, 4, -3] in json.loads(by_images.attrs["working_points_px"])
    both = (by_hand["status"].values == STATUS_VALID) & (by_images["status"].values == STATUS_VALID)
    assert both.sum() > 1000
    np.testing.assert_array_equal(by_hand["depth"].values[both], by_images["depth"].values[both])


def test_working_points_of_each_pixel_follow_a_slope() -> None:
    """Disparities from 7 to 13 px: wherever the images reach, each pixel takes the integer next to its own."""
    plane = Plane(depth_mm=100.0, slope=3.0, size=(64, 240), velocity=(0.01, 0.0, -0.02))
    recording = plane.recording(STAGE, 9)
    truth = plane.truth()["disparity"]
    assert truth.min() < 7
    assert truth.max() > 12.5
    each = st.estimate(recording).isel(t=0)
    known = each["status"].values == STATUS_VALID
    assert known.mean() >= 0.35
    away = np.abs(each["registration_disparity"].values - truth)[known]
    assert np.quantile(away, 0.95) <= 0.7
    error = np.abs(each["disparity"].values - truth)
    for single in (7, 9, 10, 11, 13):
        one = st.estimate(recording, working_point_px=single).isel(t=0)
        other = np.abs(one["disparity"].values - truth)
        both = known & (one["status"].values == STATUS_VALID)
        # Where the single one is next to the disparity too, both are the same.
        assert np.sqrt(np.mean(error[both] ** 2)) <= np.sqrt(np.mean(other[both] ** 2)) + 1e-6


@nightly
@pytest.mark.parametrize("levels", [2, *by_night(3)])
def test_coarse_to_fine_keeps_a_far_background_of_fine_texture(levels: int) -> None:
    """Waves of 4 to 8 px are gone at a quarter of the resolution, where only what is near and coarse is left."""
    near, far = (
        Plane(depth_mm=300.0, velocity=(2.0, 0.0, 0.0), size=(160, 240), wavelengths_px=(12.0, 40.0)),
        Plane(depth_mm=1200.0, velocity=(0.05, 0.0, 0.0), size=(160, 240), wavelengths_px=(4.0, 8.0)),
    )
    recording, background = near.recording(STAGE, 9), far.recording(STAGE, 9)["image"]
    image = recording["image"].copy()
    image[..., 110:] = background[..., 110:].values
    behind = {"x": slice(135, 220), "y": slice(20, -20)}
    density = {}
    for number in (0, levels):
        found = st.estimate(recording.assign(image=image), tau="auto", pyramid_levels=number).sel(t=0).isel(behind)
        known = found["status"].values == STATUS_VALID
        density[number] = known.mean()
        assert np.abs(found["depth"].values[known] / 1200.0 - 1).max() < 0.01
    assert density[0] > 0.9
    assert density[levels] == pytest.approx(density[0], abs=0.02)


@given(
    area=some.tuples(some.integers(0, 200), some.integers(0, 400), some.integers(0, 200), some.integers(0, 1500)),
    threads=some.integers(1, 16),
)
def test_tiles_cover_an_area_once(area: tuple[int, int, int, int], threads: int) -> None:
    counted = np.zeros((400, 1500), dtype=int)
    for top, bottom, left, right in split_into_tiles(Rectangle(*area), None, threads):
        assert top < bottom
        assert left < right
        counted[top:bottom, left:right] += 1
    expected = np.zeros_like(counted)
    if area[0] < area[1] and area[2] < area[3]:
        expected[area[0] : area[1], area[2] : area[3]] = 1
    assert (counted == expected).all()


@given(
    area=some.tuples(some.integers(0, 60), some.integers(0, 170), some.integers(0, 60), some.integers(0, 260)),
    seed=some.integers(0, 999),
    share=some.floats(0, 1),
)
def test_tiles_of_cells_cover_all_that_is_wanted_and_nothing_twice(
    area: tuple[int, int, int, int], seed: int, share: float
) -> None:
    rows, columns = 11, 17
    cells = np.random.default_rng(seed).random((rows, columns)) < share
    counted = np.zeros((rows * CELL, columns * CELL), dtype=int)
    for top, bottom, left, right in split_into_tiles(Rectangle(*area), cells, 2):
        assert area[0] <= top < bottom <= area[1]
        assert area[2] <= left < right <= area[3]
        counted[top:bottom, left:right] += 1
    assert counted.max() <= 1
    wanted = np.kron(cells, np.ones((CELL, CELL), dtype=bool))
    inside = np.zeros_like(wanted)
    inside[area[0] : max(area[1], area[0]), area[2] : max(area[3], area[2])] = True
    assert (counted[wanted & inside] == 1).all()
