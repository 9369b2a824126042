"""Kernels for the light of lamps with a size: exact visibility along lines across the lamp, adaptive between them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.raycast.surface_tree_kernels import MOST_FOUND, SurfaceTree, find_between
from scenetruth.render.reflectance_kernels import frame_of, in_frame, reflect_ray, towards
from scenetruth.threads import in_bands

__all__ = ["POLAR", "RECTANGLE", "SPHERE", "light_by_area"]

POLAR, RECTANGLE, SPHERE = 0, 1, 2
"""Shapes of lamps: discs and rings; rectangles; spheres."""

_LEAST_POINTS = 256
_NEAREST = 1e-7  # of the way to the lamp, below which nothing shades
_LINES = 8  # intervals between lines; each is halved at least once
_LEVELS = 7  # most halvings of an interval
_TOLERANCE = 5e-4  # share of the lamp by which the mean of two lines may differ from the line between
_MOST_PIECES = 256  # pieces of a line
_SIDE = 0.5 * np.sqrt(0.6)  # Gauss points of a piece: the middle, and this far from it


def light_by_area(
    lamp: NDArray[np.float64],
    tree: SurfaceTree,
    shares: NDArray[np.float64],
    view: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    starts: NDArray[np.float64],
    surface: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
    factors: NDArray[np.float64],
    gloss: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Add the light of a lamp with a size, in place; arguments as for `reflectance_kernels.reflect_light`.

    ``lamp``: Shape; centre; unit vectors across, down and along the emission; inner and outer radius, or half the width
      and height; and radiance, see `reflection.pack_lamp`, shape (16,).
    ``shares``: Light that passes each face, shape (m,). ``starts``: Origins of the shadow rays, shape (n, 3).
    Returns: Share of the lamp that is visible, shape (n,); -1 where the surface faces away.
    """
    seen = np.empty(len(factors))
    bundle = (tree, shares, starts)
    in_bands(_light_by_area, len(seen), lamp, bundle, view, surface, factors, gloss, seen, least=_LEAST_POINTS)
    return seen


@kernel(error_model="numpy")
def _light_by_area(
    low: int, high: int, lamp: NDArray[np.float64], bundle: tuple[Any, ...], view: tuple[NDArray[Any], ...],
    surface: tuple[NDArray[Any], ...], factors: NDArray[np.float64], gloss: NDArray[np.float64],
    seen: NDArray[np.float64],
) -> None:  # fmt: skip
    tree, shares, starts = bundle
    origin, points, normals, faces = view
    tangents, materials, values, tables = surface
    found, sizes, passed = (
        np.empty(MOST_FOUND, dtype=np.int32),
        np.empty(MOST_FOUND, dtype=np.int32),
        np.empty(MOST_FOUND),
    )
    outlines = np.empty((MOST_FOUND, 5, 2))
    pieces, marks = np.empty((2 * _MOST_PIECES + 1, 3)), np.empty((_MOST_PIECES, 3))
    place, stack = np.empty(15), np.empty((_LEVELS + 2, 9))
    for n in range(low, high):
        seen[n] = -1.0
        m, face = materials[faces[n]], faces[n]
        if not _face_lamp(lamp, points[n], place):
            continue
        height = 0.0
        for k in range(3):
            height += normals[n, k] * (place[k] - points[n, k])
        polar = lamp[0] != RECTANGLE
        radius = place[13] if polar else np.sqrt(place[12] ** 2 + place[13] ** 2)
        if values[m, 4] == 0.0 and height <= -radius:
            continue
        start = (points[n, 0], points[n, 1], points[n, 2])
        if height > 0.0:
            start = (starts[n, 0], starts[n, 1], starts[n, 2])
        count = find_between(tree, start, (place[0], place[1], place[2]), radius, face, found)
        count = _project(tree.corners, found, count, start, place, polar, shares, outlines, sizes, passed)
        frame = frame_of(normals[n], tangents[face])
        eye = towards(frame, origin, points[n])
        shades = (outlines, sizes, passed, count)
        optics = (frame, eye, values[m], tables[m])
        total, factor, shine = _integrate(place, polar, points[n], shades, optics, pieces, marks, stack)
        factors[n] += factor
        gloss[n] += shine
        seen[n] = total


