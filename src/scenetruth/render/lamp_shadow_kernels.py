"""Kernels for the outlines of surfaces in front of a lamp with a size, seen from a point, and lines across them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, subkernel
from scenetruth.raycast.surface_tree_kernels import SurfaceTree

__all__ = [
    "AXIS",
    "CENTRE",
    "OPAQUE",
    "RADIANCE",
    "SIZES",
    "cross_edge",
    "line_pieces",
    "outline_edges",
    "rectangle_depth",
    "surely_lit",
    "trim_edges",
]

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


@subkernel()
def outline_edges(
    tree: SurfaceTree, found: NDArray[np.int32], count: int, start: tuple[float, float, float],
    place: NDArray[np.float64], polar: bool, depths: NDArray[np.float64], sides: NDArray[np.int8],
    outline: NDArray[np.float64], edges: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Project the outlines of the triangles between a point and a flat lamp onto its plane.

    Edges between two triangles of equal depth that cover the plane on either side of it are omitted. Where both cover
    the same side, they have one edge with the depth of both.

    ``found``, ``count``: Faces, see `find_between`; those between point and lamp remain. ``start``: The point.
    ``place``: The flat lamp. ``polar``: Whether it is round. ``depths``: Optical depth of each face, shape (m,).
    ``sides``: Buffer, 0 for all faces, before and after, shape (m,). ``outline``: Buffer, shape (5, 2).
    ``edges``: Buffer: both ends, with the surface on the left, and optical depth, shape (5 n, 5).
    Returns: Number of edges; number of faces that remain; and whether no edge is that of a triangle which is partly
    behind the point or the lamp, and may coincide with others.
    """
    corners, neighbours, planes = tree.corners, tree.neighbours, tree.planes
    whole = 0.0
    for k in range(3):
        whole += (place[k] - start[k]) * place[AXIS + k]
    sx, sy, sz = start[0], start[1], start[2]
    x_axis, y_axis, z_axis = place[AXIS] / whole, place[AXIS + 1] / whole, place[AXIS + 2] / whole
    used, kept, cut = 0, 0, 0
    for item in range(count):
        face = found[item]
        least, most = np.inf, -np.inf
        for c in range(3):
            way = (corners[face, c, 0] - sx) * x_axis + (corners[face, c, 1] - sy) * y_axis
            way += (corners[face, c, 2] - sz) * z_axis
            least, most = min(least, way), max(most, way)
        if most < _NEAREST or least > 1.0:
            continue
        if least < _NEAREST or most > 1.0:
            used = _cut_edges(corners, face, start, whole, place, polar, depths[face], outline, edges, used)
            cut = used
            continue
        off = planes[face, 0] * sx + planes[face, 1] * sy + planes[face, 2] * sz - planes[face, 3]
        sides[face] = 1 if off > 0.0 else -1
        found[kept] = face
        kept += 1
    for item in range(kept):
        face = found[item]
        depth = sides[face] * depths[face]
        for c in range(3):
            other = neighbours[face, c]
            change = depth
            if other >= 0 and sides[other] != 0:
                change -= sides[other] * depths[other]
                if change == 0.0 or other < face:
                    continue
            d = c + 1 if c < 2 else 0
            a, b = (c, d) if change > 0.0 else (d, c)
            edges[used, 0], edges[used, 1] = _projected(corners, face, a, start, whole, place)
            edges[used, 2], edges[used, 3] = _projected(corners, face, b, start, whole, place)
            edges[used, 4] = abs(change)
            used += 1
    for item in range(kept):
        sides[found[item]] = 0
    return used, kept, cut == 0


