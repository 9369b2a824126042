"""Regions against distances found by trying every pair of pixels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scenetruth.errors import ScoreError
from scenetruth.scoring.regions import (
    REGIONS,
    edge_distance,
    further_regions,
    is_further_region,
    region_masks,
    visible_throughout,
)
from scenetruth.scoring.scorer import local_contrast, reference_images
from scenetruth.settings import ScoreSettings
from tests.helpers.synthetic_case import Case, make_growing_case, with_regions

shapes = some.tuples(some.integers(1, 2), some.integers(1, 9), some.integers(1, 9))


def brute_force_distance(mixed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Measure from every pixel to every mixed pixel of its frame."""
    distance = np.full(mixed.shape, math.inf)
    y, x = np.indices(mixed.shape[1:])
    for frame, there in zip(distance, mixed, strict=True):
        for there_y, there_x in np.argwhere(there):
            np.minimum(frame, np.hypot(y - there_y, x - there_x), out=frame)
    return distance


@given(arrays.arrays(bool, shapes))
def test_distance_is_that_to_the_nearest_mixed_pixel(mixed: NDArray[np.bool_]) -> None:
    np.testing.assert_allclose(edge_distance(mixed), brute_force_distance(mixed), rtol=1e-12)


@given(arrays.arrays(bool, (1, 7, 8)), arrays.arrays(bool, (1, 7, 8)), some.integers(0, 5))
def test_interior_is_what_is_far_enough_and_seen(
    mixed: NDArray[np.bool_], seen: NDArray[np.bool_], margin: int
) -> None:
    depth = np.where(seen, 660.0, np.nan)
    masks = region_masks(depth, mixed, float(margin))
    assert tuple(masks) == REGIONS
    np.testing.assert_array_equal(masks["all"], seen)
    np.testing.assert_array_equal(masks["interior"], seen & (brute_force_distance(mixed) >= margin))


def test_distance_of_exactly_the_margin_is_interior() -> None:
    mixed = np.zeros((1, 1, 30), dtype=bool)
    mixed[0, 0, 2] = True
    interior = region_masks(np.ones(mixed.shape), mixed)["interior"][0, 0]
    assert np.flatnonzero(interior).tolist() == list(range(22, 30))


def test_image_border_is_no_silhouette() -> None:
    assert region_masks(np.ones((2, 5, 5)), np.zeros((2, 5, 5), dtype=bool))["interior"].all()


def test_frames_do_not_touch_each_other() -> None:
    mixed = np.zeros((2, 3, 3), dtype=bool)
    mixed[0] = True
    interior = region_masks(np.ones((2, 3, 3)), mixed)["interior"]
    assert not interior[0].any()
    assert interior[1].all()


@pytest.mark.parametrize("margin", [-1.0, math.nan, math.inf])
def test_impossible_margin_is_refused(margin: float) -> None:
    with pytest.raises(ScoreError, match="margin_px: must be a finite number, not negative"):
        region_masks(np.ones((1, 1)), np.zeros((1, 1), dtype=bool), margin)


@pytest.fixture(scope="module")
def told() -> Case:
    return with_regions(make_growing_case(80, 60, 620.0))


def regions_of(case: Case, margin_px: float = 6.0, **settings: Any) -> dict[str, NDArray[np.bool_]]:
    truth = case.truth
    masks = region_masks(truth["depth"].values, truth["mixed"].values, margin_px)
    chosen = ScoreSettings(**settings)
    contrast = local_contrast(reference_images(case.recording, truth["t"].values), chosen.contrast_window_px)
    return masks | further_regions(
        truth, masks["interior"], chosen, throughout=visible_throughout(truth), contrast=contrast
    )


def test_visible_pixels_are_seen_in_every_way(told: Case) -> None:
    regions, truth = regions_of(told), told.truth
    y, x = np.indices((60, 80))
    seen = np.isfinite(truth["depth"].values)
    np.testing.assert_array_equal(regions["nonoccluded"], seen & (x >= 8) & (y >= 6) & (y < 54))
    np.testing.assert_array_equal(regions["occluded"], seen & ~regions["nonoccluded"])
    # What is not seen throughout is told of t = 0 only.
    late = Case(told.recording, told.estimate, truth.assign_coords(t=truth.t + 1))
    masks = region_masks(truth["depth"].values, truth["mixed"].values)
    later = further_regions(late.truth, masks["interior"], ScoreSettings(), throughout=visible_throughout(late.truth))
    np.testing.assert_array_equal(later["nonoccluded"], seen & (x >= 8) & (y >= 6))
    assert visible_throughout(truth.drop_vars("visible")) is None


