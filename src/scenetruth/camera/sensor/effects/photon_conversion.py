"""The photons that a pixel receives during the exposure."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import Positive

__all__ = ["PhotonConversion"]


class PhotonConversion(Effect):
    """Radiance becomes the mean number of photons that a pixel receives during the exposure."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["photon_conversion"]
    """This effect."""
    photon_rate_per_s: Positive
    """Photons that a pixel receives in a second where the radiance is 1."""
    exposure_time_s: Positive
    """Time over which it collects them."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the photons of radiance 1; what rendering made negative is dark."""
        return self._photons * np.maximum(signal, 0.0)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the number of photons."""
        return self._photons * max(signal, 0.0)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the radiance of so many photons."""
        return largest_output / self._photons

    @property
    def _photons(self) -> float:
        return self.photon_rate_per_s * self.exposure_time_s
