"""Rounding to digital numbers of so many bits, and their saturation."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera.sensor.base import Effect, Exposure, Unit

__all__ = ["Digitisation"]


class Digitisation(Effect):
    """Digital numbers are rounded, and end at 0 and at the largest that so many bits hold."""

    takes: ClassVar[Unit] = "unrounded digital numbers"
    gives: ClassVar[Unit] = "digital numbers"

    kind: Literal["digitisation"]
    """This effect."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] = 8
    """Bits of a digital number."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Round, and saturate."""
        return np.clip(np.rint(signal), 0, 2**self.bit_depth - 1)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number before it is rounded."""
        return min(max(signal, 0.0), float(2**self.bit_depth - 1))

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest digital number."""
        return min(largest_output, float(2**self.bit_depth - 1))
