"""Kernels that compare the other views: at the ends of the rows of bare surfaces, and at single pixels."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.kernels import kernel

__all__ = ["compare_ends", "compare_pixels", "find_ends"]

_jit = kernel(error_model="numpy")


@_jit
def find_ends(labels: Any, rows: int, ends: Any) -> int:
    """Find the ends of the runs of equal labels in all rows, and connect them into pieces of outlines.

    ``labels``: Number of the surface of every pixel, 0 for none; int32 of shape (y, x).
    ``rows``: Largest number of rows of a piece.
    ``ends``: Output: column and row of the last pixel of the run, side (-1 left, 1 right), length of the run, piece,
      and the end on the other side of the run or -1; int32 of shape (n, 6). Ends of the image are none.
    """
    height, width = labels.shape
    count = pieces = 0
    # Ends of the previous and of this row, and first rows of the pieces.
    before_first = before_last = 0
    top = np.zeros(len(ends), dtype=np.int32)
    for y in range(height):
        first_of_row = count
        x = 0
        while x < width:
            first, label = x, labels[y, x]
            while x < width and labels[y, x] == label:
                x += 1
            if label == 0:
                continue
            pair = -1
            for side in (-1, 1):
                column = first if side < 0 else x - 1
                if (side < 0 and first == 0) or (side > 0 and x == width):
                    continue
                piece = -1
                for n in range(before_first, before_last):
                    if (
                        ends[n, 2] == side
                        and abs(ends[n, 0] - column) <= 2
                        and labels[y - 1, ends[n, 0]] == label
                        and y - top[ends[n, 4]] < rows
                    ):
                        piece = ends[n, 4]
                if piece < 0:
                    piece = pieces
                    top[piece] = y
                    pieces += 1
                ends[count, 0], ends[count, 1], ends[count, 2], ends[count, 3] = column, y, side, x - first
                ends[count, 4], ends[count, 5] = piece, pair
                if pair >= 0:
                    ends[pair, 5] = count
                pair = count
                count += 1
        before_first, before_last = first_of_row, count
    return count


@_jit
def compare_ends(
    ends: Any,
    reach: int,
    grey: Any,
    mean: Any,
    views: Any,
    displacements: Any,
    tolerance: float,
    costs: Any,
    weights: Any,
) -> None:
    """Sum how much the grey values at the ends of runs differ in other views, for every disparity and piece.

    ``ends``: As in `find_ends`.
    ``reach``: Number of pixels of a run that are compared.
    ``grey``, ``mean``: Grey values of the reference, and their means within the surfaces, shape (y, x).
    ``views``: Grey values of the other views, float32 of shape (v, y, x).
    ``displacements``: Displacement of a point in these views, for every disparity; shape (v, k).
    ``tolerance``: Differences up to this are noise; that across the outline counts as one pixel.
    ``costs``, ``weights``: Zero; output: pixels that differ, on average over the views, times contrast, shape
      (pieces, k), and sums of contrasts, shape (pieces,).
    """
    width = views.shape[2]
    for n in range(len(ends)):
        column, y, side, piece = ends[n, 0], ends[n, 1], ends[n, 2], ends[n, 4]
        length = min((ends[n, 3] + 1) // 2, reach)
        contrast = tolerance
        for step in range(1, 4):
            beyond = column + side * step
            if 0 <= beyond < width:
                contrast = max(contrast, abs(grey[y, beyond] - mean[y, column]) - tolerance)
        for k in range(costs.shape[1]):
            total = 0.0
            for v in range(len(views)):
                row = views[v, y]
                shift = displacements[v, k]
                whole = int(np.floor(shift))
                part = np.float32(shift - whole)
                for step in range(length):
                    x = column - side * step
                    left = x + whole
                    if left < 0 or left + 1 >= width:
                        continue
                    off = abs(row[left] + part * (row[left + 1] - row[left]) - mean[y, x])
                    total += min(max((off - tolerance) / contrast, 0.0), 1.0)
            costs[piece, k] += contrast * total / len(views)
        weights[piece] += contrast


@_jit
def compare_pixels(
    first: int,
    last: int,
    disparity: Any,
    grey: Any,
    slope: Any,
    views: Any,
    positions: Any,
    shifts: Any,
    noise: float,
    blur: float,
    out: Any,
) -> None:
    """Compute how much the grey value of each pixel differs in the views on the side that agrees better.

    ``disparity``, ``grey``, ``slope``: Disparity, grey value and its largest change to the next column, shape (y, x).
    ``views``, ``positions``, ``shifts``: Other views, shape (v, y, x), their positions in steps and displacements.
    ``noise``, ``blur``: Tolerated difference, and displacement in px.
    ``out``: Output: mean of the squared ratio to the tolerated difference; 0 where no view contains the point; (y, x).
    """
    width = grey.shape[1]
    for y in range(first, last):
        for x in range(width):
            tolerance = noise * noise + (blur * slope[y, x]) ** 2
            left = right = 0.0
            lefts = rights = 0
            for v in range(len(views)):
                place = x - disparity[y, x] * positions[v] - shifts[v]
                if not 0 <= place < width - 1:
                    continue
                whole = int(place)
                row = views[v, y]
                off = row[whole] + (place - whole) * (row[whole + 1] - row[whole]) - grey[y, x]
                if positions[v] > 0:
                    left, lefts = left + off * off, lefts + 1
                else:
                    right, rights = right + off * off, rights + 1
            best = np.inf
            if lefts > 0:
                best = left / lefts
            if rights > 0:
                best = min(best, right / rights)
            out[y, x] = best / tolerance if lefts + rights > 0 else 0.0