@kernel(error_model="numpy")
def _face_lamp(lamp: NDArray[np.float64], point: NDArray[np.float64], place: NDArray[np.float64]) -> Any:
    """Fill in the flat lamp that a point sees: the lamp, or the disc within the outline of a sphere.

    ``place``: Centre, unit vectors across, down and along the emission, two sizes, and radiance.
    Returns whether the point is in front of the lamp.
    """
    for k in range(15):
        place[k] = lamp[k + 1]
    dx, dy, dz = point[0] - lamp[1], point[1] - lamp[2], point[2] - lamp[3]
    if lamp[0] != SPHERE:
        return dx * lamp[10] + dy * lamp[11] + dz * lamp[12] > 0.0
    far = np.sqrt(dx * dx + dy * dy + dz * dz)
    radius = lamp[14]
    if far <= radius:
        return False
    x, y, z = dx / far, dy / far, dz / far
    share = radius / far
    place[0], place[1], place[2] = (
        lamp[1] + x * radius * share,
        lamp[2] + y * radius * share,
        lamp[3] + z * radius * share,
    )
    place[9], place[10], place[11] = x, y, z
    # Any direction across.
    if abs(z) < 0.7:
        size = np.sqrt(x * x + y * y)
        place[3], place[4], place[5] = -y / size, x / size, 0.0
    else:
        size = np.sqrt(y * y + z * z)
        place[3], place[4], place[5] = 0.0, -z / size, y / size
    place[6] = y * place[5] - z * place[4]
    place[7] = z * place[3] - x * place[5]
    place[8] = x * place[4] - y * place[3]
    place[12], place[13] = 0.0, radius * np.sqrt(1.0 - share * share)
    return True


