"""Images of a plane with waves on it that moves, turns and grows, from formulas alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.indexing import centred_indices
from scenetruth.schema import make_recording

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MovingPlane:
    """A plane through (0, 0, depth_mm) whose points move with U = velocity + gradient (P - (0, 0, depth_mm)).

    The velocity may change by an acceleration, the same everywhere. Texture is a sum of waves that stick to the plane.
    """

    slopes: tuple[float, float] = (0.3, -0.2)
    velocity_mm: tuple[float, float, float] = (0.05, -0.03, -0.4)
    acceleration_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gradient: Array = field(default_factory=lambda: np.zeros((3, 3)))
    depth_mm: float = 500.0
    focal_px: float = 1000.0
    baseline_mm: float = 4.0
    size: tuple[int, int] = (72, 96)
    waves: int = 40
    wavelengths_px: tuple[float, float] = (5.0, 20.0)
    seed: int = 0

    def _rays(self, moved: Array | None = None) -> Array:
        height, width = self.size
        y, x = np.mgrid[:height, :width].astype(np.float64)
        x, y = x - (width - 1) / 2, y - (height - 1) / 2
        if moved is not None:
            right, down, roll, larger = moved
            inverse = np.linalg.inv([[1 + larger, -roll], [roll, 1 + larger]])
            x, y = np.einsum("ij,jyx->iyx", inverse, np.stack([x - right, y - down]))
        return np.stack([x / self.focal_px, y / self.focal_px, np.ones_like(x)], axis=-1)

    def _hit(self, stage_mm: tuple[float, float], t: float, off: Array | None = None) -> tuple[Array, Array]:
        """Return the material coordinates (a, b) that each pixel sees, and the depth there."""
        tangents = np.array([[1.0, 0.0, self.slopes[0]], [0.0, 1.0, self.slopes[1]]])
        moved = tangents @ (np.eye(3) + t * self.gradient).T
        centre = np.array([0.0, 0.0, self.depth_mm]) + t * np.array(self.velocity_mm) - [*stage_mm, 0.0]
        centre += 0.5 * t**2 * np.array(self.acceleration_mm)
        # centre + a p + b q = k r, for every ray r.
        rays = self._rays(off)
        matrix = np.empty((*rays.shape[:2], 3, 3))
        matrix[..., 0], matrix[..., 1], matrix[..., 2] = moved[0], moved[1], -rays
        found = np.asarray(
            np.linalg.solve(matrix, np.broadcast_to(-centre, rays.shape)[..., None])[..., 0], dtype=np.float64
        )
        return found[..., :2], found[..., 2]

    def image(self, stage_mm: tuple[float, float], t: float, channel: int = 0, moved: Array | None = None) -> Array:
        """Return grey values between about 0 and 1 from a place (X, Y) on the stage at a time.

        An image that is not where it should be is moved along x and y in px, rolled from x to y in rad, and larger by a
        share: the four of ``moved``.
        """
        generator = np.random.default_rng((self.seed, channel))
        material, _ = self._hit(stage_mm, t, moved)
        shortest, longest = (float(np.log(length)) for length in self.wavelengths_px)
        lengths = np.exp(generator.uniform(shortest, longest, self.waves)) * self.depth_mm / self.focal_px
        angles, phases = generator.uniform(0, 2 * np.pi, (2, self.waves))
        along = np.stack([np.cos(angles), np.sin(angles)]) / lengths
        return np.asarray(
            0.5 + 0.1 * np.sqrt(2 / self.waves) * np.cos(2 * np.pi * (material @ along) + phases).sum(axis=-1)
        )

    def recording(
        self,
        cameras: int = 5,
        frames: int = 9,
        channels: int = 1,
        noise_std: float = 0.0,
        seed: int = 1,
        moved: Array | None = None,
        rows: int = 1,
    ) -> xr.Dataset:
        """Return the recording of cameras around the reference, with white noise; of a grid if there are several rows.

        ``moved`` tells how far every image is from where it should be, shape (cameras, frames, 4).
        """
        off = np.zeros((cameras, frames, 4)) if moved is None else moved
        across, below = (self.baseline_mm * centred_indices(count) for count in (cameras, rows))
        images = np.array(
            [
                self.image((x_mm, y_mm), t, channel, off[i, j])
                for channel in range(channels)
                for y_mm in below
                for i, x_mm in enumerate(across)
                for j, t in enumerate(centred_indices(frames))
            ]
        ).reshape(channels, rows, cameras, frames, *self.size)
        images = images[0] if channels == 1 else np.moveaxis(images, 0, -1)
        images += np.random.default_rng(seed).normal(0.0, noise_std, images.shape) if noise_std else 0.0
        stage_y_mm = below if rows > 1 else None
        images = images if rows > 1 else images[0]
        return make_recording(images, self.focal_px, self.baseline_mm, stage_y_mm=stage_y_mm)

    def truth(self) -> dict[str, Array]:
        """Return the maps of the reference image."""
        _, depth = self._hit((0.0, 0.0), 0.0)
        points = self._rays() * depth[..., None]
        velocity = np.array(self.velocity_mm) + (points - [0.0, 0.0, self.depth_mm]) @ self.gradient.T
        tangents = np.array([[1.0, 0.0, self.slopes[0]], [0.0, 1.0, self.slopes[1]]])
        dual = np.linalg.pinv(tangents)
        normal = np.array([self.slopes[0], self.slopes[1], -1.0]) / np.sqrt(1 + np.square(self.slopes).sum())
        x, y = (self._rays()[..., k] * self.focal_px for k in (0, 1))
        along, down, ahead = np.moveaxis(velocity, -1, 0)
        return {
            "depth": depth,
            "disparity": self.focal_px * self.baseline_mm / depth,
            "velocity": np.moveaxis(velocity, -1, 0),
            "flow": np.stack([(self.focal_px * along - x * ahead) / depth, (self.focal_px * down - y * ahead) / depth]),
            "divergence": -ahead / depth,
            "slope": np.broadcast_to(np.array(self.slopes)[:, None, None], (2, *depth.shape)),
            "normal": np.broadcast_to(normal[:, None, None], (3, *depth.shape)),
            "acceleration": np.broadcast_to(np.array(self.acceleration_mm)[:, None, None], (3, *depth.shape)),
            "growth_rate": np.full(depth.shape, np.trace(tangents @ self.gradient @ dual)),
        }

    def start(self) -> Array:
        """Return the true fields d, q_X, q_Y and q_Z of the refined estimator."""
        truth = self.truth()
        return np.concatenate([truth["disparity"][None], truth["velocity"] / self.baseline_mm])


def turning(x: float, y: float, z: float) -> Array:
    """Return the velocity gradient of a rotation by a vector per frame."""
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
