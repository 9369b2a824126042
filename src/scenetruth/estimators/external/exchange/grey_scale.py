"""How numbers of 16 bits stand for the values of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.estimators.external.exchange.frames import each_frame

__all__ = ["GreyScale", "grey_scale_of"]

_LARGEST = 65535
# Beyond it, float64 does not hold every integer.
_EXACT = 2**53


@dataclass(frozen=True)
class GreyScale:
    """Values of a recording as numbers from 0 to 65535: value = offset + scale number.

    Parameters
    ----------
    scale, offset
        The same for all images.
    lossless
        Whether all values follow exactly; else they are off by half of ``scale`` at most.
    """

    scale: float = 1.0
    offset: float = 0.0
    lossless: bool = True

    def numbers(self, values: NDArray[Any]) -> NDArray[np.uint16]:
        """Return the numbers for some values; 0 where a value is not finite.

        Examples
        --------
        >>> GreyScale(0.5, -1.0).numbers(np.array([-1.0, 0.0, 3.1, np.nan])).tolist()
        [0, 2, 8, 0]
        """
        if values.dtype.kind == "u" and values.dtype.itemsize <= 2 and (self.scale, self.offset) == (1.0, 0.0):
            return values.astype(np.uint16)
        known = values.astype(np.float64)
        known = np.rint((np.where(np.isfinite(known), known, self.offset) - self.offset) / self.scale)
        return np.clip(known, 0, _LARGEST).astype(np.uint16)


def grey_scale_of(recording: xr.Dataset) -> GreyScale:
    """Return the scale on which 16 bits lose least.

    Digital numbers are taken as they are: of 8 and 16 bits at once, of other integers after a look at all images.
    Everything else is spread over all 65536 numbers, from its least to its largest value.

    Parameters
    ----------
    recording
        A checked recording of one row of cameras; it is read frame by frame.
    """
    dtype = recording["image"].dtype
    if dtype.kind == "u" and dtype.itemsize <= 2:
        return GreyScale()
    least, largest = np.inf, -np.inf
    for values, _ in each_frame(recording):
        known = values[np.isfinite(values)]
        if known.size:
            least, largest = min(least, float(known.min())), max(largest, float(known.max()))
    if least > largest:
        # Nothing is known of any pixel.
        return GreyScale()
    if dtype.kind != "f" and largest - least <= _LARGEST and max(-least, largest) < _EXACT:
        return GreyScale(offset=0.0 if least >= 0 and largest <= _LARGEST else least)
    if least == largest:
        return GreyScale(offset=least)
    return GreyScale((largest - least) / _LARGEST, least, lossless=False)
