"""The noise of the amplifier that reads pixels."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import NonNegative

__all__ = ["ReadoutNoise"]


class ReadoutNoise(Effect):
    """Reading a pixel adds Gaussian noise, anew in every image."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["readout_noise"]
    """This effect."""
    temporal_dark_noise_e: NonNegative
    """σ_d, standard deviation in electrons, without the shot noise of the dark current."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add noise."""
        return signal + self.temporal_dark_noise_e * exposure.generator().standard_normal(signal.shape)
