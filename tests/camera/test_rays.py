"""Rays that the images of a camera share."""

from __future__ import annotations

import gc

import numpy as np

from scenetruth.camera import Camera, Distortion, pixel_rays
from scenetruth.camera import pinhole as module


def camera(**changes: object) -> Camera:
    return Camera.model_validate({"width": 7, "height": 5, "focal_length_px": 100, **changes})


def test_equal_cameras_share_their_rays_and_others_do_not() -> None:
    one, same, other = camera(), camera(), camera(distortion=Distortion(k1=0.1))
    assert pixel_rays(one) is pixel_rays(same)
    assert pixel_rays(one).directions is pixel_rays(same).directions
    assert pixel_rays(other) is not pixel_rays(one)
    for item in (one, other):
        expected = item.ray_directions(item.pixel_grid()).reshape(-1, 3)
        np.testing.assert_array_equal(pixel_rays(item).directions, expected)
        for found, step in zip(pixel_rays(item).steps, item.ray_steps(item.pixel_grid().reshape(-1, 2)), strict=True):
            np.testing.assert_array_equal(found, step)


def test_rays_go_with_their_camera() -> None:
    item = camera(width=11)
    assert pixel_rays(item).directions.shape == (55, 3)
    before = len(module._rays_by_camera)
    del item
    gc.collect()
    assert len(module._rays_by_camera) == before - 1