def test_visibility_of_a_grid_of_cameras_and_of_frames_counts(told: Case) -> None:
    visible = told.truth["visible"]
    grid = told.truth.assign(visible=visible.expand_dims(s_y=3).copy())
    grid["visible"][2, 0, 0, 20] = False
    expected = np.asarray(visible.values.all(axis=(0, 1)))
    expected[20] = False
    np.testing.assert_array_equal(visible_throughout(grid), expected)


@pytest.mark.parametrize(
    ("stem", "among"),
    [("slope", ("nonoccluded", "interior")), ("boundary", ("nonoccluded",)), ("contrast", ("nonoccluded", "interior"))],
)
def test_classes_divide_what_they_are_among(told: Case, stem: str, among: tuple[str, ...]) -> None:
    regions = regions_of(told, contrast_classes=(0.06, 0.09))
    classes = [mask for name, mask in regions.items() if name.startswith(stem)]
    whole = np.logical_and.reduce([regions[name] for name in among])
    np.testing.assert_array_equal(np.sum(classes, axis=0), whole)
    assert sum(mask.any() for mask in classes) > 1


def test_slopes_and_edges_are_told_by_their_bounds(told: Case) -> None:
    truth = told.truth
    regions = regions_of(told, margin_px=0.0)
    angle = 90.0 * np.indices((60, 80))[1] / 79
    inner = regions["interior"] & regions["nonoccluded"]
    for low, high in ((0, 20), (20, 45), (45, 70), (70, 90)):
        np.testing.assert_array_equal(regions[f"slope_{low}_{high}"], inner & (angle >= low) & (angle < high))
    distance = brute_force_distance(truth["mixed"].values)
    inner = regions["nonoccluded"]
    np.testing.assert_array_equal(regions["boundary_0_5"], inner & (distance < 5))
    np.testing.assert_array_equal(regions["boundary_20_inf"], inner & (distance >= 20))
    # Without any edge everything is infinitely far; a truth that tells distances is believed.
    nowhere = Case(told.recording, told.estimate, truth.assign(mixed=truth["mixed"] & False))
    np.testing.assert_array_equal(regions_of(nowhere)["boundary_20_inf"], inner)
    at = Case(told.recording, told.estimate, truth.assign(boundary_distance=truth["depth"] * 0 + 7))
    np.testing.assert_array_equal(regions_of(at)["boundary_5_10"], inner)


def test_surface_seen_edge_on_is_in_the_last_class_of_slopes(told: Case) -> None:
    normal = told.truth["normal"] * 0 + np.array([1.0, 0.0, 0.0])[:, None, None, None]
    regions = regions_of(Case(told.recording, told.estimate, told.truth.assign(normal=normal)))
    np.testing.assert_array_equal(regions["slope_70_90"], regions["interior"] & regions["nonoccluded"])


def test_without_occlusions_all_pixels_count(told: Case) -> None:
    regions = regions_of(Case(told.recording, told.estimate, told.truth.drop_vars("occluded_in_time")))
    assert "nonoccluded" not in regions
    edges = [mask for name, mask in regions.items() if name.startswith("boundary")]
    np.testing.assert_array_equal(np.sum(edges, axis=0), regions["all"])


def test_flags_may_have_become_numbers(told: Case) -> None:
    truth = told.truth
    seen = np.isfinite(truth["depth"])
    flags = {
        name: truth[name].astype(np.float32).where(seen) for name in ("occluded_across_cameras", "occluded_in_time")
    }
    numbers = regions_of(Case(told.recording, told.estimate, truth.assign(flags)))
    for name, mask in regions_of(told).items():
        np.testing.assert_array_equal(numbers[name], mask)


