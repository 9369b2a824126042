"""The overall system gain and the black level."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import NonNegative, Positive

__all__ = ["Gain"]


class Gain(Effect):
    """Electrons become digital numbers, not yet rounded."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["gain"]
    """This effect."""
    gain_dn_per_e: Positive
    """Overall system gain K, digital numbers per electron."""
    black_level_dn: NonNegative = 0.0
    """Digital number of a pixel without electrons."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by K, and add the black level."""
        return self.gain_dn_per_e * signal + self.black_level_dn

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number."""
        return self.gain_dn_per_e * signal + self.black_level_dn

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the electrons of that digital number."""
        return (largest_output - self.black_level_dn) / self.gain_dn_per_e
