"""Kernels of semi-global matching."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from scenetruth.estimators.plane_sweep.kernels.narrow import add, least, subtract

__all__ = ["aggregate"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")
_FAR = np.uint16(16384)


@_jit
def _pass(costs: Any, edges: Any, step_penalty: Any, jumps: Any, total: Any, turn: bool) -> None:
    """Add the costs along four paths: from the left and from the three neighbours above; turned, the other four."""
    height, width, count = costs.shape
    old = np.empty((3, width + 2, count + 2), dtype=np.uint16)
    new = np.empty((3, width + 2, count + 2), dtype=np.uint16)
    old[:], new[:] = _FAR, _FAR
    lows = np.zeros((3, width + 2), dtype=np.uint16)
    fresh = np.zeros((3, width + 2), dtype=np.uint16)
    old[:, :, 1:-1] = 0
    side = np.empty((2, count + 2), dtype=np.uint16)
    for row in range(height):
        y = height - 1 - row if turn else row
        back_y = min(max(y + 1 if turn else y - 1, 0), height - 1)
        side[:] = _FAR
        side[0, 1:-1] = 0
        low = np.uint16(0)
        for column in range(width):
            x = width - 1 - column if turn else column
            back_x = min(max(x + 1 if turn else x - 1, 0), width - 1)
            ahead_x = min(max(x - 1 if turn else x + 1, 0), width - 1)
            here = np.int64(edges[y, x])
            jump_side = jumps[abs(here - np.int64(edges[y, back_x]))]
            jump_a = jumps[abs(here - np.int64(edges[back_y, back_x]))]
            jump_b = jumps[abs(here - np.int64(edges[back_y, x]))]
            jump_c = jumps[abs(here - np.int64(edges[back_y, ahead_x]))]
            # Places in the buffers: column + 1; the one before is to the side where the pass comes from.
            a, b, c = old[0, column], old[1, column + 1], old[2, column + 2]
            low_a, low_b, low_c = lows[0, column], lows[1, column + 1], lows[2, column + 2]
            here_a, here_b, here_c = new[0, column + 1], new[1, column + 1], new[2, column + 1]
            before, after = side[column % 2], side[(column + 1) % 2]
            cost, sums = costs[y, x], total[y, x]
            # No path costs more than its best way plus a jump.
            most_side, most_a = add(low, jump_side), add(low_a, jump_a)
            most_b, most_c = add(low_b, jump_b), add(low_c, jump_c)
            best, best_a, best_b, best_c = _FAR, _FAR, _FAR, _FAR
            for k in range(count):
                own = np.uint16(cost[k])
                down, up = step_penalty[k], step_penalty[k + 1]
                v = least(before[k + 1], least(add(before[k], down), add(before[k + 2], up)))
                v = add(own, subtract(least(v, most_side), low))
                after[k + 1] = v
                best = least(best, v)
                va = least(a[k + 1], least(add(a[k], down), add(a[k + 2], up)))
                va = add(own, subtract(least(va, most_a), low_a))
                here_a[k + 1] = va
                best_a = least(best_a, va)
                vb = least(b[k + 1], least(add(b[k], down), add(b[k + 2], up)))
                vb = add(own, subtract(least(vb, most_b), low_b))
                here_b[k + 1] = vb
                best_b = least(best_b, vb)
                vc = least(c[k + 1], least(add(c[k], down), add(c[k + 2], up)))
                vc = add(own, subtract(least(vc, most_c), low_c))
                here_c[k + 1] = vc
                best_c = least(best_c, vc)
                sums[k] = add(sums[k], add(add(v, va), add(vb, vc)))
            low = best
            fresh[0, column + 1], fresh[1, column + 1], fresh[2, column + 1] = best_a, best_b, best_c
        # Paths begin anew at the sides.
        old, new = new, old
        lows, fresh = fresh, lows
        old[:, 0, 1:-1], old[:, -1, 1:-1] = 0, 0
        lows[:, 0], lows[:, -1] = 0, 0


@_jit
def aggregate(costs: Any, edges: Any, step_penalty: Any, jumps: Any, total: Any) -> None:
    """Add the least costs of ways to every pixel and hypothesis along eight paths.

    Parameters
    ----------
    costs
        Cost of every hypothesis, uint8 of shape (y, x, k).
    edges
        Grey values in 0 to 255, uint8 of shape (y, x).
    step_penalty
        Penalty of a step from hypothesis k - 1 to k, uint16 of shape (k + 1,).
    jumps
        Penalty of larger steps for every difference of grey values, uint16 of shape (256,).
    total
        Output: the sums, uint16 of shape (y, x, k).
    """
    total[:] = np.uint16(0)
    _pass(costs, edges, step_penalty, jumps, total, False)
    _pass(costs, edges, step_penalty, jumps, total, True)
