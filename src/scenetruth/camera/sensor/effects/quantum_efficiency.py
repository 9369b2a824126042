"""The share of photons that free an electron."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera.sensor.base import Effect, Exposure, Unit

__all__ = ["QuantumEfficiency"]


class QuantumEfficiency(Effect):
    """Photons become the mean number of electrons that they free."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["quantum_efficiency"]
    """This effect."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    """η, electrons per photon."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by η."""
        return self.quantum_efficiency * signal

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the number of electrons."""
        return self.quantum_efficiency * signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons that free so many electrons."""
        return largest_output / self.quantum_efficiency
