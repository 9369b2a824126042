"""Kernels for the outlines of surfaces in front of a lamp with a size, seen from a point, and lines across them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast.surface_tree_kernels import SurfaceTree

__all__ = ["AXIS", "CENTRE", "OPAQUE", "RADIANCE", "SIZES", "cross_edge", "line_pieces", "outline_edges", "trim_edges"]

CENTRE, ACROSS, DOWN, AXIS, SIZES, RADIANCE = 0, 3, 6, 9, 12, 14
"""Places of the values of a flat lamp: centre, unit vectors across, down and along the emission, inner and outer radius
or half the width and half the height, and radiance.
"""
OPAQUE = 1e3
"""Optical depth of surfaces that transmit no light."""
_NEAREST = 1e-7  # distance, as a fraction of that of the lamp, below which nothing shades
_CLEAR = 1e-9  # optical depth below which nothing shades, for rounding
_ASIDE_X, _ASIDE_Y = 0.7e-6, 0.4e-6  # where lines across round lamps begin, in radii: never on the outline of a surface
_ROUNDING = 1e-5  # margin of the radius


@kernel(error_model="numpy")
def outline_edges(
    tree: SurfaceTree, found: NDArray[np.int32], count: int, start: tuple[float, float, float], near: float, body: int,
    place: NDArray[np.float64], polar: bool, depths: NDArray[np.float64], work: tuple[Any, ...],
    edges: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Project the triangles between a point and a flat lamp onto its plane, and find the edges of their outlines.

    Edges between two triangles that cover the plane on either side of it are omitted.

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
    # Components along the axis, across and down, of the step from the point; and of the point from the centre.
    off_x, off_y = 0.0, 0.0
    for k in range(3):
        off_x += (start[k] - place[k]) * place[ACROSS + k]
        off_y += (start[k] - place[k]) * place[DOWN + k]
    x_axis, x_across, x_down = place[AXIS], place[ACROSS], place[DOWN]
    y_axis, y_across, y_down = place[AXIS + 1], place[ACROSS + 1], place[DOWN + 1]
    z_axis, z_across, z_down = place[AXIS + 2], place[ACROSS + 2], place[DOWN + 2]
    way, across, down = np.empty(3), np.empty(3), np.empty(3)
    kept, certain = 0, True
    for item in range(count):
        face = found[item]
        least, most = np.inf, -np.inf
        for c in range(3):
            dx, dy, dz = corners[face, c, 0] - start[0], corners[face, c, 1] - start[1], corners[face, c, 2] - start[2]
            way[c] = (dx * x_axis + dy * y_axis + dz * z_axis) / whole
            across[c] = dx * x_across + dy * y_across + dz * z_across
            down[c] = dx * x_down + dy * y_down + dz * z_down
            least, most = min(least, way[c]), max(most, way[c])
        if most < _NEAREST or least > 1.0:
            continue
        used, cut = 0, least < _NEAREST or most > 1.0
        if not cut:
            used = 3
            for c in range(3):
                scale = 1.0 / way[c]
                outlines[kept, c, 0], outlines[kept, c, 1] = across[c] * scale + off_x, down[c] * scale + off_y
        for c in range(3 if cut else 0):
            d = (c + 1) % 3
            # The part of a side from `begin` to `end` lies between the point and the lamp.
            begin, end = 0.0, 1.0
            step = way[d] - way[c]
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
                scale = 1.0 / max(way[c] + share * step, _NEAREST)
                outlines[kept, used, 0] = (across[c] + share * (across[d] - across[c])) * scale + off_x
                outlines[kept, used, 1] = (down[c] + share * (down[d] - down[c])) * scale + off_y
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
def trim_edges(edges: NDArray[np.float64], count: int, radius: float) -> Any:
    """Keep the edges that meet a disc of a radius, in place, moved by a little.

    Returns: Number of edges; and the optical depth at the centre of the disc, which is that of all of it without edges.
    """
    depth, kept = 0.0, 0
    reach = (radius * (1.0 + _ROUNDING)) ** 2
    for item in range(count):
        ax, ay = edges[item, 0] - _ASIDE_X * radius, edges[item, 1] - _ASIDE_Y * radius
        bx, by = edges[item, 2] - _ASIDE_X * radius, edges[item, 3] - _ASIDE_Y * radius
        dx, dy = bx - ax, by - ay
        # Edges that cross the line from the left to the centre.
        if (ay > 0.0) != (by > 0.0) and (ax * by - ay * bx > 0.0) != (by > ay):
            depth += edges[item, 4] if ay > 0.0 else -edges[item, 4]
        square, along = dx * dx + dy * dy, -(ax * dx + ay * dy)
        share = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
        if (ax + share * dx) ** 2 + (ay + share * dy) ** 2 <= reach:
            edges[kept, 0], edges[kept, 1], edges[kept, 2], edges[kept, 3] = ax, ay, bx, by
            edges[kept, 4] = edges[item, 4]
            kept += 1
    return kept, depth


@inlined
def cross_edge(
    x: float, y: float, dx: float, dy: float, square: float, edges: NDArray[np.float64], item: int
) -> tuple[float, float]:
    """Return where an edge crosses a line, and from which side: 1 from the left to the right, -1, or 0 if it does not.

    ``x``, ``y``: Begin of the line; ``dx``, ``dy``: to its end; ``square``: squared length. Returns: Side, and place
    from 0 at the begin to 1 at the end, also beyond.
    """
    ax, ay = edges[item, 0] - x, edges[item, 1] - y
    bx, by = edges[item, 2] - x, edges[item, 3] - y
    one, other = dx * ay - dy * ax, dx * by - dy * bx
    if (one > 0.0) == (other > 0.0):
        return 0.0, 0.0
    share = one / (one - other)
    return 1.0 if one > 0.0 else -1.0, ((ax + share * (bx - ax)) * dx + (ay + share * (by - ay)) * dy) / square


@kernel(error_model="numpy")
def line_pieces(
    line: tuple[float, float, float, float], depth: float, begin: float, edges: NDArray[np.float64], count: int,
    marks: NDArray[np.float64], pieces: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Fill in the pieces of a line on the lamp that light reaches: begin, end, share. Return their number.

    ``line``: Both ends. ``depth``, ``begin``: Optical depth at a place of the line at or before 0.
    ``edges``, ``count``: See `outline_edges`. ``marks``: Buffer, shape (n, 2). ``pieces``: Shape (n + 1, 3).
    """
    x0, y0, x1, y1 = line
    dx, dy = x1 - x0, y1 - y0
    square = dx * dx + dy * dy
    used = 0
    for item in range(count):
        side, at = cross_edge(x0, y0, dx, dy, square, edges, item)
        if side == 0.0 or at <= begin:
            continue
        # The surface begins where its edge crosses the line from left to right.
        change = side * edges[item, 4]
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
