"""Test of whether the fixed pattern of dark frames is contained in images: whether they are of one camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from scenetruth.capture.image_reading import FrameMoments

__all__ = ["PatternMatch"]

Floats = NDArray[np.float64]

_WINDOW_PX = 9
_BLOCKS = 8  # along either axis, for the uncertainty (jackknife)
_MOST_PIXELS = 4_000_000  # of an image; of larger images the middle is used
_LEAST_VARIANCE = 1 / 12
_CLEAR = 5.0  # least pattern in standard deviations of its own uncertainty
_HOT = 8.0  # standard deviations of the pattern beyond which a pixel is excluded


class PatternMatch:
    """How many times the pattern of dark frames is contained in images.

    Both are taken less their local means. Every pixel has the weight of the inverse local variance of its image, so
    that smooth parts count: the inside of squares of a board, or a background without texture.
    """

    def __init__(self, dark: FrameMoments) -> None:
        self._part = _middle(dark.mean.shape)
        pattern = _fine(dark.mean[self._part])
        noise = (1 - 1 / _WINDOW_PX**2) * dark.variance[self._part] / dark.count
        # Defective pixels are excluded: clipping and their own noise obey no model.
        usual = float(np.median(np.abs(pattern))) * 1.4826
        self._used = np.abs(pattern) < _HOT * max(usual, 1e-9)
        self._pattern = np.where(self._used, pattern, 0.0)
        self._own = np.where(self._used, pattern**2 - noise, 0.0)
        self._sums = np.zeros(pattern.shape)
        self._weights = np.zeros(pattern.shape)

    @property
    def measurable(self) -> bool:
        """Whether the dark frames have a pattern that exceeds its uncertainty."""
        own, count = self._own[self._used], int(self._used.sum())
        spread = float(own.std()) / np.sqrt(max(count, 1))
        return count > 1000 and float(own.mean()) > _CLEAR * spread

    def add(self, image: NDArray[Any]) -> None:
        """Add an image of the same camera settings as the dark frames, shape (y, x)."""
        values = _fine(image[self._part].astype(np.float64))
        variance = uniform_filter(values**2, _WINDOW_PX)
        # Rounding hides the pattern where there is no noise.
        weight = np.where(variance > _LEAST_VARIANCE, 1 / np.maximum(variance, _LEAST_VARIANCE), 0.0)
        self._sums += weight * values
        self._weights += weight

    def slope(self) -> tuple[float, float]:
        """Return the number of times that the images contain the pattern, and its standard deviation."""
        if not self.measurable or not self._weights.any():
            return np.nan, np.inf
        row, column = (np.arange(size) * _BLOCKS // size for size in self._pattern.shape)
        blocks = (row[:, None] * _BLOCKS + column).ravel()
        upper = np.bincount(blocks, (self._pattern * self._sums).ravel(), _BLOCKS**2)
        lower = np.bincount(blocks, (self._own * self._weights).ravel(), _BLOCKS**2)
        if lower.sum() <= 0:
            return np.nan, np.inf
        without = (upper.sum() - upper) / (lower.sum() - lower)
        spread = np.sqrt((len(without) - 1) / len(without) * np.sum((without - without.mean()) ** 2))
        return float(upper.sum() / lower.sum()), float(spread)


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the middle part of an image with at most a certain number of pixels."""
    share = min(1.0, np.sqrt(_MOST_PIXELS / (shape[0] * shape[1])))
    found = []
    for size in shape[:2]:
        length = max(int(size * share), min(size, 64))
        first = (size - length) // 2
        found.append(slice(first, first + length))
    return found[0], found[1]


def _fine(values: Floats) -> Floats:
    return np.asarray(values - uniform_filter(values, _WINDOW_PX))
