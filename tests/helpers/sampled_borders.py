"""Borders of visible surfaces by dense sampling, as a reference."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from scenetruth.camera import Camera
from scenetruth.raycast import RayCaster

__all__ = ["FINE", "sampled_borders", "sampled_directions"]


FINE = 16


@cache
def sampled_directions(camera: Camera) -> NDArray[np.float64]:
    """Directions of 16 x 16 rays for each pixel, shape (y, x, 3); a lens that distorts takes long to invert."""
    steps = np.arange(camera.height * FINE + 1), np.arange(camera.width * FINE + 1)
    y, x = np.meshgrid(*(axis / FINE - 0.5 for axis in steps), indexing="ij")
    return camera.ray_directions(np.stack([x, y], axis=-1))


def sampled_borders(caster: RayCaster, camera: Camera, x_mm: float, group: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether a pixel's footprint, sampled 16 x 16 with its borders, shows more than one group of faces."""
    directions = sampled_directions(camera)
    hits = caster.cast(np.array([x_mm, 0, 0]), directions.reshape(-1, 3), grid_width=directions.shape[1])
    groups = np.where(hits.face >= 0, group[hits.face], -1).reshape(directions.shape[:2])
    low, high = (
        filtered(groups, FINE + 1)[FINE // 2 :: FINE, FINE // 2 :: FINE]
        for filtered in (minimum_filter, maximum_filter)
    )
    return np.asarray((low != high)[: camera.height, : camera.width])
