"""The wave numbers of the texture of an image, as the error bars need them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["STRIDE", "Texture"]

STRIDE = 4
"""Distance in px of the points at which the texture's spectrum is measured."""

Floats = NDArray[np.float32]


class Texture(NamedTuple):
    """How image noise passes the filters around the texture of every place; arrays (y / stride, x / stride).

    numba keeps compiled kernels until their own files change: whoever changes the fields here must change
    `kernels.world` too.
    """

    passed_x: Floats
    """|Ŝ_x Ŝ_y|² in the mean over the energy of g_x."""
    passed_xy: Floats
    """|Ŝ_x Ŝ_y|² in the mean over the energy of g_x and g_y."""
    wave_number_x2: Floats
    """Mean square of the wave number k_x, rad² per px²."""
    wave_number_y2: Floats
    """Mean square of the wave number k_y, rad² per px²."""
    widened: Floats
    """By how much more noise passes where coordinates weigh the window."""
    stride: int = STRIDE
    """Distance of the places in px."""

    def cropped(self, rows: slice, columns: slice = slice(None)) -> Texture:
        """Return a part of the places.

        Parameters
        ----------
        rows, columns
            Which rows and columns of places.
        """
        arrays = {name: getattr(self, name)[rows, columns] for name in self._fields if name != "stride"}
        return Texture(**arrays, stride=self.stride)
