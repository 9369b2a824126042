"""The depth working point: the integer disparity by which images are registered before filtering."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

__all__ = ["find_working_point"]


def find_working_point(grey: NDArray[Any]) -> int:
    """Find the integer disparity at which the images of all cameras agree best.

    The horizontal differences of every two neighbouring cameras are correlated along x over all rows; the sums
    over all pairs add up, as do those of cameras two steps apart at twice the disparity. The surface with most texture
    wins.

    Parameters
    ----------
    grey
        Images of one frame, shape (s, y, x), in order of s; any scale.

    Returns
    -------
    int
        Disparity in px per step of s (positive: x_s = x_0 - disparity s); 0 for images without texture.
    """
    count, _, width = grey.shape
    if count < 2:
        return 0
    detail = np.diff(grey.astype(np.float64), axis=2)
    padded = fft.next_fast_len(2 * width, real=True)
    spectra = fft.rfft(detail, padded, axis=2)
    limit = (width - 1) // 2
    candidates = np.arange(-limit, limit + 1)
    total = np.zeros(len(candidates))
    for step in (1, 2):
        for first in range(count - step):
            cross = np.sum(spectra[first] * np.conj(spectra[first + step]), axis=0)
            correlation = fft.irfft(cross, padded)
            inside = np.abs(candidates * step) < width
            total[inside] += correlation[candidates[inside] * step % padded] / (count - step)
    if total.max() <= 0:
        return 0
    # Of equal peaks (periodic patterns) the one that displaces least.
    best = np.flatnonzero(total >= total.max() * (1 - 1e-9))
    return int(candidates[best[np.argmin(np.abs(candidates[best]))]])
