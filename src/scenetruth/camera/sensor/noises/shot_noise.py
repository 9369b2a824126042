"""The shot noise of light and dark current: electrons are counted, and counts scatter."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit

__all__ = ["ShotNoise"]


class ShotNoise(Effect):
    """Mean numbers of electrons become Poisson distributed ones.

    Photons arrive one by one and free electrons by chance, so both are Poisson distributed: drawing the electrons is
    enough.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["shot_noise"]
    """This effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Draw the numbers; what is negative by an effect before has none."""
        generator, mean = exposure.generator(), np.maximum(signal, 0.0)
        # Beyond a thousand million the normal distribution is the same, and does not overflow.
        many = mean > 1e9
        drawn = generator.poisson(np.where(many, 0.0, mean)).astype(np.float64)
        if not many.any():
            return drawn
        return np.where(many, mean + np.sqrt(mean) * generator.standard_normal(mean.shape), drawn)
