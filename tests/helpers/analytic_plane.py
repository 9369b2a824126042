"""Images of a textured plane in motion, in closed form, with the truth of the reference camera and frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

import scenetruth as st

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plane:
    """A plane Z = Z0 + slope X that carries a sum of waves."""

    focal_length_px: float = 1000.0
    depth_mm: float = 500.0
    slope: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    size: tuple[int, int] = (48, 64)
    wavelengths_px: tuple[float, float] = (6.0, 20.0)
    seed: int = 0

    def _pixels(self) -> tuple[Array, Array]:
        height, width = self.size
        y, x = np.mgrid[:height, :width].astype(np.float64)
        return x - (width - 1) / 2, y - (height - 1) / 2

    def depth(self, stage_x_mm: float, t: float) -> Array:
        x, _ = self._pixels()
        u_x, _, u_z = self.velocity
        start = self.depth_mm + u_z * t + self.slope * (stage_x_mm - u_x * t)
        return np.asarray(start / (1 - self.slope * x / self.focal_length_px))

    def image(self, stage_x_mm: float, t: float, channel: int = 0) -> Array:
        x, y = self._pixels()
        depth = self.depth(stage_x_mm, t)
        on_x = stage_x_mm + x * depth / self.focal_length_px - self.velocity[0] * t
        on_y = y * depth / self.focal_length_px - self.velocity[1] * t
        generator = np.random.default_rng([self.seed, channel])
        total = np.zeros_like(x)
        count = 24
        for _ in range(count):
            angle, phase = generator.uniform(0, 2 * np.pi, 2)
            wavelength = np.exp(generator.uniform(*np.log(self.wavelengths_px)))
            k = 2 * np.pi / wavelength * self.focal_length_px / self.depth_mm
            total += np.cos(k * (np.cos(angle) * on_x + np.sin(angle) * on_y) + phase)
        return np.asarray(0.5 + 0.12 * total / np.sqrt(count / 2))

    def recording(
        self,
        stage_x_mm: ArrayLike,
        frames: int,
        baseline_mm: float = 1.0,
        channels: int = 0,
        noise: float = 0.0,
        seed: int = 0,
    ) -> xr.Dataset:
        """Return a recording; no ``channels`` means grey images, ``noise`` is in grey values of [-1, 1]."""
        positions = np.asarray(stage_x_mm, dtype=np.float64)
        times = [float(t) for t in range(-((frames - 1) // 2), frames // 2 + 1)]
        images = np.array(
            [[[self.image(s, t, channel) for t in times] for s in positions] for channel in range(max(channels, 1))]
        )
        images = np.moveaxis(images, 0, -1) if channels else images[0]
        if noise:
            images = images + np.random.default_rng(seed).normal(0, noise / 2, images.shape)
        single = images.astype(np.float32)
        return st.make_recording(single, self.focal_length_px, baseline_mm, stage_x_mm=positions, full_scale=1.0)

    def truth(self, baseline_mm: float = 1.0) -> dict[str, Array]:
        """Return depth, velocity, disparity, flow and divergence of the reference."""
        x, y = self._pixels()
        depth = self.depth(0.0, 0.0)
        u_x, u_y, u_z = self.velocity
        f = self.focal_length_px
        return {
            "depth": depth,
            "velocity": np.stack([np.full_like(depth, part) for part in self.velocity]),
            "disparity": f * baseline_mm / depth,
            "flow": np.stack([(f * u_x - x * u_z) / depth, (f * u_y - y * u_z) / depth]),
            "divergence": -u_z / depth,
        }
