"""Integer coordinates of cameras and frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["centred_indices"]


def centred_indices(count: int) -> NDArray[np.int64]:
    """Return ``count`` consecutive integers with 0 at the centre (the lower centre for an even count).

    >>> centred_indices(5).tolist(), centred_indices(2).tolist()
    ([-2, -1, 0, 1, 2], [0, 1])
    """
    return np.arange(count, dtype=np.int64) - (count - 1) // 2
