"""Kernels for the outlines of surfaces in front of a lamp with a size, seen from a point, and lines across them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.raycast.surface_tree_kernels import SurfaceTree

__all__ = ["AXIS", "CENTRE", "OPAQUE", "RADIANCE", "SIZES", "line_pieces", "outline_edges"]

CENTRE, ACROSS, DOWN, AXIS, SIZES, RADIANCE = 0, 3, 6, 9, 12, 14
"""Places of the values of a flat lamp: centre, unit vectors across, down and along the emission, inner and outer radius
or half the width and half the height, and radiance.
"""
OPAQUE = 1e3
"""Optical depth of surfaces that transmit no light."""
_NEAREST = 1e-7  # distance, as a fraction of that of the lamp, below which nothing shades
_CLEAR = 1e-9  # optical depth below which nothing shades, for rounding


@kernel(error_model="numpy")
def outline_edges(
    tree: SurfaceTree, found: NDArray[np.int32], count: int, start: tuple[float, float, float], near: float, body: int,
    place: NDArray[np.float64], polar: bool, depths: NDArray[np.float64], work: tuple[Any, ...],
    edges: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Project the triangles between a point and a flat lamp onto its plane, and find the edges of their outlines.

    Edges between two triangles that cover the plane on either side of it are left out.

    ``found``, ``count``: Faces, see `find_between`. ``start``: The point. ``body``: Body of the point.
    ``near``: Distance by which the point may move.
    ``place``: The flat lamp. ``polar``: Whether it is round. ``depths``: Optical depth of each face, shape (m,).
    ``work``: Buffers: corners of projected triangles, shape (n, 5, 2); number of corners, side (1 or -1) and face of
      each, shape (n, 3); and the place of each face among them, -1 for none, shape (m,).
    ``edges``: Buffer: both ends, with the surface on the left, and optical depth, shape (5 n, 5).
    Returns: Number of edges; and whether no surface may shade the point if it moves, in any direction, without
    those of its own body closer than 4 times the distance.
    """
    outlines, kinds, slots = work
    corners, neighbours = tree.corners, tree.neighbours
    whole = 0.0
    for k in range(3):
        whole += (place[k] - start[k]) * place[AXIS + k]
    wide, high = (place[13], place[13]) if polar else (place[12], place[13])
    way = np.empty(3)
    kept, certain = 0, True
    for item in range(count):
        face = found[item]
        least, most = np.inf, -np.inf
        for c in range(3):
            way[c] = 0.0
            for k in range(3):
                way[c] += (corners[face, c, k] - start[k]) * place[AXIS + k]
            way[c] /= whole
            least, most = min(least, way[c]), max(most, way[c])
        if most < _NEAREST or least > 1.0:
            continue
        used, cut = 0, least < _NEAREST or most > 1.0
        for c in range(3):
            d = (c + 1) % 3
            # The part of a side from `begin` to `end` lies between the point and the lamp.
            begin, end = 0.0, 1.0
            step = way[d] - way[c]
            if cut:
                if step == 0.0:
                    if way[c] < _NEAREST or way[c] > 1.0:
                        continue
                else:
                    one, other = (_NEAREST - way[c]) / step, (1.0 - way[c]) / step
                    begin, end = max(begin, min(one, other)), min(end, max(one, other))
                    if begin > end:
                        continue
            for number in range(2 if end < 1.0 else 1):
                share = begin if number == 0 else end
                if used == 5:
                    continue
                depth = max(way[c] + share * step, _NEAREST)
                across, down = 0.0, 0.0
                for k in range(3):
                    value = corners[face, c, k] + share * (corners[face, d, k] - corners[face, c, k])
                    value = (value - start[k]) / depth + start[k] - place[k]
                    across += value * place[ACROSS + k]
                    down += value * place[DOWN + k]
                outlines[kept, used, 0], outlines[kept, used, 1] = across, down
                used += 1
        if used < 3:
            continue
        # Outlines of surfaces next to the point are mostly beyond the lamp.
        left, right, above, below = np.inf, -np.inf, np.inf, -np.inf
        area = 0.0
        for c in range(used):
            d = c + 1 if c + 1 < used else 0
            x, y = outlines[kept, c, 0], outlines[kept, c, 1]
            left, right, above, below = min(left, x), max(right, x), min(above, y), max(below, y)
            area += x * outlines[kept, d, 1] - y * outlines[kept, d, 0]
        if left < wide and right > -wide and above < high and below > -high:
            kinds[kept, 0], kinds[kept, 1], kinds[kept, 2] = used, (1 if area > 0.0 else -1), face
            slots[face] = -1 if cut else kept
            kept, certain = kept + 1, False
        elif certain and near > 0.0:
            nearest = max(least, _NEAREST)
            if tree.bodies[face] != body or nearest * whole > 4.0 * near:
                moved = near * (1.0 - min(nearest, 1.0)) / nearest
                certain = not (
                    left < wide + moved and right > -wide - moved and above < high + moved and below > -high - moved
                )
    used = 0
    for item in range(kept):
        size, side, face = kinds[item, 0], kinds[item, 1], kinds[item, 2]
        for c in range(size):
            d = c + 1 if c + 1 < size else 0
            if slots[face] >= 0:
                other = neighbours[face, c]
                same = other >= 0 and slots[other] >= 0 and depths[other] == depths[face]
                if same and kinds[slots[other], 1] == side:
                    continue
            a, b = (c, d) if side > 0 else (d, c)
            edges[used, 0], edges[used, 1] = outlines[item, a, 0], outlines[item, a, 1]
            edges[used, 2], edges[used, 3] = outlines[item, b, 0], outlines[item, b, 1]
            edges[used, 4] = depths[face]
            used += 1
    for item in range(kept):
        slots[kinds[item, 2]] = -1
    return used, certain


