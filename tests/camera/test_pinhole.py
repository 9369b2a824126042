from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from pydantic import ValidationError

from scenetruth.camera import Camera


def test_centre_of_the_image_is_the_default_principal_point() -> None:
    assert Camera(width=640, height=480, focal_length_px=1).principal_point == (319.5, 239.5)


def test_focal_length_in_millimetres() -> None:
    assert Camera(width=4, height=4, focal_length_mm=25, pixel_pitch_um=5).focal_px == pytest.approx(5000, rel=1e-15)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"focal_length_mm": 25},
        {"pixel_pitch_um": 5},
        {"focal_length_px": 1, "focal_length_mm": 25, "pixel_pitch_um": 5},
    ],
)
def test_focal_length_is_given_exactly_once(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match="focal_length_px"):
        Camera(width=4, height=4, **wrong)


def test_signs_of_the_axes() -> None:
    camera = Camera(width=101, height=101, focal_length_px=100)
    right_and_below = camera.project([10.0, 20.0, 100.0])
    assert right_and_below.tolist() == [60, 70]
    # A camera further to the right sees the point further to the left (paper eq. 3).
    assert camera.project([10.0, 20.0, 100.0], camera_x_mm=5.0).tolist() == [55, 70]


@given(
    pixel=some.tuples(some.floats(-1e3, 1e3), some.floats(-1e3, 1e3)),
    depth=some.floats(1, 1e4),
    position=some.floats(-100, 100),
)
def test_a_point_on_a_ray_projects_back_to_its_pixel(pixel: tuple[float, float], depth: float, position: float) -> None:
    camera = Camera(width=640, height=480, focal_length_px=5016, principal_point_px=(300.25, 250.75))
    point = depth * camera.ray_directions(pixel) + [position, 0, 0]
    # Rounding of the position against the depth, seen through the focal length.
    tolerance = 1e-11 * (1 + 5016 * abs(position) / depth)
    np.testing.assert_allclose(camera.project(point, position), pixel, rtol=1e-12, atol=tolerance)
