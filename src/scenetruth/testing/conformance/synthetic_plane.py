"""A moving textured plane with closed-form images and truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, DTypeLike, NDArray

from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording

__all__ = ["SyntheticPlane"]

Array = NDArray[np.float64]

_WAVES = 10
_WAVELENGTHS_PX = (6.0, 20.0)
"""Shortest and longest wavelength at rest: long enough for 5-tap filters, short enough for windows."""
_SWING = 0.48
"""Maximum deviation from the mean grey value 0.5, which avoids clipping in all types."""
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class SyntheticPlane:
    """A tilted plane with sinusoidal texture that moves along X, Y and Z; a pixel has the value at its centre.

    ``size``: Height and width of the images in px.
    ``cameras``, ``frames``: Number of camera positions s and of frames t; the references are in the middle.
    ``channels``: Number of colour channels with separate phases; None for grey images.
    ``velocity_mm``: (U_X, U_Y, U_Z) in mm/frame; ``slopes``: dZ/dX and dZ/dY.
    ``depth_mm``: Z of the plane on the optical axis of the reference camera at t = 0.
    ``focal_length_px``, ``baseline_mm``: f, and V_X in mm per step of s.

    >>> plane = SyntheticPlane()
    >>> plane.recording()["image"].shape
    (3, 3, 56, 72)
    >>> float(plane.truth()["disparity"].sel(t=0).median().round(1))
    4.0
    """

    size: tuple[int, int] = (56, 72)
    cameras: int = 3
    frames: int = 3
    channels: int | None = None
    velocity_mm: tuple[float, float, float] = (1.5, -1.25, -9.0)
    principal_point_px: tuple[float, float] | None = None
    depth_mm: float = 600.0
    slopes: tuple[float, float] = (0.3, -0.2)
    focal_length_px: float = 240.0
    baseline_mm: float = 10.0

    @property
    def centre_px(self) -> tuple[float, float]:
        """The principal point (c_x, c_y) in px."""
        height, width = self.size
        return self.principal_point_px or ((width - 1) / 2, (height - 1) / 2)

    def images(self) -> Array:
        """Return the images as a new array in [0.02, 0.98], shape (s, t, y, x), with colours (s, t, y, x, channel)."""
        return _images(self).copy()

    def recording(
        self, images: ArrayLike | None = None, dtype: DTypeLike = np.float32, full_scale: float = 1.0, **changes: Any
    ) -> xr.Dataset:
        """Return a recording of these images, or of others, with the intrinsics of the plane."""
        values = np.asarray(self.images() if images is None else images)
        if np.issubdtype(dtype, np.integer):
            values = np.rint(values * full_scale)
        given = {
            "focal_length_px": self.focal_length_px,
            "baseline_mm": self.baseline_mm,
            "principal_point_px": self.centre_px,
            **changes,
        }
        return make_recording(values.astype(dtype), full_scale=full_scale, **given)

    def truth(self) -> dict[str, xr.DataArray]:
        """Return the truth of the reference camera in every frame, in the form of `map_comparison.scalar_maps`."""
        return dict(_truth(self))

    def _truth(self) -> dict[str, xr.DataArray]:
        frames = centred_indices(self.frames)
        across, down = self._rays()
        u_x, u_y, u_z = self.velocity_mm
        depth = np.stack([self._depth(0.0, float(t)) for t in frames])
        f = self.focal_length_px
        maps = {
            "depth": depth,
            "disparity": f * self.baseline_mm / depth,
            "flow_x": f * (u_x - across * u_z) / depth,
            "flow_y": f * (u_y - down * u_z) / depth,
            "velocity_x": np.full_like(depth, u_x),
            "velocity_y": np.full_like(depth, u_y),
            "velocity_z": np.full_like(depth, u_z),
        }
        height, width = self.size
        coordinates = {"t": frames, "y": np.arange(height), "x": np.arange(width)}
        together = xr.Dataset({name: (("t", "y", "x"), values) for name, values in maps.items()}, coordinates)
        return {name: together[name] for name in maps}

    def _rays(self) -> tuple[Array, Array]:
        """Return X / Z and Y / Z of the rays through the pixels, each of shape (y, x)."""
        height, width = self.size
        y, x = np.mgrid[:height, :width].astype(np.float64)
        c_x, c_y = self.centre_px
        return (x - c_x) / self.focal_length_px, (y - c_y) / self.focal_length_px

    def _depth(self, stage_x_mm: float, t: float) -> Array:
        """Return the intersection of a camera's rays with the plane Z - U_Z t = Z0 + a (X - U_X t) + b (Y - U_Y t)."""
        across, down = self._rays()
        (a, b), (u_x, u_y, u_z) = self.slopes, self.velocity_mm
        start = self.depth_mm + u_z * t + a * (stage_x_mm - u_x * t) - b * u_y * t
        return np.asarray(start / (1 - a * across - b * down))

    def _image(self, stage_x_mm: float, t: float, channel: int) -> Array:
        depth, (across, down) = self._depth(stage_x_mm, t), self._rays()
        # Positions of the pixels on the plane, as it was at t = 0.
        on_x = stage_x_mm + across * depth - self.velocity_mm[0] * t
        on_y = down * depth - self.velocity_mm[1] * t
        total = np.zeros(self.size)
        for n in range(_WAVES):
            low, high = _WAVELENGTHS_PX
            # The order of the wavelengths is mixed to make them independent of the directions.
            wavelength_px = low * (high / low) ** ((3 * n % _WAVES) / (_WAVES - 1))
            k = 2 * np.pi / wavelength_px * self.focal_length_px / self.depth_mm
            angle, phase = n * _GOLDEN_ANGLE, (n + 1) ** 2 * (1.0 + channel)
            total += np.cos(k * (np.cos(angle) * on_x + np.sin(angle) * on_y) + phase)
        return 0.5 + _SWING / _WAVES * total


@lru_cache(maxsize=16)
def _images(plane: SyntheticPlane) -> Array:
    positions = plane.baseline_mm * centred_indices(plane.cameras)
    frames = centred_indices(plane.frames)
    colours = [
        [[plane._image(float(at), float(t), channel) for t in frames] for at in positions]
        for channel in range(plane.channels or 1)
    ]
    return np.asarray(colours[0]) if plane.channels is None else np.moveaxis(np.asarray(colours), 0, -1)


@lru_cache(maxsize=16)
def _truth(plane: SyntheticPlane) -> dict[str, xr.DataArray]:
    return plane._truth()
