"""Who looks at the reference's points, and from where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Row", "row_of"]


@dataclass(frozen=True, eq=False)
class Row:
    """The views of a row of cameras beside the reference; those on one side come first."""

    reference: int
    """Place of the reference among the images."""
    others: NDArray[np.int64]
    """Places of the other views among the images."""
    positions: NDArray[np.float64]
    """Their positions in steps: where disparity is d, a view at s sees at x - d s what the reference sees at x."""

    @property
    def left(self) -> int:
        """How many views see points further to the left than the reference does."""
        return int((self.positions > 0).sum())

    @property
    def nearest(self) -> NDArray[np.float64]:
        """The positions of the nearest view of each side."""
        sides = (self.positions[: self.left], self.positions[self.left :])
        return np.array([side[np.argmin(np.abs(side))] for side in sides if len(side) > 0])

    @property
    def farthest(self) -> float:
        """The distance of the farthest view."""
        return float(np.abs(self.positions).max())


def row_of(positions: ArrayLike, sign: float) -> Row:
    """Return the views of cameras along a stage.

    Parameters
    ----------
    positions
        In steps, one of them 0: the reference.
    sign
        That of disparity. Seen with the opposite positions, disparities are positive.

    Examples
    --------
    >>> row = row_of([-1, 0, 2], -1.0)
    >>> row.reference, row.others.tolist(), row.positions.tolist(), row.nearest.tolist()
    (1, [0, 2], [1.0, -2.0], [1.0, -2.0])
    """
    signed = np.asarray(positions, dtype=np.float64) * (1.0 if sign > 0 else -1.0)
    reference = int(np.argmin(np.abs(signed)))
    others = [n for n in np.argsort(-signed, kind="stable") if n != reference]
    return Row(reference, np.array(others, dtype=np.int64), signed[others])
