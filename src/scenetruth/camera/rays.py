"""The rays of a camera's pixels, computed once per camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.pinhole import Camera

__all__ = ["PixelRays", "pixel_rays"]


@dataclass(frozen=True, eq=False)
class PixelRays:
    """The rays through the pixel centres of a camera; the arrays are shared, and must not be changed.

    Parameters
    ----------
    camera
        The camera.
    """

    camera: Camera

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Directions of the rays through the pixel centres, row by row, scaled to Z = 1; shape (n, 3)."""
        return self.camera.ray_directions(self.camera.pixel_grid()).reshape(-1, 3)

    @cached_property
    def steps(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Steps of the directions per pixel to the right and down; see `Camera.ray_steps`."""
        return self.camera.ray_steps(self.camera.pixel_grid().reshape(-1, 2))


_known: WeakKeyDictionary[Camera, PixelRays] = WeakKeyDictionary()


def pixel_rays(camera: Camera) -> PixelRays:
    """Return the rays of a camera's pixels; they are kept for as long as the camera lives.

    Parameters
    ----------
    camera
        The camera.

    Returns
    -------
    PixelRays
        The same object for equal cameras.
    """
    rays = _known.get(camera)
    if rays is None:
        # With a camera of its own, or the key would be kept alive by its value.
        rays = _known[camera] = PixelRays(camera.model_copy())
    return rays
