"""Kernels for the light of lamps with a size: closed forms, and exact visibility along lines across the lamp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel
from scenetruth.raycast.surface_tree_kernels import SurfaceTree, find_between
from scenetruth.render.fitted_lamp_kernels import ANGLES, PAIR, along_fitted, fit_light, visible_light
from scenetruth.render.lamp_shadow_kernels import (
    AXIS,
    CENTRE,
    OPAQUE,
    RADIANCE,
    SIZES,
    cross_edge,
    line_pieces,
    outline_edges,
    rectangle_depth,
    surely_lit,
    trim_edges,
)
from scenetruth.render.reflectance_kernels import entering, frame_of, in_frame, reflect_ray, towards
from scenetruth.threads import in_bands

__all__ = ["CERTAIN", "POLAR", "RECTANGLE", "SPHERE", "VISIBLE", "lamp_shares", "unshaded_corners", "unshaded_light"]

POLAR, RECTANGLE, SPHERE = 0, 1, 2
"""Shapes of lamps: discs and rings; rectangles; spheres."""
VISIBLE, CERTAIN = 1, 2
"""States of points: the lamp is visible from the point; and from all points near it."""

_LEAST_POINTS = 256
_FIRST_FOUND = 1024
_NARROWEST = 1e-9  # interval between lines
_LEVELS = 10  # most halvings of an interval between lines
_TOLERANCE = 2e-4  # share of the lamp by which the mean of two lines may differ from the line between
_QUADRATURE = 9.2  # -ln of the error of sums around a lamp, 1e-4
_FEWEST, _FEWEST_SHADED, _MOST = ANGLES, 4, 192  # lines
_MOST_PARTS = 32  # of a line
_CLEAR = 1e-9  # optical depth, for rounding
_LONG = 0.3  # edges of outlines, of the size of the lamp
_LITTLE = 0.4  # parts of a line, below which two points serve
_SINE = np.sqrt(0.75)  # of 120°
_SIDE = 0.5 * np.sqrt(0.6)  # Gauss points of a part: the middle, and this far from it

# Further values of a flat lamp and a surface: height of the lamp above the tangent plane, its change across and down;
# number of parts of a line; optical depth at the place where lines begin, and this place on each line.
_HEIGHT, _RISE, _PARTS, _DEPTH, _BEGIN, _PLACES = 15, 16, 18, 19, 20, 21


def unshaded_light(
    lamp: NDArray[np.float64],
    view: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    surface: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Compute the light of a lamp with a size that nothing shades, as factor and gloss, shape (n, 2).

    ``lamp``: Shape; centre; unit vectors across, down and along the emission; inner and outer radius, or half the width
      and half the height; and radiance, see `area_lamps.pack_lamp`, shape (16,).
    ``view``, ``surface``: As for `reflectance_kernels.reflect_light`.
    """
    out = np.empty((len(view[1]), 2))
    in_bands(_unshaded_light, len(out), lamp, view, surface, out, least=_LEAST_POINTS)
    return out


