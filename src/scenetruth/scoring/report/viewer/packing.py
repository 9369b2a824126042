"""Maps as short texts that a browser unpacks without any library, rounded by a known bound."""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEVELS", "RELATIVE_ROUNDING", "PackedMap", "pack_map", "unpack_map"]

Map = NDArray[np.float64]
Codes = NDArray[np.uint16]

LEVELS = 8192
"""Steps into which the range that is shown at first is divided; codes reach eight times as far."""
RELATIVE_ROUNDING = 0.5 / LEVELS
"""The most by which a map is rounded, as a share of the range that is shown at first."""

_NONE, _EXACT, _FIRST = 0, 1, 2
"""Codes of a pixel without a value, of one whose value is told exactly, and of the lowest value."""
_CODES = 65_536 - _FIRST
_RAW, _ROWS, _PLANE = 0, 1, 2
"""What a code is told by: itself, the difference from its left neighbour, and that from the left, upper and upper left
neighbours' plane."""


@dataclass(frozen=True)
class PackedMap:
    """A map of two dimensions in few bytes.

    A code c of 2 and more stands for ``low + (c - 2) step``, 0 for no value, and 1 for the next of the exact values,
    in reading order. Instead of codes stand their differences from what neighbours let expect, modulo 65536, those
    below zero as odd numbers (zigzag); first the upper bytes of all, then the lower ones, then the exact values (8
    bytes each, little-endian); all of it as zlib has it.

    Parameters
    ----------
    shape
        Rows and columns.
    low, step
        The value of code 2, and that of a step, in the units of the map.
    predictor
        What neighbours let expect: nothing (0), the left one again (1), or their plane, left + upper - upper left (2).
    exact
        How many values are told exactly.
    data
        The bytes.
    """

    shape: tuple[int, int]
    low: float
    step: float
    predictor: int
    exact: int
    data: bytes

    @property
    def rounding(self) -> float:
        """The most by which an unpacked value is wrong, but for the last digits of float64."""
        return 0.5 * self.step

    @property
    def size(self) -> int:
        """How many characters it takes in the page."""
        return 4 * -(-len(self.data) // 3)

    def to_plain(self) -> dict[str, Any]:
        """Return it as plain values for JSON, its bytes in base 64."""
        return {
            "height": self.shape[0],
            "width": self.shape[1],
            "low": self.low,
            "step": self.step,
            "predictor": self.predictor,
            "exact": self.exact,
            "data": base64.b64encode(self.data).decode("ascii"),
        }


def pack_map(values: NDArray[Any], limits: tuple[float, float] | None = None) -> PackedMap:
    """Pack a map.

    Parameters
    ----------
    values
        Shape (y, x); NaN where there is none. Integers and flags are kept as they are.
    limits
        Low and high of what is shown at first; all finite values if not given. A step is their distance over `LEVELS`.
        Values more than three and a half times as far outside are told exactly.

    Returns
    -------
    PackedMap
        The map, rounded to a multiple of its step.

    Examples
    --------
    >>> packed = pack_map(np.array([[1.0, 1.5, np.nan], [2.0, 1e9, 1.25]]), limits=(1.0, 2.0))
    >>> unpack_map(packed).round(3).tolist(), packed.exact, round(packed.rounding, 6)
    ([[1.0, 1.5, nan], [2.0, 1000000000.0, 1.25]], 1, 6.1e-05)
    """
    whole = values.dtype.kind in "uib"
    numbers = values.astype(np.float64)
    known = ~np.isnan(numbers)
    finite = numbers[np.isfinite(numbers)]
    low = step = 0.0
    if finite.size:
        least, most = float(finite.min()), float(finite.max())
        low, high = (least, most) if limits is None else limits
        if whole and most - least < _CODES:
            low, step = least, 1.0
        else:
            step = high / LEVELS - low / LEVELS
            # Near the largest and the least numbers that there are, steps cannot be counted: all values are exact then.
            if not (math.isfinite(step * _CODES) and step >= np.finfo(np.float64).tiny):
                step = 0.0
            elif limits is not None:
                low -= step * ((_CODES - LEVELS) // 2)
                if not math.isfinite(low):
                    low = step = 0.0
    codes = np.zeros(numbers.shape, dtype=np.uint16)
    with np.errstate(over="ignore", invalid="ignore"):
        at = np.rint((numbers - low) / step) if step else np.where(numbers == low, 0.0, -1.0)
        coded = known & (at >= 0) & (at < _CODES)
    codes[coded] = at[coded].astype(np.uint16) + np.uint16(_FIRST)
    exact = known & ~coded
    codes[exact] = _EXACT
    predictor, told = min(((way, _told_by(codes, way)) for way in (_RAW, _ROWS, _PLANE)), key=lambda one: _cost(one[1]))
    told = told.ravel()
    content = (
        (told >> 8).astype(np.uint8).tobytes()
        + (told & 255).astype(np.uint8).tobytes()
        + numbers[exact].astype("<f8").tobytes()
    )
    # What is left are sizes of small differences: looking for repeated strings among them takes time and finds few.
    packer = zlib.compressobj(6, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_FILTERED)
    data = packer.compress(content) + packer.flush()
    height, width = numbers.shape
    return PackedMap((height, width), low, step, predictor, int(exact.sum()), data)


def unpack_map(packed: PackedMap) -> Map:
    """Return what a page's viewer makes of a packed map, shape (y, x), NaN where there is none."""
    content = zlib.decompress(packed.data)
    height, width = packed.shape
    size = height * width
    upper, lower = (np.frombuffer(content, np.uint8, size, at * size).astype(np.uint16) for at in (0, 1))
    told = (upper << 8 | lower).reshape(packed.shape)
    codes = (told >> 1) ^ (np.uint16(0) - (told & np.uint16(1)))
    if packed.predictor >= _ROWS:
        codes = np.cumsum(codes, axis=1, dtype=np.uint16)
    if packed.predictor == _PLANE:
        codes = np.cumsum(codes, axis=0, dtype=np.uint16)
    values = packed.low + (codes.astype(np.float64) - _FIRST) * packed.step
    values[codes == _NONE] = np.nan
    values[codes == _EXACT] = np.frombuffer(content, "<f8", packed.exact, 2 * size)
    return values


def _told_by(codes: Codes, predictor: int) -> Codes:
    """Return the differences of codes from what is expected, as numbers that are small where those are."""
    left = codes.copy()
    if predictor >= _ROWS:
        left[:, 1:] -= codes[:, :-1]
    if predictor == _PLANE:
        left[1:] -= left[:-1].copy()
    return (left << np.uint16(1)) ^ (np.uint16(0) - (left >> np.uint16(15)))


def _cost(told: Codes) -> float:
    """Return about how many bits differences take."""
    return float(np.log2(told[::2].astype(np.float32) + 1).sum())