@kernel(error_model="numpy")
def line_pieces(
    x0: float, y0: float, x1: float, y1: float, edges: NDArray[np.float64], count: int, marks: NDArray[np.float64],
    pieces: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Fill in the pieces of a line on the lamp that light reaches: begin, end, share. Return their number.

    ``edges``, ``count``: See `outline_edges`. ``marks``: Buffer, shape (n, 2). ``pieces``: Shape (n + 1, 3).
    """
    dx, dy = x1 - x0, y1 - y0
    square = dx * dx + dy * dy
    depth, used = 0.0, 0
    for item in range(count):
        ax, ay = edges[item, 0] - x0, edges[item, 1] - y0
        bx, by = edges[item, 2] - x0, edges[item, 3] - y0
        one, other = dx * ay - dy * ax, dx * by - dy * bx
        if (one > 0.0) == (other > 0.0):
            continue
        share = one / (one - other)
        at = ((ax + share * (bx - ax)) * dx + (ay + share * (by - ay)) * dy) / square
        # The surface begins where its edge crosses the line from left to right.
        change = edges[item, 4] if one > 0.0 else -edges[item, 4]
        if at <= 0.0:
            depth += change
        elif at < 1.0:
            number = used
            while number > 0 and marks[number - 1, 0] > at:
                marks[number, 0], marks[number, 1] = marks[number - 1, 0], marks[number - 1, 1]
                number -= 1
            marks[number, 0], marks[number, 1] = at, change
            used += 1
    kept, at = 0, 0.0
    for number in range(used + 1):
        border = marks[number, 0] if number < used else 1.0
        if depth < 0.5 * OPAQUE and border > at:
            share = 1.0 if depth < _CLEAR else np.exp(-depth)
            pieces[kept, 0], pieces[kept, 1], pieces[kept, 2] = at, border, share
            kept += 1
        at = border
        if number < used:
            depth += marks[number, 1]
    return kept
