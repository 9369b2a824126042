"""By how much blocks of pixels are off in every image, as the warped images tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.shifts import SUMS, add_shifts
from scenetruth.threads import in_threads

__all__ = ["BLOCK_PX", "Shifts"]

BLOCK_PX = 8
"""Edge of a block: smaller than the part of a band's rows that lies beyond it."""


@dataclass(frozen=True, eq=False)
class Shifts:
    """Normal equations of the shifts between every image and the images' mean, in blocks of pixels."""

    sums: NDArray[np.float64]
    """As of `add_shifts`, shape (rows of blocks, columns of blocks, n, 7)."""

    @classmethod
    def blank(cls, shape: tuple[int, int], count: int) -> Shifts:
        """Return sums to be added to.

        Parameters
        ----------
        shape
            Rows and columns of the images.
        count
            Number of images.
        """
        height, width = shape
        return cls(np.zeros((-(-height // BLOCK_PX), -(-width // BLOCK_PX), count, SUMS)))

    def add(
        self, warped: NDArray[np.float32], gradient: NDArray[np.float32], least: int, first: int, rows: tuple[int, int]
    ) -> None:
        """Add one channel's images for the blocks that begin in some rows.

        Parameters
        ----------
        warped, gradient, least
            As of `add_products`.
        first
            Row of the image at which the arrays begin.
        rows
            The first row in which blocks begin, and the one behind the last.
        """
        top, bottom = (-(-row // BLOCK_PX) for row in rows)
        add = partial(add_shifts, warped, gradient, least, first, BLOCK_PX, self.sums)
        in_threads(add, [(row, row + 1) for row in range(top, bottom)])

    def centres(self) -> NDArray[np.intp]:
        """Return row and column in the middle of every block, shape (2, rows of blocks, columns of blocks)."""
        down, across = self.sums.shape[:2]
        return np.stack(np.meshgrid(*(np.arange(n) * BLOCK_PX + BLOCK_PX // 2 for n in (down, across)), indexing="ij"))
