"""An amplification by which full scale is the largest digital number."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit

__all__ = ["FullRangeGain"]


class FullRangeGain(Effect):
    """Shares of full scale become digital numbers: 1 the largest that the digitisation knows, 0 none."""

    takes: ClassVar[Unit] = "share of full scale"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["full_range_gain"]
    """This effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the largest digital number."""
        return signal * exposure.full_scale

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number."""
        return signal * full_scale

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the share of full scale."""
        return largest_output / full_scale
