"""The offsets of pixels, which are not quite the same (DSNU)."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import NonNegative

__all__ = ["DarkSignalNonuniformity"]


class DarkSignalNonuniformity(Effect):
    """Every pixel has an offset of its own, normally distributed about 0 and the same in all images."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["dark_signal_nonuniformity"]
    """This effect."""
    dsnu_e: NonNegative
    """DSNU_1288, standard deviation of the pixels' dark offsets in electrons."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the offsets in electrons."""
        return self.dsnu_e * generator.standard_normal(shape)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add the offsets."""
        assert exposure.pattern is not None
        return signal + exposure.pattern