@kernel(error_model="numpy")
def _project(
    corners: NDArray[np.float64], found: NDArray[np.int32], count: int, start: tuple[float, float, float],
    place: NDArray[np.float64], polar: bool, shares: NDArray[np.float64], outlines: NDArray[np.float64],
    sizes: NDArray[np.int32], passed: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Project the parts of triangles in front of a lamp onto its plane, and return how many there are."""
    whole = 0.0
    for k in range(3):
        whole += (place[k] - start[k]) * place[9 + k]
    wide, high = (place[13], place[13]) if polar else (place[12], place[13])
    way = np.empty(3)
    kept = 0
    for item in range(count):
        face = found[item]
        for c in range(3):
            way[c] = 0.0
            for k in range(3):
                way[c] += (corners[face, c, k] - start[k]) * place[9 + k]
            way[c] /= whole
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
            for share in (begin, end):
                if share == 1.0 or used == 5:
                    continue
                depth = max(way[c] + share * step, _NEAREST)
                across, down = 0.0, 0.0
                for k in range(3):
                    value = corners[face, c, k] + share * (corners[face, d, k] - corners[face, c, k])
                    value = (value - start[k]) / depth + start[k] - place[k]
                    across += value * place[3 + k]
                    down += value * place[6 + k]
                outlines[kept, used, 0], outlines[kept, used, 1] = across, down
                used += 1
        if used < 3:
            continue
        # Outlines of surfaces next to the point are mostly beyond the lamp.
        left, right, above, below = np.inf, -np.inf, np.inf, -np.inf
        for c in range(used):
            left, right = min(left, outlines[kept, c, 0]), max(right, outlines[kept, c, 0])
            above, below = min(above, outlines[kept, c, 1]), max(below, outlines[kept, c, 1])
        if left < wide and right > -wide and above < high and below > -high:
            sizes[kept], passed[kept] = used, shares[face]
            kept += 1
    return kept


@kernel(error_model="numpy")
def _visible_pieces(
    x0: float, y0: float, x1: float, y1: float, shades: tuple[Any, ...], pieces: NDArray[np.float64],
    marks: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Fill in the pieces of a line on the lamp that light reaches: begin, end, share. Return their number."""
    outlines, sizes, passed, count = shades
    dx, dy = x1 - x0, y1 - y0
    used = 0
    for item in range(count):
        low, high = np.inf, -np.inf
        size = sizes[item]
        for c in range(size):
            d = c + 1 if c + 1 < size else 0
            ax, ay = outlines[item, c, 0] - x0, outlines[item, c, 1] - y0
            bx, by = outlines[item, d, 0] - x0, outlines[item, d, 1] - y0
            one, other = dx * ay - dy * ax, dx * by - dy * bx
            if (one > 0.0) == (other > 0.0):
                continue
            share = one / (one - other)
            x, y = ax + share * (bx - ax), ay + share * (by - ay)
            at = (x * dx + y * dy) / (dx * dx + dy * dy)
            low, high = min(low, at), max(high, at)
        low, high = max(low, 0.0), min(high, 1.0)
        if low < high and used < _MOST_PIECES:
            at = used
            while at > 0 and marks[at - 1, 0] > low:
                marks[at] = marks[at - 1]
                at -= 1
            marks[at, 0], marks[at, 1], marks[at, 2] = low, high, passed[item]
            used += 1
    if used == 0:
        # In halves, for the accuracy of the quadrature.
        pieces[0, 0], pieces[0, 1], pieces[0, 2] = 0.0, 0.5, 1.0
        pieces[1, 0], pieces[1, 1], pieces[1, 2] = 0.5, 1.0, 1.0
        return 2
    kept, at = 0, 0.0
    while at < 1.0:
        # The next border, and the light that passes up to there.
        border, share = 1.0, 1.0
        for item in range(used):
            if marks[item, 0] > at:
                border = min(border, marks[item, 0])
                break
            if marks[item, 1] > at:
                border = min(border, marks[item, 1])
                share *= marks[item, 2]
        if share > 0.0 and kept < pieces.shape[0]:
            pieces[kept, 0], pieces[kept, 1], pieces[kept, 2] = at, border, share
            kept += 1
        at = border
    return kept


@kernel(error_model="numpy")
def _along_line(
    s: float, place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], shades: tuple[Any, ...],
    optics: tuple[Any, ...], pieces: NDArray[np.float64], marks: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Return the visible share, factor and gloss of one line across the lamp, per unit of s from 0 to 1."""
    frame, eye, values, tables = optics
    if polar:
        inner, outer = place[12], place[13]
        right, below = np.cos(2.0 * np.pi * s), np.sin(2.0 * np.pi * s)
        x0, y0, x1, y1 = inner * right, inner * below, outer * right, outer * below
    else:
        y0 = y1 = place[13] * (2.0 * s - 1.0)
        x0, x1 = -place[12], place[12]
    count = _visible_pieces(x0, y0, x1, y1, shades, pieces, marks)
    seen, factor, gloss = 0.0, 0.0, 0.0
    for item in range(count):
        begin, end, share = pieces[item, 0], pieces[item, 1], pieces[item, 2]
        for node in range(-1, 2):
            u = begin + (end - begin) * (0.5 + node * _SIDE)
            x, y = x0 + u * (x1 - x0), y0 + u * (y1 - y0)
            weight = (4.0 if node == 0 else 2.5) / 9.0 * share * (end - begin)
            if polar:
                radius = inner + u * (outer - inner)
                area = 2.0 * np.pi * radius * (outer - inner)
                seen += weight * radius * (outer - inner) / (0.5 * (outer * outer - inner * inner))
            else:
                area = 4.0 * place[12] * place[13]
                seen += weight
            dx = place[0] + x * place[3] + y * place[6] - point[0]
            dy = place[1] + x * place[4] + y * place[7] - point[1]
            dz = place[2] + x * place[5] + y * place[8] - point[2]
            square = dx * dx + dy * dy + dz * dz
            far = np.sqrt(square)
            facing = -(dx * place[9] + dy * place[10] + dz * place[11]) / far
            light = in_frame(frame, dx / far, dy / far, dz / far)
            one, other = reflect_ray(place[14] * weight * area * facing / square, light, eye, values, tables)
            factor += one
            gloss += other
    return seen, factor, gloss


@kernel(error_model="numpy")
def _integrate(
    place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], shades: tuple[Any, ...],
    optics: tuple[Any, ...], pieces: NDArray[np.float64], marks: NDArray[np.float64], stack: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Return visible share, factor and gloss of a lamp by Simpson's rule over lines, halved where visibility bends."""
    seen, factor, gloss = 0.0, 0.0, 0.0
    if shades[3] == 0 and polar:
        # Equal steps around a lamp that is wholly visible.
        for number in range(_LINES):
            ray = _along_line(number / _LINES, place, polar, point, shades, optics, pieces, marks)
            seen, factor, gloss = seen + ray[0] / _LINES, factor + ray[1] / _LINES, gloss + ray[2] / _LINES
        return seen, factor, gloss
    first = _along_line(0.0, place, polar, point, shades, optics, pieces, marks)
    before = first
    for number in range(_LINES):
        after = first
        if number + 1 < _LINES or not polar:
            after = _along_line((number + 1) / _LINES, place, polar, point, shades, optics, pieces, marks)
        stack[0, 0], stack[0, 1], stack[0, 2] = number / _LINES, 1.0 / _LINES, 0.0
        stack[0, 3], stack[0, 4], stack[0, 5] = before
        stack[0, 6], stack[0, 7], stack[0, 8] = after
        waiting = 1
        while waiting:
            waiting -= 1
            s, width, level = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
            v0, f0, g0 = stack[waiting, 3], stack[waiting, 4], stack[waiting, 5]
            v1, f1, g1 = stack[waiting, 6], stack[waiting, 7], stack[waiting, 8]
            middle = _along_line(s + 0.5 * width, place, polar, point, shades, optics, pieces, marks)
            if level >= _LEVELS or abs(middle[0] - 0.5 * (v0 + v1)) * width <= _TOLERANCE:
                seen += width / 6.0 * (v0 + 4.0 * middle[0] + v1)
                factor += width / 6.0 * (f0 + 4.0 * middle[1] + f1)
                gloss += width / 6.0 * (g0 + 4.0 * middle[2] + g1)
                continue
            stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = s, 0.5 * width, level + 1.0
            stack[waiting, 6], stack[waiting, 7], stack[waiting, 8] = middle
            stack[waiting + 1, 0], stack[waiting + 1, 1] = s + 0.5 * width, 0.5 * width
            stack[waiting + 1, 2] = level + 1.0
            stack[waiting + 1, 3], stack[waiting + 1, 4], stack[waiting + 1, 5] = middle
            stack[waiting + 1, 6], stack[waiting + 1, 7], stack[waiting + 1, 8] = v1, f1, g1
            waiting += 2
        before = after
    return seen, factor, gloss
