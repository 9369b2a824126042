"""Radiance as a share of that which gives full scale."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import Positive

__all__ = ["FullScale"]


class FullScale(Effect):
    """Radiance becomes a share of that which gives full scale."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "share of full scale"

    kind: Literal["full_scale"]
    """This effect."""
    full_scale_radiance: Positive = 1.0
    """Radiance that gives full scale."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Divide by the radiance of full scale."""
        return signal / self.full_scale_radiance

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the share of full scale."""
        return signal / self.full_scale_radiance

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the radiance of that share."""
        return largest_output * self.full_scale_radiance
