"""The number of electrons that a pixel can hold."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import Positive

__all__ = ["FullWell"]


class FullWell(Effect):
    """A pixel holds so many electrons and no more."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["full_well"]
    """This effect."""
    full_well_e: Positive
    """Electrons that a pixel can hold."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Cut off at the full well."""
        return np.minimum(signal, self.full_well_e)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the electrons, at most the full well's."""
        return min(signal, self.full_well_e)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the full well, if what follows tells so much."""
        return min(largest_output, self.full_well_e)
