"""The shutter: when the pixels of an image collect light."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.model import Finite, FrozenModel, NonNegative

__all__ = ["Shutter"]

Array = NDArray[np.float64]


class Shutter(FrozenModel):
    """The time over which an image is taken; its own time is the middle of the exposure of its middle row.

    The truth is that of this middle, for every row its own.
    """

    exposure_time_s: NonNegative = 0.0
    """Time in s over which every pixel collects light; 0 freezes all motion."""
    samples: Annotated[int, Field(ge=1, le=4096)] | Literal["auto"] = "auto"
    """Moments of the exposure whose images are averaged; ``auto`` takes four for each pixel of motion, 4 to 256."""
    readout_time_s: NonNegative = 0.0
    """Time in s from the exposure of the first row to that of the last (rolling shutter); 0 for a global shutter."""
    stage_speed_mm_per_s: Finite = 0.0
    """Speed of the camera along X while it takes an image, in mm/s; its position is reached in the image's middle."""

    def row_offsets_s(self, rows: Array, height: int) -> Array:
        """Return how much later than the middle of the image rows are exposed.

        Parameters
        ----------
        rows
            Numbers of rows, which may be fractions; row 0 is exposed first.
        height
            Number of rows of the image.

        Returns
        -------
        numpy.ndarray
            Times in s, of the shape of ``rows``; negative for the upper half of the image.
        """
        return np.asarray((rows - (height - 1) / 2) * (self.readout_time_s / max(height - 1, 1)))

    def exposure_offsets_s(self, count: int) -> Array:
        """Return moments that sample the exposure: the middles of equal parts of it.

        Parameters
        ----------
        count
            Number of moments.

        Returns
        -------
        numpy.ndarray
            Times in s from the middle of the exposure, in order, shape (count,).
        """
        return np.asarray(((np.arange(count) + 0.5) / count - 0.5) * self.exposure_time_s)