def unshaded_corners(
    lamp: NDArray[np.float64],
    view: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    surface: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Compute the light at the corners of small faces, as `unshaded_light`, shape (n, 3, 2).

    ``view``: Camera; corners, shape (n, 3, 3); and unit normals on the visible side and numbers of the faces.
    """
    out = np.empty((len(view[1]), 3, 2))
    in_bands(_unshaded_corners, len(out), lamp, view, surface, out, least=_LEAST_POINTS)
    return out


def lamp_shares(
    lamp: NDArray[np.float64],
    tree: SurfaceTree,
    depths: NDArray[np.float64],
    view: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]],
    starts: tuple[NDArray[np.float64], NDArray[np.float64]],
    surface: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Compute the shares of the light of a lamp that surfaces in front of it let through.

    ``tree``, ``depths``: All surfaces, and the optical depth of each face, shape (m,).
    ``starts``: Origins of the lines to the lamp, shape (n, 3), and the distance by which each may move, shape (n,).
    ``lamp``, ``view``, ``surface``: As for `unshaded_light`.
    Returns: Shares of factor and gloss, and their weights (light without shadows), shape (n, 4); and the state,
    `VISIBLE` or `CERTAIN` where nothing shades the point, else 0, uint8, shape (n,).
    """
    shares, state = np.empty((len(view[1]), 4)), np.zeros(len(view[1]), dtype=np.uint8)
    in_bands(_lamp_shares, len(state), lamp, (tree, depths, *starts), view, surface, shares, state, least=_LEAST_POINTS)
    return shares, state


@subkernel()
def _face_lamp(lamp: NDArray[np.float64], point: NDArray[np.float64], place: NDArray[np.float64]) -> Any:
    """Fill in the flat lamp that a point sees: the lamp, or the disc within the outline of a sphere.

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


@subkernel()
def _set_lines(
    place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], normal: NDArray[np.float64],
    values: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Fill in heights and the number of parts of a line.

    Returns the number of lines, and the part of the lamp above the tangent plane: 1 all, -1 none, 0 some.
    """
    height, across, down, far, axial = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        step = place[CENTRE + k] - point[k]
        height += normal[k] * step
        across += normal[k] * place[3 + k]
        down += normal[k] * place[6 + k]
        far += step * step
        axial -= step * place[AXIS + k]
    place[_HEIGHT], place[_RISE], place[_RISE + 1] = height, across, down
    if polar:
        radius = place[13]
        reach = radius * np.sqrt(across * across + down * down)
        length = place[13] - place[12]
    else:
        radius = np.sqrt(place[12] ** 2 + place[13] ** 2)
        reach, length = abs(across) * place[12] + abs(down) * place[13], 2.0 * place[12]
    side = 1 if height >= reach else (-1 if height <= -reach else 0)
    distance = np.sqrt(far)
    off_axis = np.sqrt(max(far - axial * axial, 0.0))
    # Poles of the light around the lamp: where the distance vanishes, and of the microfacets.
    turn = (far + radius * radius) / (2.0 * max(off_axis * radius, 1e-300))
    parts = 2.0 * length / max(axial, 1e-3 * radius)
    if values[0] > 1.0 or values[3] > 0.0:
        rough = min(values[1], values[2])
        turn = min(turn, 1.0 + 2.0 * (rough * distance / radius) ** 2)
        parts = max(parts, length / (rough * distance))
    pace = np.log(turn + np.sqrt(max(turn * turn - 1.0, 0.0)))
    lines = int(min(max(np.ceil(_QUADRATURE / max(pace, 1e-3)), _FEWEST), _MOST))
    place[_PARTS] = min(parts, _MOST_PARTS)
    return lines, side


@subkernel()
def _closed_form(
    place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], normal: NDArray[np.float64]
) -> Any:
    """Return the irradiance by a lamp that is entirely above the tangent plane; negative if it is below."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        step = point[k] - place[CENTRE + k]
        x += step * place[3 + k]
        y += step * place[6 + k]
        z += step * place[AXIS + k]
    nx = normal[0] * place[3] + normal[1] * place[4] + normal[2] * place[5]
    ny = normal[0] * place[6] + normal[1] * place[7] + normal[2] * place[8]
    nz = normal[0] * place[9] + normal[1] * place[10] + normal[2] * place[11]
    if polar:
        off_axis = np.sqrt(x * x + y * y)
        along = -(nx * x + ny * y) / off_axis if off_axis > 0.0 else 0.0
        square = off_axis * off_axis + z * z
        total = 0.0
        for sign in range(2):
            radius = place[SIZES + 1 - sign]
            root = np.sqrt((square + radius * radius) ** 2 - 4.0 * off_axis * off_axis * radius * radius)
            # 1 - (s - R²) / root, and (s + R²) / root - 1, without loss of digits for small lamps.
            facing = 4.0 * radius * radius * z * z / (root * (root + square - radius * radius))
            across = 4.0 * off_axis * radius * radius / (root * (root + square + radius * radius)) * z
            part = 0.5 * (across * along - facing * nz)
            total += part if sign == 0 else -part
        return np.pi * place[RADIANCE] * total
    # The polygon formula of Lambert.
    total = 0.0
    for c in range(4):
        ax = place[12] * (1.0 if c == 0 or c == 3 else -1.0) - x
        ay = place[13] * (1.0 if c < 2 else -1.0) - y
        bx = place[12] * (1.0 if c == 3 or c == 2 else -1.0) - x
        by = place[13] * (1.0 if c == 0 or c == 3 else -1.0) - y
        cx, cy, cz = ay * -z + z * by, -z * bx + ax * z, ax * by - ay * bx
        length = np.sqrt(cx * cx + cy * cy + cz * cz)
        angle = np.arctan2(length, ax * bx + ay * by + z * z)
        total += angle * (nx * cx + ny * cy + nz * cz) / length
    return -0.5 * place[RADIANCE] * total


@subkernel()
def _along_line(
    s: float, place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], shades: tuple[Any, ...],
    optics: tuple[Any, ...],
) -> Any:  # fmt: skip
    """Return visible share of a line across the lamp, factor and gloss, and both without shadows; per s from 0 to 1."""
    edges, count, marks, pieces = shades
    frame, eye, leaving, values, tables = optics
    inner, outer = place[12], place[13]
    if polar:
        right, below = np.cos(2.0 * np.pi * s), np.sin(2.0 * np.pi * s)
        x0, y0, x1, y1 = inner * right, inner * below, outer * right, outer * below
    else:
        y0 = y1 = outer * (2.0 * s - 1.0)
        x0, x1 = -inner, inner
    kept = 0
    seen = 1.0
    if count > 0:
        kept = line_pieces((x0, y0, x1, y1), place[_DEPTH], place[_BEGIN], edges, count, marks, pieces)
        seen = 0.0
        for item in range(kept):
            begin, end = pieces[item, 0], pieces[item, 1]
            if polar:
                one, other = inner + begin * (outer - inner), inner + end * (outer - inner)
                seen += pieces[item, 2] * (other * other - one * one) / (outer * outer - inner * inner)
            else:
                seen += pieces[item, 2] * (end - begin)
    first = place[_HEIGHT] + x0 * place[_RISE] + y0 * place[_RISE + 1]
    last = place[_HEIGHT] + x1 * place[_RISE] + y1 * place[_RISE + 1]
    crossing = first / (first - last) if (first > 0.0) != (last > 0.0) else 2.0
    matt = values[0] <= 1.0 and values[3] == 0.0
    # From the point to the begin of the line, and along it.
    fx = place[0] + x0 * place[3] + y0 * place[6] - point[0]
    fy = place[1] + x0 * place[4] + y0 * place[7] - point[1]
    fz = place[2] + x0 * place[5] + y0 * place[8] - point[2]
    sx = (x1 - x0) * place[3] + (y1 - y0) * place[6]
    sy = (x1 - x0) * place[4] + (y1 - y0) * place[7]
    sz = (x1 - x0) * place[5] + (y1 - y0) * place[8]
    factor, gloss, all_factor, all_gloss = 0.0, 0.0, 0.0, 0.0
    at, number, parts = 0.0, 1, max(np.ceil(place[_PARTS]), 1.0)
    nodes = 3
    if count == 0 and place[_PARTS] < _LITTLE and crossing > 1.0:
        nodes = 2
    while at < 1.0:
        # The next part, which ends at the tangent plane at the latest.
        after = min(number / parts, 1.0)
        if at < crossing < after:
            after = crossing
        else:
            number += 1
        width, middle = after - at, 0.5 * (at + after)
        low, centre, high = 0.0, 1.0, 0.0
        if count > 0:
            # Integrals of the parabolas of the three nodes over the visible pieces.
            low, centre, high = 0.0, 0.0, 0.0
            for item in range(kept):
                begin, end = max(pieces[item, 0], at), min(pieces[item, 1], after)
                if begin >= end:
                    continue
                t0, t1 = (begin - middle) / width, (end - middle) / width
                cubes, squares = (t1**3 - t0**3) / 3.0, 0.5 * _SIDE * (t1 * t1 - t0 * t0)
                scale = pieces[item, 2] / (2.0 * _SIDE * _SIDE)
                low += scale * (cubes - squares)
                high += scale * (cubes + squares)
                centre += pieces[item, 2] * (t1 - t0) - 2.0 * scale * cubes
        for node in range(-1, 2):
            if nodes == 2 and node == 0:
                continue
            u = middle + width * node * (PAIR if nodes == 2 else _SIDE)
            area = 4.0 * inner * outer
            if polar:
                area = 2.0 * np.pi * (inner + u * (outer - inner)) * (outer - inner)
            dx, dy, dz = fx + u * sx, fy + u * sy, fz + u * sz
            square = dx * dx + dy * dy + dz * dz
            far = np.sqrt(square)
            incident = place[RADIANCE] * width * area * -(dx * place[9] + dy * place[10] + dz * place[11])
            if matt:
                rise = first + u * (last - first)
                one, other = incident / (square * square) * (rise * values[9] if rise > 0.0 else -rise * values[4]), 0.0
            else:
                light = in_frame(frame, dx / far, dy / far, dz / far)
                one, other = reflect_ray(incident / (square * far), light, eye, leaving, values, tables)
            weight = 1.0 / nodes if nodes < 3 else (4.0 if node == 0 else 2.5) / 9.0
            share = weight
            if count > 0:
                share = centre if node == 0 else (low if node < 0 else high)
            factor, gloss = factor + share * one, gloss + share * other
            all_factor, all_gloss = all_factor + weight * one, all_gloss + weight * other
        at = after
    return seen, factor, gloss, all_factor, all_gloss


@subkernel()
def _unshaded_at(
    place: NDArray[np.float64], polar: bool, lines: int, side: int, point: NDArray[np.float64],
    normal: NDArray[np.float64], optics: tuple[Any, ...], none: tuple[Any, ...],
) -> Any:  # fmt: skip
    """Return factor and gloss at a point, with what `_set_lines` has set."""
    values = optics[3]
    if side < 0 and values[4] == 0.0:
        return 0.0, 0.0
    if values[0] <= 1.0 and values[3] == 0.0 and side != 0:
        light = _closed_form(place, polar, point, normal)
        return (light * values[9] if side > 0 else -light * values[4]), 0.0
    if side == 0:
        lines = max(lines, 6 * _FEWEST_SHADED)
    factor, gloss = 0.0, 0.0
    if polar:
        for number in range(lines):
            line = _along_line(number / lines, place, polar, point, none, optics)
            factor, gloss = factor + line[3] / lines, gloss + line[4] / lines
        return factor, gloss
    # Three Gauss points between two of the lines.
    for number in range(max(lines // 2, 1)):
        for node in range(-1, 2):
            s = (number + 0.5 + node * _SIDE) / max(lines // 2, 1)
            line = _along_line(s, place, polar, point, none, optics)
            weight = (4.0 if node == 0 else 2.5) / 9.0 / max(lines // 2, 1)
            factor, gloss = factor + weight * line[3], gloss + weight * line[4]
    return factor, gloss


@subkernel()
def _coarse_light(place: NDArray[np.float64], point: NDArray[np.float64], optics: tuple[Any, ...]) -> Any:
    """Return factor and gloss by three points of a round lamp, which suffice for differences between near points."""
    frame, eye, leaving, values, tables = optics
    inner, outer = place[SIZES], place[SIZES + 1]
    middle = 0.5 * (inner + outer)
    area = 2.0 * np.pi * middle * (outer - inner) * place[RADIANCE] / 3.0
    factor, gloss = 0.0, 0.0
    for number in range(3):
        x = middle * (1.0 if number == 0 else -0.5)
        y = middle * (0.0 if number == 0 else (_SINE if number == 1 else -_SINE))
        dx = place[CENTRE] + x * place[3] + y * place[6] - point[0]
        dy = place[CENTRE + 1] + x * place[4] + y * place[7] - point[1]
        dz = place[CENTRE + 2] + x * place[5] + y * place[8] - point[2]
        square = dx * dx + dy * dy + dz * dz
        far = np.sqrt(square)
        incident = -area * (dx * place[AXIS] + dy * place[AXIS + 1] + dz * place[AXIS + 2])
        light = in_frame(frame, dx / far, dy / far, dz / far)
        one, other = reflect_ray(incident / (square * far), light, eye, leaving, values, tables)
        factor, gloss = factor + one, gloss + other
    return factor, gloss


@kernel()
def _unshaded_light(
    low: int, high: int, lamp: NDArray[np.float64], view: tuple[NDArray[Any], ...], surface: tuple[NDArray[Any], ...],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    origin, points, normals, faces = view
    tangents, materials, values, tables = surface
    place, polar = np.empty(_PLACES), lamp[0] != RECTANGLE
    none = (np.empty((0, 5)), 0, np.empty((0, 2)), np.empty((0, 3)))
    for n in range(low, high):
        out[n, 0], out[n, 1] = 0.0, 0.0
        m = materials[faces[n]]
        if _face_lamp(lamp, points[n], place):
            lines, side = _set_lines(place, polar, points[n], normals[n], values[m])
            if values[m, 0] <= 1.0 and values[m, 3] == 0.0 and side != 0:
                light = _closed_form(place, polar, points[n], normals[n])
                out[n, 0] = light * values[m, 9] if side > 0 else -light * values[m, 4]
                continue
            frame = frame_of(normals[n], tangents[faces[n]])
            eye = towards(frame, origin, points[n])
            optics = (frame, eye, entering(tables[m], eye), values[m], tables[m])
            out[n, 0], out[n, 1] = _unshaded_at(place, polar, lines, side, points[n], normals[n], optics, none)


@kernel()
def _unshaded_corners(
    low: int, high: int, lamp: NDArray[np.float64], view: tuple[NDArray[Any], ...], surface: tuple[NDArray[Any], ...],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    origin, corners, normals, faces = view
    tangents, materials, values, tables = surface
    place, polar = np.empty(_PLACES), lamp[0] != RECTANGLE
    none = (np.empty((0, 5)), 0, np.empty((0, 2)), np.empty((0, 3)))
    for n in range(low, high):
        m, normal = materials[faces[n]], normals[n]
        frame = frame_of(normal, tangents[faces[n]])
        coarse, factor, gloss = False, 0.0, 0.0
        for c in range(3):
            point = corners[n, c]
            out[n, c, 0], out[n, c, 1] = 0.0, 0.0
            if not _face_lamp(lamp, point, place):
                coarse = False
                continue
            if values[m, 0] <= 1.0 and values[m, 3] == 0.0:
                lines, side = _set_lines(place, polar, point, normal, values[m])
                if side != 0:
                    light = _closed_form(place, polar, point, normal)
                    out[n, c, 0] = light * values[m, 9] if side > 0 else -light * values[m, 4]
                    continue
            eye = towards(frame, origin, point)
            optics = (frame, eye, entering(tables[m], eye), values[m], tables[m])
            if coarse:
                some, shine = _coarse_light(place, point, optics)
                out[n, c, 0], out[n, c, 1] = factor + some, gloss + shine
                continue
            lines, side = _set_lines(place, polar, point, normal, values[m])
            one, other = _unshaded_at(place, polar, lines, side, point, normal, optics, none)
            if c == 0:
                # Differences between the corners follow from few points, if the light of the lamp is even.
                broad = polar and lines == _FEWEST and place[_PARTS] < _LITTLE
                coarse = broad and side > 0 and (values[m, 0] > 1.0 or values[m, 3] > 0.0)
                if coarse:
                    some, shine = _coarse_light(place, point, optics)
                    factor, gloss = one - some, other - shine
            out[n, c, 0], out[n, c, 1] = one, other


@kernel()
def _lamp_shares(
    low: int, high: int, lamp: NDArray[np.float64], bundle: tuple[Any, ...], view: tuple[NDArray[Any], ...],
    surface: tuple[NDArray[Any], ...], shares: NDArray[np.float64], state: NDArray[np.uint8],
) -> None:  # fmt: skip
    tree, depths, starts, near = bundle
    origin, points, normals, faces = view
    tangents, materials, values, tables = surface
    place, polar = np.empty(_PLACES), lamp[0] != RECTANGLE
    sides = np.zeros(tree.corners.shape[0], dtype=np.int8)
    found, outline = np.empty(_FIRST_FOUND, dtype=np.int32), np.empty((5, 2))
    edges, marks = np.empty((5 * _FIRST_FOUND, 5)), np.empty((5 * _FIRST_FOUND, 2))
    pieces, borders = np.empty((5 * _FIRST_FOUND + 1, 3)), np.empty(5 * _FIRST_FOUND)
    stack, fit = np.empty((_LEVELS + 2, 13)), np.empty((2, 2, 5))
    for n in range(low, high):
        m, face = materials[faces[n]], faces[n]
        for k in range(4):
            shares[n, k] = 1.0
        state[n] = VISIBLE
        if not _face_lamp(lamp, points[n], place):
            state[n] = CERTAIN if near[n] == 0.0 else VISIBLE
            continue
        lines, side = _set_lines(place, polar, points[n], normals[n], values[m])
        if side < 0 and values[m, 4] == 0.0:
            continue
        radius = place[13] if polar else np.sqrt(place[12] ** 2 + place[13] ** 2)
        start = (points[n, 0], points[n, 1], points[n, 2])
        if place[_HEIGHT] > 0.0:
            start = (starts[n, 0], starts[n, 1], starts[n, 2])
        centre = (place[0], place[1], place[2])
        count = find_between(tree, start, 0.0, centre, radius, face, found)
        if count > found.shape[0]:
            found = np.empty(2 * count, dtype=np.int32)
            count = find_between(tree, start, 0.0, centre, radius, face, found)
        if 5 * count > edges.shape[0]:
            edges, marks = np.empty((10 * count, 5)), np.empty((10 * count, 2))
            pieces, borders = np.empty((10 * count + 1, 3)), np.empty(10 * count)
        used, kept, whole = outline_edges(tree, found, count, start, place, polar, depths, sides, outline, edges)
        place[_DEPTH], place[_BEGIN], depth = 0.0, -np.inf, 0.0
        if polar:
            used, depth = trim_edges(edges, used, radius)
            place[_DEPTH] = depth
            place[_BEGIN] = -place[SIZES] / (place[SIZES + 1] - place[SIZES])
        else:
            meets, depth = rectangle_depth(edges, used, place[SIZES], place[SIZES + 1])
            used = used if meets else 0
        if used == 0 and abs(depth) < _CLEAR:
            state[n] = CERTAIN
            if near[n] > 0.0:
                # Most of the points that are not surely lit are close to what is in front of the lamp.
                if not surely_lit(tree, found, kept, start, near[n], tree.bodies[face], place, polar):
                    state[n] = VISIBLE
                    continue
                count = find_between(tree, start, near[n], centre, radius, face, found)
                if count > found.shape[0]:
                    found = np.empty(2 * count, dtype=np.int32)
                    count = find_between(tree, start, near[n], centre, radius, face, found)
                if not surely_lit(tree, found, count, start, near[n], tree.bodies[face], place, polar):
                    state[n] = VISIBLE
            continue
        state[n] = 0
        if used == 0:
            # Equally shaded: the weights are upper limits.
            share = np.exp(-max(depth, 0.0)) if depth < 0.5 * OPAQUE else 0.0
            shares[n, 0] = shares[n, 1] = share
            continue
        frame = frame_of(normals[n], tangents[face])
        eye = towards(frame, origin, points[n])
        optics = (frame, eye, entering(tables[m], eye), values[m], tables[m])
        shades = (edges, used, marks, pieces)
        even = polar and side != 0 and lines <= _FEWEST and place[_PARTS] < _LITTLE
        followed = False
        factor, gloss, all_factor, all_gloss = 0.0, 0.0, 0.0, 0.0
        if even:
            fit_light(place, points[n], optics, fit)
            if whole:
                factor, gloss, all_factor, all_gloss, followed = visible_light(place, edges, used, depth, fit, marks)
        if not followed:
            _, factor, gloss, all_factor, all_gloss = _integrate(
                place, polar, points[n], max(lines, _FEWEST_SHADED), even, shades, optics, (stack, borders, fit)
            )
        shares[n, 0] = min(max(factor / all_factor, 0.0), 1.0) if all_factor > 0.0 else 1.0
        shares[n, 1] = min(max(gloss / all_gloss, 0.0), 1.0) if all_gloss > 0.0 else 1.0
        shares[n, 2], shares[n, 3] = all_factor, all_gloss


@subkernel()
def _add_border(
    place: NDArray[np.float64], polar: bool, x: float, y: float, borders: NDArray[np.float64], used: int
) -> Any:
    """Insert the line through a point of the lamp into the borders of intervals, and return their number."""
    at = (np.arctan2(y, x) / (2.0 * np.pi)) % 1.0 if polar else 0.5 * (y / place[SIZES + 1] + 1.0)
    if at <= 0.0 or at >= 1.0 or used == borders.shape[0]:
        return used
    number = used
    while borders[number - 1] > at:
        borders[number] = borders[number - 1]
        number -= 1
    borders[number] = at
    return used + 1


@subkernel()
def _line_borders(
    place: NDArray[np.float64], polar: bool, lines: int, edges: NDArray[np.float64], count: int,
    borders: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Fill in the borders of intervals of lines, ascending: at equal steps, and through bends of the visible part.

    These are where edges enter or leave the lamp, and, of long edges, ends and crossings.
    """
    for number in range(lines + 1):
        borders[number] = number / lines
    used = lines + 1
    for item in range(count):
        x, y = edges[item, 0], edges[item, 1]
        dx, dy = edges[item, 2] - x, edges[item, 3] - y
        square, along = dx * dx + dy * dy, x * dx + y * dy
        for ring in range(2):
            root, middle = 0.0, 0.0
            if polar:
                rest = along * along - square * (x * x + y * y - place[SIZES + ring] ** 2)
                if rest <= 0.0 or place[SIZES + ring] == 0.0 or square == 0.0:
                    continue
                root, middle = np.sqrt(rest) / square, -along / square
            elif dx != 0.0:
                middle = ((place[SIZES] if ring == 0 else -place[SIZES]) - x) / dx
            else:
                continue
            for sign in range(-1, 2, 2):
                share = middle + sign * root
                if share >= 0.0 and share < 1.0 and (sign < 0 or polar):
                    used = _add_border(place, polar, x + share * dx, y + share * dy, borders, used)
        # Corners of outlines; those of short edges bend less.
        if square > (_LONG * place[SIZES + 1]) ** 2:
            far, inner = x * x + y * y, place[SIZES]
            if (inner * inner < far < place[SIZES + 1] ** 2) if polar else (abs(x) < inner):
                used = _add_border(place, polar, x, y, borders, used)
            # Where edges of several surfaces cross.
            for other in range(item):
                side, share = cross_edge(x, y, dx, dy, square, edges, other)
                if side == 0.0 or share <= 0.0 or share >= 1.0:
                    continue
                u, v = x + share * dx, y + share * dy
                far = u * u + v * v
                if (inner * inner < far < place[SIZES + 1] ** 2) if polar else (abs(u) < inner):
                    used = _add_border(place, polar, u, v, borders, used)
    return used


