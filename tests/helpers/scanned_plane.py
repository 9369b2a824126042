"""Images of a textured plane that moves steadily, with a time for every image and row, and through any lens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.camera import Distortion
from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScannedPlane:
    """A plane through (0, 0, depth_mm); camera s is taken s delays later, and rows a line time after each other."""

    size: tuple[int, int] = (72, 96)
    focal_px: float = 1000.0
    baseline_mm: float = 4.0
    depth_mm: float = 500.0
    slopes: tuple[float, float] = (0.3, -0.2)
    velocity_mm: tuple[float, float, float] = (0.5, -0.3, -0.4)
    cameras: int = 5
    frames: int = 5
    interval_s: float = 20.0
    delay: float = 0.0
    line: float = 0.0
    distortion: Distortion | None = None
    noise_std: float = 0.0

    def rays(self) -> Array:
        """Return the ray of every pixel, shape (y, x, 3)."""
        height, width = self.size
        y, x = np.mgrid[:height, :width].astype(np.float64)
        at = np.stack([x - (width - 1) / 2, y - (height - 1) / 2], axis=-1) / self.focal_px
        at = at if self.distortion is None else self.distortion.undistort(at)
        return np.concatenate([at, np.ones((*self.size, 1))], axis=-1)

    def hit(self, stage_mm: float, t: float) -> tuple[Array, Array]:
        """Return material coordinates and depth at every pixel, each row at its own time."""
        height = self.size[0]
        times = t + self.line * (np.arange(height) - (height - 1) / 2)[:, None, None]
        centre = np.array([-stage_mm, 0.0, self.depth_mm]) + times * np.array(self.velocity_mm)
        normal, rays = np.array([*self.slopes, -1.0]), self.rays()
        depth = (centre @ normal) / (rays @ normal)
        return (depth[..., None] * rays - centre)[..., :2], depth

    def recording(self, *, stated: bool = True, **more: Any) -> xr.Dataset:
        """Return the recording, with or without its times and lens."""
        generator = np.random.default_rng(0)
        lengths = np.exp(generator.uniform(np.log(5.0), np.log(20.0), 40)) * self.depth_mm / self.focal_px
        angles, phases = generator.uniform(0, 2 * np.pi, (2, 40))
        along = 2 * np.pi * np.stack([np.cos(angles), np.sin(angles)]) / lengths
        places = self.baseline_mm * centred_indices(self.cameras)
        times = centred_indices(self.frames) + self.delay * centred_indices(self.cameras)[:, None]
        images = np.empty((self.cameras, self.frames, *self.size))
        for at in np.ndindex(times.shape):
            material, _ = self.hit(float(places[at[0]]), float(times[at]))
            images[at] = 0.5 + 0.02 * np.cos(material @ along + phases).sum(axis=-1)
        images += np.random.default_rng(1).normal(0.0, self.noise_std, images.shape) if self.noise_std else 0.0
        if stated:
            more |= {"planned_time_s": self.interval_s * times, "line_time_s": self.interval_s * self.line}
            if self.distortion is not None:
                more["distortion"] = self.distortion.coefficients
        return make_recording(images, self.focal_px, self.baseline_mm, frame_interval_s=self.interval_s, **more)

    def truth(self) -> dict[str, Array]:
        """Return disparity, velocity and flow of the reference image."""
        _, depth = self.hit(0.0, 0.0)
        rays, velocity = self.rays(), np.array(self.velocity_mm)
        rates = (velocity[:2] - rays[..., :2] * velocity[2]) / depth[..., None]
        if self.distortion is not None:
            rates = np.einsum("yxij,yxj->yxi", self.distortion.jacobian(rays[..., :2]), rates)
        return {
            "disparity": self.focal_px * self.baseline_mm / depth,
            "velocity": np.broadcast_to(velocity[:, None, None], (3, *self.size)),
            "flow": self.focal_px * np.moveaxis(rates, -1, 0),
        }
