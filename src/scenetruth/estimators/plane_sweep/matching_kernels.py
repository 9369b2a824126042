"""Kernels of the plane sweep: census costs, semi-global aggregation, and selection of the best hypothesis."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.estimators.intrinsic_kernels import add, least, ones, subtract
from scenetruth.kernels import kernel

__all__ = [
    "CENSUS_REACH",
    "COST_OF_BIT",
    "OTHER_SIDE",
    "PHASES",
    "UNSEEN",
    "aggregate",
    "agreeing",
    "census",
    "fill_costs",
    "shifted",
    "winners",
]


_jit = kernel(error_model="numpy")

PHASES = 8
"""Number of subpixel positions at which views are sampled."""
COST_OF_BIT = 4
"""Cost of each of the 48 bits that differs."""
OTHER_SIDE = 0.1
"""Weight of the side that agrees less, which stabilises points visible on both sides."""
UNSEEN = 64
"""Cost where no view covers a point: below that of a random match, above that of a correct match."""
CENSUS_REACH = 3
"""Half width of the square of the census, without its centre, in px."""
_REACH = CENSUS_REACH
_SIDE = 2 * _REACH + 1


@_jit
def shifted(image: Any, phase: int, out: Any) -> None:
    """Shift an image to the left by phase / PHASES px, by cubic convolution (Catmull-Rom), with border replication."""
    height, width = image.shape
    f = np.float32(phase / PHASES)
    half, one = np.float32(0.5), np.float32(1.0)
    a = half * f * (-one + f * (np.float32(2.0) - f))
    b = one + half * f * f * (np.float32(-5.0) + np.float32(3.0) * f)
    c = half * f * (one + f * (np.float32(4.0) - np.float32(3.0) * f))
    d = half * f * f * (f - one)
    for y in range(height):
        for x in range(width):
            if 1 <= x < width - 2:
                out[y, x] = a * image[y, x - 1] + b * image[y, x] + c * image[y, x + 1] + d * image[y, x + 2]
            else:
                right = min(x + 1, width - 1)
                far = min(x + 2, width - 1)
                out[y, x] = a * image[y, max(x - 1, 0)] + b * image[y, x] + c * image[y, right] + d * image[y, far]


@_jit
def census(image: Any, out: Any) -> None:
    """Write which of the 7 x 7 pixels around each are darker, as 48 bits (uint64), with border replication."""
    height, width = image.shape
    rows = np.empty((2 * _REACH + 1, width + 2 * _REACH), dtype=np.float32)
    halves = np.empty((2, width), dtype=np.uint32)
    for y in range(height):
        for i in range(2 * _REACH + 1):
            row = image[min(max(y + i - _REACH, 0), height - 1)]
            rows[i, :_REACH] = row[0]
            for x in range(width):
                rows[i, x + _REACH] = row[x]
            rows[i, width + _REACH :] = row[width - 1]
        halves[:] = np.uint32(0)
        centre = image[y]
        for n in range(_SIDE * _SIDE):
            i, j = n // _SIDE, n % _SIDE
            if i == _REACH and j == _REACH:
                continue
            half = halves[1 if i > _REACH or (i == _REACH and j > _REACH) else 0]
            other = rows[i, j : j + width]
            for x in range(width):
                darker = np.uint32(1) if other[x] < centre[x] else np.uint32(0)
                half[x] = add(add(half[x], half[x]), darker)
        for x in range(width):
            out[y, x] = (np.uint64(halves[0, x]) << np.uint64(24)) | np.uint64(halves[1, x])


@_jit
def fill_costs(reference: Any, views: Any, covered: Any, whole: Any, phase: Any, left: int, out: Any) -> None:
    """Compute the cost of every hypothesis from the reference and all views.

    Of the views on the two sides of the reference, the side with the better match dominates, because occlusions mostly
    affect one side only.

    ``reference``: Census of the reference, shape (y, x).
    ``views``: Census of the other views, shifted by every phase, shape (view, phase, y, x); the left side first.
    ``covered``: All bits set where a view has a grey value, unshifted and shifted, else none, uint64 of shape (view, 2,
      y, x); of size 0 if all pixels have one.
    ``out``: Output: COST_OF_BIT times the mean number of bits that differ; UNSEEN where no view covers the point;
      uint8 of shape (y, x, k).
    """
    height, width = reference.shape
    count = whole.shape[0]
    bits = np.empty((2, width), dtype=np.uint32)
    seen = np.empty((2, width), dtype=np.uint32)
    row = np.empty((count, width), dtype=np.uint8)
    scale, near, far = np.float32(COST_OF_BIT), np.float32(1.0 - OTHER_SIDE), np.float32(OTHER_SIDE)
    for y in range(height):
        here = reference[y]
        for k in range(count):
            bits[:], seen[:] = np.uint32(0), np.uint32(0)
            for v in range(len(views)):
                shift = whole[k, v]
                first, last = max(-shift, 0), min(width - shift - (1 if phase[k, v] > 0 else 0), width)
                if first >= last:
                    continue
                there = views[v, phase[k, v], y, first + shift : last + shift]
                place = here[first:last]
                side = 0 if v < left else 1
                sums, numbers = bits[side, first:last], seen[side, first:last]
                if covered.size > 0:
                    known = covered[v, 1 if phase[k, v] > 0 else 0, y, first + shift : last + shift]
                    for x in range(last - first):
                        sums[x] = add(sums[x], np.uint32(ones((place[x] ^ there[x]) & known[x])))
                        numbers[x] = add(numbers[x], np.uint32(known[x] & np.uint64(1)))
                    continue
                for x in range(last - first):
                    sums[x] = add(sums[x], np.uint32(ones(place[x] ^ there[x])))
                    numbers[x] = add(numbers[x], np.uint32(1))
            for x in range(width):
                a, b = np.float32(bits[0, x]), np.float32(bits[1, x])
                m, n = np.float32(seen[0, x]), np.float32(seen[1, x])
                one, two = scale * a / m, scale * b / n
                best = one if m > 0 else two
                best = near * min(one, two) + far * max(one, two) if m > 0 and n > 0 else best
                row[k, x] = np.uint8(best) if m + n > 0 else np.uint8(UNSEEN)
        for x in range(width):
            for k in range(count):
                out[y, x, k] = row[k, x]


_FAR = np.uint16(16384)


@_jit
def _pass(costs: Any, edges: Any, step_penalty: Any, jumps: Any, total: Any, turn: bool) -> None:
    """Add the costs along four paths: from the left and the three neighbours above; with ``turn``, the other four."""
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
            # Index in the buffers is column + 1; the previous pixel is on the side where the pass comes from.
            a, b, c = old[0, column], old[1, column + 1], old[2, column + 2]
            low_a, low_b, low_c = lows[0, column], lows[1, column + 1], lows[2, column + 2]
            here_a, here_b, here_c = new[0, column + 1], new[1, column + 1], new[2, column + 1]
            before, after = side[column % 2], side[(column + 1) % 2]
            cost, sums = costs[y, x], total[y, x]
            # The cost of a path is limited to its previous minimum plus the jump penalty.
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
        # Paths start again at the image sides.
        old, new = new, old
        lows, fresh = fresh, lows
        old[:, 0, 1:-1], old[:, -1, 1:-1] = 0, 0
        lows[:, 0], lows[:, -1] = 0, 0


@_jit
def aggregate(costs: Any, edges: Any, step_penalty: Any, jumps: Any, total: Any) -> None:
    """Add the minimum path costs of every pixel and hypothesis along eight paths.

    ``costs``: Cost of every hypothesis, uint8 of shape (y, x, k).
    ``edges``: Grey values in 0 to 255, uint8 of shape (y, x).
    ``step_penalty``: Penalty of a step from hypothesis k - 1 to k, uint16 of shape (k + 1,).
    ``jumps``: Penalty of larger steps for every difference of grey values, uint16 of shape (256,).
    ``total``: Output: the sums, uint16 of shape (y, x, k).
    """
    total[:] = np.uint16(0)
    _pass(costs, edges, step_penalty, jumps, total, False)
    _pass(costs, edges, step_penalty, jumps, total, True)


_MOST = np.uint16(65535)
_FLOOR = 8 * 10.0 * COST_OF_BIT  # ten bits on each of eight paths


@_jit
def winners(total: Any, costs: Any, wide: int, place: Any, distinct: Any, own: Any) -> None:
    """Select the hypothesis of minimum cost for every pixel.

    ``total``: Aggregated costs, uint16 of shape (y, x, k).
    ``costs``: Costs of the pixels alone, uint8 of the same shape.
    ``place``: Output: index of the best hypothesis, refined by a parabola and by lines of equal slopes through three
      costs, shape (y, x).
    ``distinct``: Output: cost ratio of the best other hypothesis, shape (y, x). Ten bits are added to both costs, which
      limits the effect of noise on small costs.
    ``own``: Output: cost of the pixel alone for the best hypothesis, shape (y, x).
    """
    height, width, count = total.shape
    for y in range(height):
        for x in range(width):
            ways = total[y, x]
            best = _MOST
            for k in range(count):
                best = least(best, ways[k])
            k = 0
            while ways[k] != best:
                k += 1
            other = _MOST
            for n in range(0, max(k - wide, 0)):
                other = least(other, ways[n])
            for n in range(min(k + wide + 1, count), count):
                other = least(other, ways[n])
            found = float(k)
            if 0 < k < count - 1:
                before, after = float(ways[k - 1]), float(ways[k + 1])
                bend = before - 2.0 * float(best) + after
                if bend > 0.0:
                    # A parabola pulls towards the hypotheses, lines of equal slopes pull away from them.
                    lines = max(before, after) - float(best)
                    found += 0.25 * (before - after) * (1.0 / bend + 1.0 / lines)
            place[y, x], own[y, x] = found, costs[y, x, k]
            distinct[y, x] = (float(other) + _FLOOR) / (float(best) + _FLOOR)


@_jit
def agreeing(total: Any, shifts: Any, place: Any, tolerance: int, agrees: Any) -> None:
    """Mark pixels whose hypothesis is also the best one in another view.

    The costs of pixel x' of that view are those of the reference at x' - shifts[k]: a diagonal through the volume.

    ``total``: Costs, uint16 of shape (y, x, k).
    ``shifts``: Shift of a point to the right in the view, for every hypothesis, in whole px.
    ``place``: Selected hypotheses, shape (y, x).
    ``agrees``: Output: set where they agree within the tolerance, else unchanged; shape (y, x).
    """
    height, width, count = total.shape
    lows = np.empty(width, dtype=np.uint16)
    chosen = np.empty(width, dtype=np.int64)
    for y in range(height):
        lows[:] = _MOST
        chosen[:] = -count
        for x in range(width):
            costs = total[y, x]
            for k in range(count):
                there = x + shifts[k]
                if 0 <= there < width and costs[k] < lows[there]:
                    lows[there] = costs[k]
                    chosen[there] = k
        for x in range(width):
            k = round(place[y, x])
            there = x + shifts[k]
            if 0 <= there < width and abs(chosen[there] - k) <= tolerance:
                agrees[y, x] = True