def test_objects_are_told_apart(told: Case) -> None:
    x = np.broadcast_to(np.indices((60, 80))[1], told.truth["depth"].shape)
    number = told.truth["depth"].copy(data=np.where(x < 30, 1, np.where(x < 70, 0, -1)).astype(np.int32))
    names = {"object_names": '["soil", "plant.leaf_1", "never seen"]'}
    several = told.truth.assign(object_id=number).assign_attrs(names)
    regions = regions_of(Case(told.recording, told.estimate, several))
    inner = regions["interior"] & regions["nonoccluded"]
    np.testing.assert_array_equal(regions["object_soil"], inner & (x >= 30) & (x < 70))
    np.testing.assert_array_equal(regions["object_plant.leaf_1"], inner & (x < 30))
    assert "object_never seen" not in regions
    # Of one object there is nothing to tell apart; numbers may have been read as floats.
    one = several.assign_attrs(object_names='["soil"]')
    assert not any(name.startswith("object") for name in regions_of(Case(told.recording, told.estimate, one)))
    floats = several.assign(object_id=number.where(number >= 0).astype(np.float32))
    again = regions_of(Case(told.recording, told.estimate, floats))
    np.testing.assert_array_equal(again["object_soil"], regions["object_soil"])


@pytest.mark.parametrize(
    "name",
    ["nonoccluded", "slope_0_22.5", "boundary_20_inf", "boundary_1e+03_inf", "contrast_mid", "object_plant.leaf 1"],
)
def test_names_of_regions_are_known(name: str) -> None:
    assert is_further_region(name)


@pytest.mark.parametrize("name", ["all", "metadata", "slope", "slope_a_b", "contrast_huge", "edge_-1_2", "object_"])
def test_other_names_are_not(name: str) -> None:
    assert not is_further_region(name)


def test_contrast_is_the_standard_deviation_in_the_window() -> None:
    rng = np.random.default_rng(4)
    image = rng.random((1, 41, 47)) + 100.0
    contrast = local_contrast(image, 3.0)
    y, x = np.indices(image.shape[1:])
    weights = np.exp(-((y - 20) ** 2 + (x - 23) ** 2) / 18.0)
    weights[(abs(y - 20) > 12) | (abs(x - 23) > 12)] = 0
    mean = np.average(image[0], weights=weights)
    expected = math.sqrt(np.average((image[0] - mean) ** 2, weights=weights))
    assert contrast[0, 20, 23] == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(local_contrast(image * 0 + 0.3, 3.0), 0.0, atol=1e-12)


def test_contrast_is_a_fraction_of_full_scale(told: Case) -> None:
    frames = np.array([0])
    image = told.recording["image"]
    expected = image.sel(s=0, t=[0]).values / 255
    np.testing.assert_allclose(reference_images(told.recording, frames), expected)
    linear = told.recording.assign(image=image / 255).assign_attrs(full_scale=1.0)
    np.testing.assert_allclose(reference_images(linear, frames), expected)
    colours = told.recording.assign(image=image.expand_dims(channel=3, axis=-1))
    np.testing.assert_allclose(reference_images(colours, frames), expected)
    rows = told.recording.assign(image=image.expand_dims(s_y=[-1, 0, 1]))
    np.testing.assert_allclose(reference_images(rows, frames), expected)


def test_regions_of_light_are_parts_of_the_visible_interior() -> None:
    case = make_growing_case()
    shape = case.truth["depth"].shape
    share, distance = np.full(shape, 0.05), np.full(shape, np.inf)
    share[..., 10:15], distance[..., 20:30] = (np.nan, 0.1, 0.3, 0.09, 0.1), np.abs(np.arange(-5, 5))
    lit = case.truth.assign(
        specular_share=(case.truth["depth"].dims, share), shadow_distance=(case.truth["depth"].dims, distance)
    )
    inner = np.ones(shape, dtype=bool)
    inner[:, :2] = False
    found = further_regions(lit, inner, ScoreSettings(shadow_width_px=3))
    columns = {name: np.unique(np.nonzero(found[name])[-1]).tolist() for name in ("specular", "shadow_boundary")}
    assert columns == {"specular": [11, 12, 14], "shadow_boundary": list(range(22, 29))}
    assert all(is_further_region(name) and not found[name][:, :2].any() for name in columns)
    assert not {"specular", "shadow_boundary"} & set(further_regions(case.truth, inner, ScoreSettings()))
