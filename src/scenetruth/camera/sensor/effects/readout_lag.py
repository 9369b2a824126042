"""Charge that a readout leaves behind, and that the next image shows."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera.sensor.base import Effect, Exposure, Unit

__all__ = ["ReadoutLag"]


class ReadoutLag(Effect):
    """A share of the electrons stays in the pixel, and is read with the next image.

    That is the one which the camera takes next, at whatever position of its stage. No electron is lost: what an image
    lacks, the next one has too many. Nothing is left in the pixels before the first image.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"
    remembers: ClassVar[bool] = True

    kind: Literal["readout_lag"]
    """This effect."""
    lag: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
    """Share of the electrons that stays behind."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return what is read: what does not stay behind, and what the image before has left."""
        read = (1 - self.lag) * signal
        return read if exposure.previous is None else read + self.lag * exposure.previous
