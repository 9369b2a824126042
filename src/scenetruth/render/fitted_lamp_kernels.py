"""Kernels for the light of a round lamp that changes little over it: fits, and its integrals between outlines."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import subkernel
from scenetruth.render.lamp_shadow_kernels import AXIS, CENTRE, OPAQUE, RADIANCE, SIZES, line_pieces
from scenetruth.render.reflectance_kernels import in_frame, reflect_ray

__all__ = ["ANGLES", "PAIR", "along_fitted", "fit_light", "visible_light"]

ANGLES = 5
"""Directions around the lamp at which light is fitted."""
PAIR = 0.5 / np.sqrt(3.0)
"""Distance of the two Gauss points of a line from its middle, in lengths of the line."""
_SIDE = 0.5 * np.sqrt(0.6)  # of three Gauss points
_MOST_EDGES = 128
_CLEAR = 1e-9  # optical depth below which nothing shades, for rounding
_ROUNDING = 1e-9  # distance of edges that coincide, of their length
_CLOSE = 0.2  # distance from the centre of the lamp, in radii, below which edges are not divided further
_LENGTH = 0.7  # of the parts of edges, in distances from the centre


@subkernel()
def fit_light(
    place: NDArray[np.float64], point: NDArray[np.float64], optics: tuple[Any, ...], fit: NDArray[np.float64]
) -> None:
    """Fit the light per area of a round lamp that is far away, compared with its size.

    ``fit``: Mean, and changes with cosine and sine of the angle and of the double angle: at the middle of the lines,
    and the slope along them; of factor and gloss; shape (2, 2, 5).
    """
    frame, eye, leaving, values, tables = optics
    inner, width = place[SIZES], place[SIZES + 1] - place[SIZES]
    for k in range(20):
        fit[k // 10, k // 5 % 2, k % 5] = 0.0
    for number in range(ANGLES):
        right, below = np.cos(2.0 * np.pi * number / ANGLES), np.sin(2.0 * np.pi * number / ANGLES)
        terms = (0.5, right, below, right * right - below * below, 2.0 * right * below)
        for sign in range(-1, 2, 2):
            radius = inner + (0.5 + sign * PAIR) * width
            across, down = radius * right, radius * below
            dx = place[CENTRE] + across * place[3] + down * place[6] - point[0]
            dy = place[CENTRE + 1] + across * place[4] + down * place[7] - point[1]
            dz = place[CENTRE + 2] + across * place[5] + down * place[8] - point[2]
            square = dx * dx + dy * dy + dz * dz
            far = np.sqrt(square)
            incident = -place[RADIANCE] * (dx * place[AXIS] + dy * place[AXIS + 1] + dz * place[AXIS + 2])
            light = in_frame(frame, dx / far, dy / far, dz / far)
            found = reflect_ray(incident / (square * far), light, eye, leaving, values, tables)
            for kind in range(2):
                for k in range(5):
                    part = terms[k] * found[kind] / ANGLES
                    fit[kind, 0, k] += part
                    fit[kind, 1, k] += sign * part / PAIR


@subkernel()
def along_fitted(
    s: float, place: NDArray[np.float64], begin_depth: float, begin: float, shades: tuple[Any, ...],
    fit: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Return visible share of a line across the lamp, factor and gloss, and both without shadows; per s from 0 to 1.

    With light by `fit_light`. ``begin_depth``, ``begin``: See `line_pieces`.
    """
    edges, count, marks, pieces = shades
    inner, outer = place[SIZES], place[SIZES + 1]
    right, below = np.cos(2.0 * np.pi * s), np.sin(2.0 * np.pi * s)
    line = (inner * right, inner * below, outer * right, outer * below)
    kept = line_pieces(line, begin_depth, begin, edges, count, marks, pieces)
    # Area, and its first moment about the middle of the line.
    first, slope = 2.0 * np.pi * inner * (outer - inner), 2.0 * np.pi * (outer - inner) ** 2
    all_area, all_moment = first + 0.5 * slope, slope / 12.0
    area, moment = 0.0, 0.0
    for item in range(kept):
        begin_at, end = pieces[item, 0], pieces[item, 1]
        length, twice, cubes = end - begin_at, 0.5 * (end * end - begin_at * begin_at), (end**3 - begin_at**3) / 3.0
        area += pieces[item, 2] * (first * length + slope * twice)
        moment += pieces[item, 2] * (first * (twice - 0.5 * length) + slope * (cubes - 0.5 * twice))
    one, rise = _around(fit, 0, 0, right, below), _around(fit, 0, 1, right, below)
    shine, gain = _around(fit, 1, 0, right, below), _around(fit, 1, 1, right, below)
    return (
        area / all_area,
        one * area + rise * moment,
        shine * area + gain * moment,
        one * all_area + rise * all_moment,
        shine * all_area + gain * all_moment,
    )


