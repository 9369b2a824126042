"""Kernel that tells in which images nearer surfaces hide the point of a pixel."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, View, corrected, place_of

__all__ = ["hide"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")

# Grey values this many px beside what hides a point mix both.
_MARGIN = 1


@numba.njit(inline="always")
def _place(accelerated: Any, view: Any, i: Any, fields: Any, y: Any, x: Any) -> Any:
    """Return where an image shows the point of a pixel, and the point's disparity there."""
    at_x, at_y, scale = place_of(accelerated, view, view.s[i], view.s_y[i], view.t[i], fields, y, x)
    at_x, at_y = corrected(view, i, at_x, at_y)
    return at_x, at_y, abs(fields[0, y, x] * scale)


def _compiled(*, accelerated: bool) -> Any:
    @_jit
    def compiled(view: Any, fields: Any, tolerance_px: Any, hidden: Any, group: Any) -> None:
        _, height, width = fields.shape
        largest = np.empty((height, width), dtype=np.float32)
        hidden[group] = 0
        for i in range(8 * group, min(8 * group + 8, len(view.s))):
            if view.s[i] == 0.0 and view.s_y[i] == 0.0 and view.t[i] == 0.0:
                continue
            largest[:] = 0.0
            for y in range(height):
                for x in range(width):
                    at_x, at_y, d = _place(accelerated, view, i, fields, y, x)
                    if at_x >= 0 and at_x < width - 1 and at_y >= 0 and at_y < height - 1:
                        left, top = int(at_x), int(at_y)
                        # The four pixels around it, so that no gaps open.
                        for v in range(top, top + 2):
                            for u in range(left, left + 2):
                                largest[v, u] = max(largest[v, u], d)
            for y in range(height):
                for x in range(width):
                    at_x, at_y, d = _place(accelerated, view, i, fields, y, x)
                    if not (at_x >= 0 and at_x < width - 1 and at_y >= 0 and at_y < height - 1):
                        continue
                    left, top = int(at_x + 0.5), int(at_y + 0.5)
                    behind = False
                    for v in range(max(top - _MARGIN, 0), min(top + _MARGIN + 1, height)):
                        for u in range(max(left - _MARGIN, 0), min(left + _MARGIN + 1, width)):
                            behind = behind or largest[v, u] > d + tolerance_px
                    if behind:
                        hidden[group, y, x] |= np.uint8(1 << (i & 7))

    return compiled


_HIDES = {STEADY: _compiled(accelerated=False), ACCELERATED: _compiled(accelerated=True)}


def hide(
    view: View,
    fields: NDArray[np.float64],
    tolerance_px: float,
    hidden: NDArray[np.uint8],
    group: int,
) -> None:
    """Mark the pixels whose points are hidden in eight of the images.

    A point is hidden where another point of larger disparity is seen in its place or beside it.

    Parameters
    ----------
    view
        Where and when the images were taken.
    fields
        As of `warp_rows`, finite.
    tolerance_px
        Disparities that differ by less are those of one surface.
    hidden
        Output: bit i % 8 of the byte i // 8 for image i, shape (n / 8, height, width).
    group
        Which byte.
    """
    _HIDES[len(fields)](view, fields, tolerance_px, hidden, group)
