"""Kernels that place dots with a minimum distance and rasterise them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel

__all__ = ["draw_discs", "place_dots"]


@kernel()
def place_dots(
    candidates: NDArray[np.float64],
    placed: NDArray[np.float64],
    count: int,
    cells: NDArray[np.int32],
    least: float,
    covered: NDArray[np.bool_],
    texel: float,
    radius: float,
    wanted: int,
    so_far: int,
) -> Any:
    """Place candidates one after another, unless they are too close to placed dots, up to the required coverage.

    ``candidates``: Centres (x, y) from the upper left corner of the sheet, shape (n, 2), outside by at most
      ``radius``.
    """
    rows, columns = covered.shape
    high, wide = cells.shape
    for k in range(candidates.shape[0]):
        if so_far >= wanted or count >= placed.shape[0]:
            break
        x, y = candidates[k, 0], candidates[k, 1]
        if least > 0:
            side = least / np.sqrt(2.0)
            column, row = int((x + radius) / side), int((y + radius) / side)
            free = True
            for r in range(max(row - 2, 0), min(row + 3, high)):
                for c in range(max(column - 2, 0), min(column + 3, wide)):
                    other = cells[r, c]
                    if other >= 0:
                        dx, dy = placed[other, 0] - x, placed[other, 1] - y
                        if dx * dx + dy * dy < least * least:
                            free = False
                            break
                if not free:
                    break
            if not free:
                continue
            cells[row, column] = count
        placed[count, 0], placed[count, 1] = x, y
        count += 1
        for i in range(max(int((y - radius) / texel) - 1, 0), min(int((y + radius) / texel) + 2, rows)):
            for j in range(max(int((x - radius) / texel) - 1, 0), min(int((x + radius) / texel) + 2, columns)):
                dx, dy = (j + 0.5) * texel - x, (i + 0.5) * texel - y
                if not covered[i, j] and dx * dx + dy * dy <= radius * radius:
                    covered[i, j] = True
                    so_far += 1
    return count, so_far


@kernel()
def draw_discs(raster: NDArray[np.float32], centres: NDArray[np.float64], radius: float) -> None:
    """Draw discs on a raster of ink coverage.

    ``centres``, shape (n, 2), are columns and rows, and ``radius`` is in texels. At a rim the coverage falls linearly
    over a texel; where rims cross, the uncovered fractions are multiplied.
    """
    rows, columns = raster.shape
    reach = radius + 0.5
    for n in range(centres.shape[0]):
        x, y = centres[n, 0], centres[n, 1]
        for i in range(max(int(np.ceil(y - reach)), 0), min(int(np.floor(y + reach)), rows - 1) + 1):
            for j in range(max(int(np.ceil(x - reach)), 0), min(int(np.floor(x + reach)), columns - 1) + 1):
                share = radius + 0.5 - np.sqrt((j - x) ** 2 + (i - y) ** 2)
                if share > 0.0:
                    raster[i, j] = 1.0 - (1.0 - raster[i, j]) * (1.0 - min(share, 1.0))