@inlined
def _projected(
    corners: NDArray[np.float64], face: int, c: int, start: tuple[float, float, float], whole: float,
    place: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Return the place on the plane of a lamp at which a corner appears from a point."""
    dx, dy, dz = corners[face, c, 0] - start[0], corners[face, c, 1] - start[1], corners[face, c, 2] - start[2]
    scale = whole / (dx * place[AXIS] + dy * place[AXIS + 1] + dz * place[AXIS + 2])
    # From the centre of the lamp.
    x = start[0] - place[0] + scale * dx
    y = start[1] - place[1] + scale * dy
    z = start[2] - place[2] + scale * dz
    return (
        x * place[ACROSS] + y * place[ACROSS + 1] + z * place[ACROSS + 2],
        x * place[DOWN] + y * place[DOWN + 1] + z * place[DOWN + 2],
    )


@inlined
def _components(
    corners: NDArray[np.float64], face: int, c: int, start: tuple[float, float, float], whole: float,
    place: NDArray[np.float64],
) -> tuple[float, float, float]:  # fmt: skip
    """Return the step from a point to a corner: along the axis, as a fraction of the lamp's distance; across; down."""
    dx, dy, dz = corners[face, c, 0] - start[0], corners[face, c, 1] - start[1], corners[face, c, 2] - start[2]
    return (
        (dx * place[AXIS] + dy * place[AXIS + 1] + dz * place[AXIS + 2]) / whole,
        dx * place[ACROSS] + dy * place[ACROSS + 1] + dz * place[ACROSS + 2],
        dx * place[DOWN] + dy * place[DOWN + 1] + dz * place[DOWN + 2],
    )


@subkernel()
def _project_between(
    corners: NDArray[np.float64], face: int, start: tuple[float, float, float], whole: float,
    place: NDArray[np.float64], outline: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Project the part of a triangle between a point and a lamp.

    ``outline``: Buffer for its corners, shape (5, 2). Returns: Number of corners, 0 to 5, and the least distance of the
    triangle, as a fraction of that of the lamp.
    """
    first = _components(corners, face, 0, start, whole, place)
    second = _components(corners, face, 1, start, whole, place)
    third = _components(corners, face, 2, start, whole, place)
    way, across, down = (
        (first[0], second[0], third[0]),
        (first[1], second[1], third[1]),
        (first[2], second[2], third[2]),
    )
    least, most = min(way[0], way[1], way[2]), max(way[0], way[1], way[2])
    if most < _NEAREST or least > 1.0:
        return 0, least
    off_x, off_y = 0.0, 0.0
    for k in range(3):
        off_x += (start[k] - place[k]) * place[ACROSS + k]
        off_y += (start[k] - place[k]) * place[DOWN + k]
    if least >= _NEAREST and most <= 1.0:
        for c in range(3):
            outline[c, 0], outline[c, 1] = across[c] / way[c] + off_x, down[c] / way[c] + off_y
        return 3, least
    used = 0
    for c in range(3):
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
            outline[used, 0] = (across[c] + share * (across[d] - across[c])) * scale + off_x
            outline[used, 1] = (down[c] + share * (down[d] - down[c])) * scale + off_y
            used += 1
    return (used if used > 2 else 0), least


@subkernel()
def _reaches(outline: NDArray[np.float64], used: int, place: NDArray[np.float64], polar: bool, moved: float) -> Any:
    """Return whether the box around an outline meets that around a lamp, if it moves; and the area, with its sign."""
    wide, high = (place[13], place[13]) if polar else (place[12], place[13])
    left, right, above, below, area = np.inf, -np.inf, np.inf, -np.inf, 0.0
    for c in range(used):
        d = c + 1 if c + 1 < used else 0
        x, y = outline[c, 0], outline[c, 1]
        left, right, above, below = min(left, x), max(right, x), min(above, y), max(below, y)
        area += x * outline[d, 1] - y * outline[d, 0]
    over = left < wide + moved and right > -wide - moved and above < high + moved and below > -high - moved
    return over, area


@subkernel()
def _cut_edges(
    corners: NDArray[np.float64], face: int, start: tuple[float, float, float], whole: float,
    place: NDArray[np.float64], polar: bool, depth: float, outline: NDArray[np.float64], edges: NDArray[np.float64],
    used: int,
) -> Any:  # fmt: skip
    """Add the edges of a triangle that is partly behind the point or the lamp, and return their number."""
    size, _ = _project_between(corners, face, start, whole, place, outline)
    over, area = _reaches(outline, size, place, polar, 0.0)
    # Outlines of surfaces next to the point are mostly beyond the lamp.
    if size == 0 or not over:
        return used
    for c in range(size):
        d = c + 1 if c + 1 < size else 0
        a, b = (c, d) if area > 0.0 else (d, c)
        edges[used, 0], edges[used, 1] = outline[a, 0], outline[a, 1]
        edges[used, 2], edges[used, 3] = outline[b, 0], outline[b, 1]
        edges[used, 4] = depth
        used += 1
    return used


@subkernel()
def surely_lit(
    tree: SurfaceTree, found: NDArray[np.int32], count: int, start: tuple[float, float, float], near: float, body: int,
    place: NDArray[np.float64], polar: bool,
) -> Any:  # fmt: skip
    """Return whether no surface may shade a point if it moves, in any direction.

    Without those of its own body closer than 4 times the distance ``near``.
    """
    corners, outline = tree.corners, np.empty((5, 2))
    whole = 0.0
    for k in range(3):
        whole += (place[k] - start[k]) * place[AXIS + k]
    for item in range(count):
        face = found[item]
        size, least = _project_between(corners, face, start, whole, place, outline)
        if size == 0:
            continue
        nearest, moved = max(least, _NEAREST), 0.0
        if tree.bodies[face] != body or -nearest * whole > 4.0 * near:
            moved = near * (1.0 - min(nearest, 1.0)) / nearest
        if _reaches(outline, size, place, polar, moved)[0]:
            return False
    return True


@subkernel()
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


@subkernel()
def rectangle_depth(edges: NDArray[np.float64], count: int, wide: float, high: float) -> Any:
    """Return whether edges may meet a rectangle of half a width and height, and the optical depth at its centre."""
    meets, depth = False, 0.0
    for item in range(count):
        ax, ay, bx, by = edges[item, 0], edges[item, 1], edges[item, 2], edges[item, 3]
        if min(ax, bx) <= wide and max(ax, bx) >= -wide and min(ay, by) <= high and max(ay, by) >= -high:
            meets = True
        if (ay > 0.0) != (by > 0.0) and (ax * by - ay * bx > 0.0) != (by > ay):
            depth += edges[item, 4] if ay > 0.0 else -edges[item, 4]
    return meets, depth


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


@subkernel()
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
