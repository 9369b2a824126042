"""The results of a measurement of the fidelity of a backend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["BOUNDS_PX", "Fidelity", "Measurement"]

BOUNDS_PX = {"pyrender": 5e-4, "raycast": 1e-4}
"""What the rms of the shift errors must not exceed with the band-limited texture and 4 x 4 samples; ten times as much
for the largest error."""


@dataclass(frozen=True)
class Fidelity:
    """The errors of one backend with one number of samples.

    Parameters
    ----------
    texture
        Which of `TEXTURES_PX`.
    shortest_wavelength_px
        Its shortest wavelength.
    backend
        Name of the renderer, with its platform.
    supersampling
        n, of n x n samples.
    subsets
        How many subsets were registered, over all shifts.
    rms_px, max_px
        Of the shift errors of all subsets, x and y together.
    rms_grey, max_grey
        Of rendered minus exact grey values, over the texture's standard deviation.
    seconds_per_image
        Median over the shifts.
    """

    texture: str
    shortest_wavelength_px: float
    backend: str
    supersampling: int
    subsets: int
    rms_px: float
    max_px: float
    rms_grey: float
    max_grey: float
    seconds_per_image: float

    @property
    def bound_px(self) -> float | None:
        """The rms shift error that this must not exceed, where `BOUNDS_PX` states one."""
        if self.texture != "band-limited" or self.supersampling != 4:
            return None
        return BOUNDS_PX[self.backend.split()[0]]

    @property
    def within_bounds(self) -> bool | None:
        """Whether rms and maximum keep to the bound; None where there is none."""
        bound = self.bound_px
        return None if bound is None else self.rms_px <= bound and self.max_px <= 10 * bound


@dataclass(frozen=True, eq=False)
class Measurement:
    """A result and what it was computed from.

    Parameters
    ----------
    result
        The figures.
    errors_px
        Shift errors (x, y) of every subset, shape (shifts, rows, columns, 2).
    """

    result: Fidelity
    errors_px: NDArray[np.float64]