@subkernel()
def _on_line(
    s: float, place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], shades: tuple[Any, ...],
    optics: tuple[Any, ...], fit: NDArray[np.float64], even: bool,
) -> Any:  # fmt: skip
    """Return the values of `_along_line`, for even light by `along_fitted`."""
    if even:
        return along_fitted(s, place, place[_DEPTH], place[_BEGIN], shades, fit)
    return _along_line(s, place, polar, point, shades, optics)


@subkernel()
def _integrate(
    place: NDArray[np.float64], polar: bool, point: NDArray[np.float64], lines: int, even: bool,
    shades: tuple[Any, ...], optics: tuple[Any, ...], buffers: tuple[NDArray[Any], ...],
) -> Any:  # fmt: skip
    """Integrate a lamp by Simpson's rule over lines, halved where visibility bends; see `_along_line`.

    ``even``: Whether the light is fitted, see `fit_light`.
    """
    stack, borders, fit = buffers
    seen, factor, gloss, all_factor, all_gloss = 0.0, 0.0, 0.0, 0.0, 0.0
    edges, count, _, _ = shades
    used = _line_borders(place, polar, lines, edges, count, borders)
    first = _on_line(0.0, place, polar, point, shades, optics, fit, even)
    before = first
    for number in range(1, used):
        low, high = borders[number - 1], borders[number]
        if high - low < _NARROWEST:
            continue
        after = first
        if number + 1 < used or not polar:
            after = _on_line(high, place, polar, point, shades, optics, fit, even)
        stack[0, 0], stack[0, 1], stack[0, 2] = low, high - low, 0.0
        for k in range(5):
            stack[0, 3 + k], stack[0, 8 + k] = before[k], after[k]
        waiting = 1
        while waiting:
            waiting -= 1
            s, width, level = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
            bend = 0.5 * (stack[waiting, 3] + stack[waiting, 8])
            middle = _on_line(s + 0.5 * width, place, polar, point, shades, optics, fit, even)
            if level >= _LEVELS or abs(middle[0] - bend) * width <= _TOLERANCE:
                share = width / 6.0
                seen += share * (stack[waiting, 3] + 4.0 * middle[0] + stack[waiting, 8])
                factor += share * (stack[waiting, 4] + 4.0 * middle[1] + stack[waiting, 9])
                gloss += share * (stack[waiting, 5] + 4.0 * middle[2] + stack[waiting, 10])
                all_factor += share * (stack[waiting, 6] + 4.0 * middle[3] + stack[waiting, 11])
                all_gloss += share * (stack[waiting, 7] + 4.0 * middle[4] + stack[waiting, 12])
                continue
            stack[waiting + 1, 0], stack[waiting + 1, 1] = s + 0.5 * width, 0.5 * width
            stack[waiting, 1], stack[waiting, 2], stack[waiting + 1, 2] = 0.5 * width, level + 1.0, level + 1.0
            for k in range(5):
                stack[waiting + 1, 8 + k], stack[waiting + 1, 3 + k] = stack[waiting, 8 + k], middle[k]
                stack[waiting, 8 + k] = middle[k]
            waiting += 2
        before = after
    return seen, factor, gloss, all_factor, all_gloss
