"""Kernels that choose the rule of every pixel, and turn samples at pixel centres into means over pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["NO_RULE", "choose_rules", "filter_samples", "texture_ranges"]

NO_RULE = 255
"""Rule of pixels without a surface, and of mixed pixels."""

_LEAST_ROWS = 8  # minimum number of pixel rows per thread
# Change of the texture step between the two sides of a pixel, as a fraction of the step, above which the texture does
# not run smoothly through the pixel: at seams, and where a surface turns away.
_BENT = 0.2


def choose_rules(
    uv: NDArray[np.float64],
    body: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    texels: NDArray[np.float64],
    longest: NDArray[np.float64],
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Choose the first rule whose longest step is at least the texture step of a pixel to its neighbours.

    ``uv``: Texture coordinates at the pixel centres, shape (height, width, 2).
    ``body``: Body at each pixel, -1 for none, shape (height, width).
    ``mixed``: Pixels whose footprint crosses an edge, shape (height, width).
    ``texels``: Texels per unit of u and v of each body, shape (bodies, 2).
    ``longest``: Longest steps of the rules of each body in texels, shape (bodies, rules); the first rule needs a
      texture that runs smoothly through the pixel.
    Returns: Index of the rule, the number of rules if none is fine enough, or `NO_RULE`; and the texture step in
    texels, infinite where a neighbour is missing along an axis; shape (height, width).
    """
    rules, steps = np.empty(body.shape, dtype=np.uint8), np.empty(body.shape, dtype=np.float32)
    in_bands(_choose_rules, body.shape[0], uv, body, mixed, texels, longest, rules, steps, least=_LEAST_ROWS)
    return rules, steps


@kernel()
def _choose_rules(
    low: int, high: int, uv: NDArray[np.float64], body: NDArray[np.int32], mixed: NDArray[np.bool_],
    texels: NDArray[np.float64], longest: NDArray[np.float64], rules: NDArray[np.uint8], steps: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = body.shape
    count = longest.shape[1]
    for y in range(low, high):
        for x in range(columns):
            own = body[y, x]
            if own < 0 or mixed[y, x]:
                rules[y, x], steps[y, x] = NO_RULE, np.inf
                continue
            scale_u, scale_v = texels[own, 0], texels[own, 1]
            u, v = uv[y, x, 0], uv[y, x, 1]
            step, bend, alone = 0.0, 0.0, False
            for axis in range(2):
                sides, sum_u, sum_v = 0, 0.0, 0.0
                for way in (-1, 1):
                    below, right = y + way * axis, x + way * (1 - axis)
                    if below < 0 or right < 0 or below >= rows or right >= columns:
                        continue
                    if body[below, right] != own or mixed[below, right]:
                        continue
                    du, dv = (uv[below, right, 0] - u) * scale_u, (uv[below, right, 1] - v) * scale_v
                    step = max(step, du * du + dv * dv)
                    sum_u, sum_v, sides = sum_u + du, sum_v + dv, sides + 1
                if sides == 2:
                    bend = max(bend, sum_u * sum_u + sum_v * sum_v)
                alone = alone or sides == 0
            step = np.sqrt(step)
            rule = 1 if np.sqrt(bend) > _BENT * step else 0
            while rule < count and not step <= longest[own, rule]:
                rule += 1
            # Without a neighbour, the step along that axis is missing: the finest rule is used.
            rules[y, x] = max(rule, count - 1) if alone else rule
            steps[y, x] = np.inf if alone else step


def texture_ranges(
    lowest: NDArray[np.float32],
    highest: NDArray[np.float32],
    tiled: bool,
    places: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Compute the range of a texture in squares, from the lowest and highest value of blocks of its texels.

    ``lowest``, ``highest``: Of every block, including the texels that border it, shape (rows, columns).
    ``tiled``: Whether the texture repeats; otherwise its border is extended.
    ``places``: Centres of the squares in blocks, (x, y), shape (n, 2).
    ``reach``: Half their side in blocks, shape (n,).
    Returns: Highest minus lowest value of the blocks that a square touches, shape (n,).
    """
    out = np.empty(places.shape[0], dtype=np.float64)
    in_bands(_texture_ranges, places.shape[0], lowest, highest, tiled, places, reach, out)
    return out


@kernel()
def _texture_ranges(
    low: int, high: int, lowest: NDArray[np.float32], highest: NDArray[np.float32], tiled: bool,
    places: NDArray[np.float64], reach: NDArray[np.float64], out: NDArray[np.float64],
) -> None:  # fmt: skip
    rows, columns = lowest.shape
    for n in range(low, high):
        x, y, half = places[n, 0], places[n, 1], min(reach[n], 1e9)
        least, most = np.inf, -np.inf
        first_row, last_row = int(np.floor(y - half)), int(np.floor(y + half))
        first_column, last_column = int(np.floor(x - half)), int(np.floor(x + half))
        if tiled:
            # As many blocks as there are contain all values.
            last_row, last_column = min(last_row, first_row + rows - 1), min(last_column, first_column + columns - 1)
        else:
            first_row, last_row = min(max(first_row, 0), rows - 1), min(max(last_row, 0), rows - 1)
            first_column, last_column = min(max(first_column, 0), columns - 1), min(max(last_column, 0), columns - 1)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                v, u = (row % rows, column % columns) if tiled else (row, column)
                least, most = min(least, lowest[v, u]), max(most, highest[v, u])
        out[n] = most - least


def filter_samples(
    samples: NDArray[np.float32], usable: NDArray[np.bool_], body: NDArray[np.int32], taps: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Filter samples at pixel centres along x and y where all samples under the filter are usable and of one body.

    ``samples``, ``usable``, ``body``: Shape (height, width). ``taps``: Seven weights.
    Returns: The filtered samples, and where they are filtered, shape (height, width); samples elsewhere are unchanged.
    """
    shape = samples.shape
    across, free = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.bool_)
    in_bands(_filter_across, shape[0], samples, usable, body, taps, across, free, least=_LEAST_ROWS)
    out, done = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.bool_)
    in_bands(_filter_down, shape[0], samples, across, free, body, taps, out, done, least=_LEAST_ROWS)
    return out, done


