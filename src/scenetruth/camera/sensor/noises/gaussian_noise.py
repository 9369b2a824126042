"""Temporal Gaussian noise that does not depend on the signal."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import NonNegative

__all__ = ["GaussianNoise"]


class GaussianNoise(Effect):
    """Gaussian noise of the same strength in all pixels, anew in every image."""

    takes: ClassVar[Unit] = "share of full scale"
    gives: ClassVar[Unit] = "share of full scale"

    kind: Literal["gaussian_noise"]
    """This effect."""
    noise_std: NonNegative
    """Standard deviation, as a fraction of full scale."""

    def stream(self, s_y: int, s: int, t: int) -> tuple[str | int, ...]:
        """Return the key of its random numbers for one image."""
        # Recordings made before sensors were chains keep their bytes: their noise had no name, and no row at the
        # reference row.
        return super().stream(s_y, s, t) if self.name else (*((s_y,) if s_y else ()), s, t)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add noise."""
        return signal + self.noise_std * exposure.generator().standard_normal(signal.shape)
