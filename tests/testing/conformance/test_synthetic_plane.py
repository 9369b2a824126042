"""The plane is what it says: images and truth follow from one geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from scenetruth.testing.conformance import SyntheticPlane

# Splines of fifth order through waves of 6 px and more err by less than this, away from the border; measured 1.6e-4
# for the shortest wave alone.
SPLINE = 2e-3
INSIDE = (slice(12, -12), slice(14, -14))


def fetched(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(map_coordinates(image, [y, x], order=5, mode="nearest"))


@pytest.mark.parametrize(
    "plane", [SyntheticPlane(), SyntheticPlane(principal_point_px=(50.0, 10.0), slopes=(-0.4, 0.5))]
)
def test_images_show_the_same_points_where_the_truth_says(plane: SyntheticPlane) -> None:
    images, truth = plane.images(), {name: item.sel(t=0).values for name, item in plane.truth().items()}
    y, x = np.mgrid[: plane.size[0], : plane.size[1]].astype(float)
    here = images[1, 1]
    for s in (-1, 1):
        there = fetched(images[1 + s, 1], x - s * truth["disparity"], y)
        np.testing.assert_allclose(there[INSIDE], here[INSIDE], atol=SPLINE)
    for t in (-1, 1):
        # A point that moves straight: docs/reference/conventions.md.
        share = t * truth["depth"] / (truth["depth"] + t * truth["velocity_z"])
        there = fetched(images[1, 1 + t], x + share * truth["flow_x"], y + share * truth["flow_y"])
        np.testing.assert_allclose(there[INSIDE], here[INSIDE], atol=SPLINE)


def test_images_stay_within_full_scale_and_have_contrast() -> None:
    images = SyntheticPlane(channels=3).images()
    assert images.shape == (3, 3, 56, 72, 3)
    assert 0 <= images.min() < 0.3 and 0.7 < images.max() <= 1  # noqa: PT018
    assert not np.array_equal(images[..., 0], images[..., 1])


def test_images_belong_to_who_asks() -> None:
    plane = SyntheticPlane(size=(20, 24))
    plane.images()[:] = 0
    assert plane.images().min() > 0


def test_a_part_of_the_cameras_and_frames_shows_the_same() -> None:
    many, few = SyntheticPlane(cameras=5, frames=5).images(), SyntheticPlane().images()
    np.testing.assert_array_equal(many[1:4, 1:4], few)
    np.testing.assert_array_equal(replace(SyntheticPlane(), cameras=1).images()[0], few[1])


def test_digital_numbers_are_rounded() -> None:
    recording = SyntheticPlane().recording(dtype=np.uint16, full_scale=65535.0)
    assert recording["image"].dtype == np.uint16
    np.testing.assert_allclose(recording["image"].values / 65535, SyntheticPlane().images(), atol=0.5 / 65535 + 1e-12)