@kernel()
def _filter_across(
    low: int, high: int, samples: NDArray[np.float32], usable: NDArray[np.bool_], body: NDArray[np.int32],
    taps: NDArray[np.float64], across: NDArray[np.float32], free: NDArray[np.bool_],
) -> None:  # fmt: skip
    columns = samples.shape[1]
    t0, t1, t2, t3 = taps[3], taps[2], taps[1], taps[0]
    for y in range(low, high):
        run, own = 0, -1
        for x in range(columns):
            free[y, x], across[y, x] = False, 0.0
            if not usable[y, x]:
                run = 0
            else:
                run = run + 1 if body[y, x] == own else 1
                own = body[y, x]
            if run >= 7:
                at = x - 3
                free[y, at] = True
                across[y, at] = (
                    t0 * np.float64(samples[y, at])
                    + t1 * (np.float64(samples[y, at - 1]) + np.float64(samples[y, at + 1]))
                    + t2 * (np.float64(samples[y, at - 2]) + np.float64(samples[y, at + 2]))
                    + t3 * (np.float64(samples[y, at - 3]) + np.float64(samples[y, at + 3]))
                )


@kernel()
def _filter_down(
    low: int, high: int, samples: NDArray[np.float32], across: NDArray[np.float32], free: NDArray[np.bool_],
    body: NDArray[np.int32], taps: NDArray[np.float64], out: NDArray[np.float32], done: NDArray[np.bool_],
) -> None:  # fmt: skip
    rows, columns = samples.shape
    t0, t1, t2, t3 = taps[3], taps[2], taps[1], taps[0]
    for y in range(low, high):
        inside = y >= 3 and y + 3 < rows
        for x in range(columns):
            whole: Any = inside and free[y, x]
            if whole:
                own = body[y, x]
                for k in (-3, -2, -1, 1, 2, 3):
                    whole = whole and free[y + k, x] and body[y + k, x] == own
            done[y, x] = whole
            if whole:
                out[y, x] = (
                    t0 * across[y, x]
                    + t1 * (across[y - 1, x] + across[y + 1, x])
                    + t2 * (across[y - 2, x] + across[y + 2, x])
                    + t3 * (across[y - 3, x] + across[y + 3, x])
                )
            else:
                out[y, x] = samples[y, x]