@subkernel()
def _around(fit: NDArray[np.float64], kind: int, which: int, right: float, below: float) -> Any:
    """Return the fitted light in a direction around the lamp, given by its cosine and sine."""
    double, doubled = right * right - below * below, 2.0 * right * below
    low = fit[kind, which, 0] + fit[kind, which, 1] * right + fit[kind, which, 2] * below
    return low + fit[kind, which, 3] * double + fit[kind, which, 4] * doubled


@subkernel()
def visible_light(
    place: NDArray[np.float64], edges: NDArray[np.float64], count: int, depth: float, fit: NDArray[np.float64],
    marks: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Return the light of a round lamp, by `fit_light`, that passes surfaces, and that of the whole lamp.

    Along each ray from the centre outwards, an edge changes the light from there to the rim: the sum over all edges is
    exact, with integrals along each edge between its crossings with others.

    ``edges``, ``depth``: See `trim_edges`. ``marks``: Buffer, shape (n, 2).
    Returns: Factor and gloss; both without shadows; and whether the edges could be followed. They cannot be if there
    are many, or if two of them coincide.
    """
    inner, outer = place[SIZES], place[SIZES + 1]
    width = outer - inner
    first, slope = inner * width, width * width
    area, moment = first + 0.5 * slope, slope / 12.0
    whole = 2.0 * np.pi * (fit[0, 0, 0] * area + fit[0, 1, 0] * moment)
    shine = 2.0 * np.pi * (fit[1, 0, 0] * area + fit[1, 1, 0] * moment)
    share = _transmitted(depth)
    factor, gloss = share * whole, share * shine
    if count > _MOST_EDGES:
        return factor, gloss, whole, shine, False
    for item in range(count):
        ax, ay = edges[item, 0], edges[item, 1]
        dx, dy = edges[item, 2] - ax, edges[item, 3] - ay
        square, along, turn = dx * dx + dy * dy, ax * dx + ay * dy, ax * dy - ay * dx
        # From where to where the edge is within the outer circle, and within the inner.
        rest = along * along - square * (ax * ax + ay * ay - outer * outer)
        if rest <= 0.0 or square == 0.0:
            continue
        low, high = max((-along - np.sqrt(rest)) / square, 0.0), min((-along + np.sqrt(rest)) / square, 1.0)
        if low >= high:
            continue
        enters, leaves = high, high
        rest = along * along - square * (ax * ax + ay * ay - inner * inner)
        if rest > 0.0 and inner > 0.0:
            enters = min(max((-along - np.sqrt(rest)) / square, low), high)
            leaves = min(max((-along + np.sqrt(rest)) / square, low), high)
        used = _find_crossings(edges, count, item, marks)
        if used < 0:
            return factor, gloss, whole, shine, False
        begin, number = low, 0
        while number < used and marks[number, 0] <= low:
            number += 1
        middle = 0.5 * (low + (min(marks[number, 0], high) if number < used else high))
        right = _depth_at(edges, count, item, ax + middle * dx, ay + middle * dy, depth)
        if turn > 0.0:
            # The centre is on the left.
            right -= edges[item, 4]
        while begin < high:
            end = min(marks[number, 0], high) if number < used else high
            weight = _transmitted(right) - _transmitted(right + edges[item, 4])
            if weight != 0.0:
                one, other = 0.0, 0.0
                for piece in range(2):
                    start = begin if piece == 0 else max(begin, leaves)
                    stop = min(end, enters) if piece == 0 else end
                    if start < stop:
                        found = _along_edge(ax, ay, dx, dy, start, stop, inner, outer, fit)
                        one, other = one + found[0], other + found[1]
                start, stop = max(begin, enters), min(end, leaves)
                if start < stop:
                    ends = (ax + start * dx, ay + start * dy, ax + stop * dx, ay + stop * dy)
                    found = _in_sector(ends, area, moment, fit)
                    one, other = one + found[0], other + found[1]
                factor, gloss = factor + weight * one, gloss + weight * other
            if number < used:
                right += marks[number, 1]
            begin, number = end, number + 1
    return factor, gloss, whole, shine, True


@subkernel()
def _transmitted(depth: float) -> Any:
    """Return the light that passes an optical depth."""
    if depth < _CLEAR:
        return 1.0
    return np.exp(-depth) if depth < 0.5 * OPAQUE else 0.0


@subkernel()
def _find_crossings(edges: NDArray[np.float64], count: int, item: int, marks: NDArray[np.float64]) -> Any:
    """Fill in where other edges cross an edge, ascending, and by how much the optical depth increases there.

    Returns their number, or -1 if another edge coincides with it, within rounding.
    """
    ax, ay, bx, by = edges[item, 0], edges[item, 1], edges[item, 2], edges[item, 3]
    dx, dy = bx - ax, by - ay
    rounding = _ROUNDING * (dx * dx + dy * dy)
    used = 0
    for j in range(count):
        cx, cy, ex, ey = edges[j, 0], edges[j, 1], edges[j, 2], edges[j, 3]
        one, other = dx * (cy - ay) - dy * (cx - ax), dx * (ey - ay) - dy * (ex - ax)
        if j == item or (min(one, other) > rounding or max(one, other) < -rounding):
            continue
        if max(abs(one), abs(other)) <= rounding:
            begin, end = dx * (cx - ax) + dy * (cy - ay), dx * (ex - ax) + dy * (ey - ay)
            margin = rounding / _ROUNDING
            if max(begin, end) > _ROUNDING * margin and min(begin, end) < (1.0 - _ROUNDING) * margin:
                return -1
            continue
        if (one > 0.0) == (other > 0.0):
            continue
        if (bx == cx and by == cy) or (ax == ex and ay == ey) or (ax == cx and ay == cy) or (bx == ex and by == ey):
            continue
        fx, fy = ex - cx, ey - cy
        third, fourth = fx * (ay - cy) - fy * (ax - cx), fx * (by - cy) - fy * (bx - cx)
        if (third > 0.0) == (fourth > 0.0):
            continue
        at = third / (third - fourth)
        number = used
        while number > 0 and marks[number - 1, 0] > at:
            marks[number, 0], marks[number, 1] = marks[number - 1, 0], marks[number - 1, 1]
            number -= 1
        marks[number, 0] = at
        # Surfaces begin where their edge crosses from the left to the right.
        marks[number, 1] = edges[j, 4] if one > 0.0 else -edges[j, 4]
        used += 1
    return used


@subkernel()
def _depth_at(edges: NDArray[np.float64], count: int, item: int, x: float, y: float, depth: float) -> Any:
    """Return the optical depth at a point of an edge, on the side of the centre, from that at the centre."""
    for j in range(count):
        cx, cy, ex, ey = edges[j, 0], edges[j, 1], edges[j, 2], edges[j, 3]
        one, other = x * cy - y * cx, x * ey - y * ex
        if j == item or (one > 0.0) == (other > 0.0):
            continue
        fx, fy = ex - cx, ey - cy
        # Whether the other edge is between the centre and the point.
        if (cx * fy - cy * fx > 0.0) != ((cx - x) * fy - (cy - y) * fx > 0.0):
            depth += edges[j, 4] if one > 0.0 else -edges[j, 4]
    return depth


@subkernel()
def _along_edge(
    ax: float, ay: float, dx: float, dy: float, begin: float, end: float, inner: float, outer: float,
    fit: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Integrate the light between a part of an edge and the rim, factor and gloss, by Gauss points along the edge."""
    width = outer - inner
    square, along, turn = dx * dx + dy * dy, ax * dx + ay * dy, ax * dy - ay * dx
    # Area and moment from radius r to the rim: those from the centre, less r² / 2 and r³ / (3 w) - b r² / 2.
    bend = inner / width + 0.5
    ends = (ax + begin * dx, ay + begin * dy, ax + end * dx, ay + end * dy)
    one, other = _in_sector(ends, 0.5 * outer**2, outer**3 / (3.0 * width) - 0.5 * bend * outer**2, fit)
    middle = min(max(-along / square, begin), end)
    nearest = np.sqrt((ax + middle * dx) ** 2 + (ay + middle * dy) ** 2)
    parts = int((end - begin) * np.sqrt(square) / (_LENGTH * max(nearest, _CLOSE * outer))) + 1
    step = (end - begin) / parts
    for part in range(parts):
        for node in range(-1, 2):
            t = begin + (part + 0.5 + node * _SIDE) * step
            x, y = ax + t * dx, ay + t * dy
            radius = np.sqrt(x * x + y * y)
            right, below = x / radius, y / radius
            # The angle changes by turn / r² per t.
            scale = (4.0 if node == 0 else 2.5) / 9.0 * step * turn
            bent = radius / (3.0 * width) - 0.5 * bend
            one -= scale * (0.5 * _around(fit, 0, 0, right, below) + bent * _around(fit, 0, 1, right, below))
            other -= scale * (0.5 * _around(fit, 1, 0, right, below) + bent * _around(fit, 1, 1, right, below))
    return one, other


@subkernel()
def _in_sector(ends: tuple[float, float, float, float], area: float, moment: float, fit: NDArray[np.float64]) -> Any:
    """Return factor and gloss in the sector over a part of an edge: an area and a moment times the fitted light."""
    x, y, u, v = ends
    angle = np.arctan2(x * v - y * u, x * u + y * v)
    here, there = np.sqrt(x * x + y * y), np.sqrt(u * u + v * v)
    x, y, u, v = x / here, y / here, u / there, v / there
    # Integrals of cosine and sine of the angle, and of the double angle.
    waves = (v - y, x - u, u * v - x * y, v * v - y * y)
    one = angle * (area * fit[0, 0, 0] + moment * fit[0, 1, 0])
    other = angle * (area * fit[1, 0, 0] + moment * fit[1, 1, 0])
    for k in range(4):
        one += waves[k] * (area * fit[0, 0, k + 1] + moment * fit[0, 1, k + 1])
        other += waves[k] * (area * fit[1, 0, k + 1] + moment * fit[1, 1, k + 1])
    return one, other
