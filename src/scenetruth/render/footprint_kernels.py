"""Kernel that averages texture and light over pixel footprints on one surface."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast import ImageRays, TexturedMesh
from scenetruth.raycast.hit_kernels import MOST_STEPS, ways_out
from scenetruth.raycast.ray_triangle_kernels import (
    DISTANCE,
    FORMS,
    edge_functions,
    rounding,
    write_forms,
)
from scenetruth.scene.texture.texture_kernels import linear_at, spline_at
from scenetruth.threads import in_bands

__all__ = [
    "Footprints", "LampLight", "Raster", "add_samples", "average_footprints", "order_samples", "sample_hits",
    "sample_raster", "sort_by_body",
]  # fmt: skip

_LEAST, _LEAST_POINTS = 128, 8192  # minimum number of pixels and of points per thread


class Footprints(NamedTuple):
    """Pixels with the samples in each."""

    pixels: NDArray[np.int64]
    """Pixel indices, shape (n,); each must have a hit."""
    firsts: NDArray[np.int64]
    """Index of the first sample of each pixel in ``offsets``, shape (n,)."""
    counts: NDArray[np.int64]
    """Number of samples of each pixel, shape (n,)."""
    offsets: NDArray[np.float64]
    """Offsets (x, y) from the pixel centre in px, shape (k, 2)."""
    weights: NDArray[np.float64]
    """Weights of the samples, shape (k,)."""
    meeting: NDArray[np.bool_]
    """Faces that intersect other faces, shape (m,); no entries if they are not determined."""


class Raster(NamedTuple):
    """Texture that is interpolated: bilinearly, or as a cubic B-spline."""

    values: NDArray[np.float32]
    """Values or coefficients, shape (h, w)."""
    cubic: bool
    """Whether ``values`` are coefficients of a spline, which repeats."""
    tiled: bool
    """Whether bilinear values repeat."""
    gain: float
    """Factor of the interpolated values."""
    mean: float
    """Sum added to them."""


class LampLight(NamedTuple):
    """Light on flat faces."""

    by_lamp: NDArray[np.float64]
    """Irradiance of each face by each lamp, see `FaceLight`; no rows without light."""
    blocked: NDArray[np.uint64]
    """Bits of the blocked lamps of each pixel, for faces where the light is negative, shape (n,)."""
    ambient: float
    """Irradiance by ambient light."""


@inlined
def _spline_at(flat: NDArray[np.float32], rows: int, columns: int, u: float, v: float) -> Any:
    """Return 36 times the value of a spline, from its coefficients in row-major order; see `spline_lookup`."""
    return spline_at(flat, rows, columns, u * columns - 0.5, v * rows - 0.5)


def sample_raster(raster: Raster, uv: NDArray[np.float64], where: NDArray[np.int64], out: NDArray[np.float32]) -> None:
    """Write the radiance at the texture coordinates, shape (n, 2), with the given indices."""
    in_bands(_sample_raster, where.shape[0], raster, uv, where, out, least=_LEAST_POINTS)


@kernel()
def _sample_raster(
    low: int, high: int, raster: Raster, uv: NDArray[np.float64], where: NDArray[np.int64], out: NDArray[np.float32]
) -> None:  # fmt: skip
    values, flat, cubic, tiled = raster.values, raster.values.ravel(), raster.cubic, raster.tiled
    rows, columns = values.shape
    gain, mean = raster.gain / (36.0 if cubic else 1.0), raster.mean
    for n in range(np.uint64(low), np.uint64(high)):
        point = where[n]
        u, v = uv[point, 0], uv[point, 1]
        if cubic:
            out[point] = gain * np.float64(_spline_at(flat, rows, columns, u, v)) + mean
        else:
            out[point] = gain * np.float64(linear_at(values, u, v, tiled)) + mean


def order_samples(
    order: NDArray[np.int64], pixels: NDArray[np.int64], starts: NDArray[np.int64], counts: NDArray[np.int64],
    offsets: NDArray[np.float64], weights: NDArray[np.float64], cells: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:  # fmt: skip
    """Return pixel, offset, weight and cell of the samples of pixels in an order.

    ``pixels``, ``starts``, ``counts``: Pixels, and the first and the number of the samples of each, shape (n,).
    """
    numbers = counts[order]
    owner, moves = np.repeat(pixels[order], numbers), starts[order] - (np.cumsum(numbers) - numbers)
    if not moves.any():
        return owner, offsets, weights, cells
    sample = np.repeat(moves, numbers) + np.arange(len(weights))
    return owner, offsets.take(sample, axis=0), weights.take(sample), cells.take(sample)


def add_samples(
    counts: NDArray[np.int64], radiance: NDArray[np.float32], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the means over pixels, each of a number of samples in turn."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return np.asarray(np.bincount(owner, radiance * weights, len(counts)), dtype=np.float64)


def sort_by_body(
    face: NDArray[np.int32], face_body: NDArray[np.int32], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of hits on the first body, then on the second, and so on, and the first place of each body.

    ``face``: Face of each hit, -1 for none. ``count``: Number of bodies.
    """
    hits = np.flatnonzero(face >= 0)
    if count > 1:
        body = face_body.take(face.take(hits))
        # Small integers are sorted by their digits.
        body = body.astype(np.uint8) if count < 256 else body
        hits = hits.take(np.argsort(body, kind="stable"))
        numbers = np.bincount(body, minlength=count)
    else:
        numbers = np.array([len(hits)])
    return hits, np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(numbers)])


def sample_hits(
    raster: Raster, uv: NDArray[np.float64], face: NDArray[np.int32], weights: NDArray[np.float64],
    where: NDArray[np.int64], out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write the radiance at the hits with the given indices.

    ``uv``: Texture coordinates at the face corners, shape (m, 3, 2). ``face``, ``weights``: As in `Hits`.
    """
    in_bands(_sample_hits, where.shape[0], raster, uv, face, weights, where, out, least=_LEAST_POINTS)


@kernel()
def _sample_hits(
    low: int, high: int, raster: Raster, uv: NDArray[np.float64], face: NDArray[np.int32],
    weights: NDArray[np.float64], where: NDArray[np.int64], out: NDArray[np.float32],
) -> None:  # fmt: skip
    values, flat, cubic, tiled = raster.values, raster.values.ravel(), raster.cubic, raster.tiled
    rows, columns = values.shape
    gain, mean = raster.gain / (36.0 if cubic else 1.0), raster.mean
    for n in range(np.uint64(low), np.uint64(high)):
        point = np.uint64(where[n])
        met, b1, b2 = np.uint64(face[point]), weights[point, 0], weights[point, 1]
        # As `Hits.interpolate` mixes corners.
        u0, v0 = uv[met, 0, 0], uv[met, 0, 1]
        u = u0 + b1 * (uv[met, 1, 0] - u0) + b2 * (uv[met, 2, 0] - u0)
        v = v0 + b1 * (uv[met, 1, 1] - v0) + b2 * (uv[met, 2, 1] - v0)
        if cubic:
            out[point] = gain * np.float64(_spline_at(flat, rows, columns, u, v)) + mean
        else:
            out[point] = gain * np.float64(linear_at(values, u, v, tiled)) + mean


def average_footprints(
    mesh: TexturedMesh, rays: ImageRays, footprints: Footprints, raster: Raster, light: LampLight
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Average the radiance over pixels, whose samples are reached by walks as in `walk_footprints`.

    Next to pixels of other bodies, walks end at faces that intersect others.

    Returns: Whether the walk reached all samples, and the means, shape (n,) each.
    """
    count = footprints.pixels.shape[0]
    arrived, means = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.float32)
    regular = _are_regular(rays)
    in_bands(_average_footprints, count, mesh, rays, regular, footprints, raster, light, arrived, means, least=_LEAST)
    return arrived, means


# Entries of a face in the table: three edge functions, and the numerators of u and v, each with the coefficients of 1
# and of the position to the right and down; the bound of the rounding errors of the edge functions; the side.
_EDGES, _U, _V, _BLUR, _SIDE, _ENTRIES = 0, 9, 12, 15, 16, 17
_KNOWN = 1 << 13  # number of faces in the table: those of a few rows of pixels
# Edge functions as linear functions of the position have more roundings than those of a ray.
_ROUNDINGS = 4.0
_GRID = 1e-12  # deviation of directions from a grid, relative to their length


@inlined
def _write_lines(
    form: NDArray[np.float64], rays: ImageRays, base: int, reach: tuple[float, float], uv: NDArray[np.float64],
    face: int, table: NDArray[np.float64], row: int,
) -> None:  # fmt: skip
    """Write edge functions and texture coordinates of a face as linear functions of the position in the image.

    The sum of the edge functions is the denominator of the texture coordinates; inside the face they are positive.

    ``base``: Pixel in which positions begin. ``reach``: Largest position to the right and down.
    """
    apart = 1 if rays.across.shape[0] > 1 else 0
    side = 1.0 if form[DISTANCE] > 0.0 else -1.0
    reach_x = reach_y = reach_z = 0.0
    for column in range(3):
        if column == 0:
            x, y, z, far = rays.directions[base, 0], rays.directions[base, 1], rays.directions[base, 2], 1.0
        elif column == 1:
            x, y, z = rays.across[base * apart, 0], rays.across[base * apart, 1], rays.across[base * apart, 2]
            far = reach[0]
        else:
            x, y, z = rays.down[base * apart, 0], rays.down[base * apart, 1], rays.down[base * apart, 2]
            far = reach[1]
        reach_x, reach_y, reach_z = reach_x + far * abs(x), reach_y + far * abs(y), reach_z + far * abs(z)
        w0, w1, w2 = edge_functions(form, x, y, z)
        w0, w1, w2 = side * w0, side * w1, side * w2
        total = w0 + w1 + w2
        table[row, column], table[row, 3 + column], table[row, 6 + column] = w0, w1, w2
        u0, v0 = uv[face, 0, 0], uv[face, 0, 1]
        table[row, _U + column] = u0 * total + w1 * (uv[face, 1, 0] - u0) + w2 * (uv[face, 2, 0] - u0)
        table[row, _V + column] = v0 * total + w1 * (uv[face, 1, 1] - v0) + w2 * (uv[face, 2, 1] - v0)
    table[row, _BLUR] = _ROUNDINGS * rounding(form, reach_x, reach_y, reach_z)
    # A face that is seen edge-on has no side.
    table[row, _SIDE] = side if form[DISTANCE] != 0.0 else 0.0


@inlined
def _at(table: NDArray[np.float64], row: int, first: int, right: float, below: float) -> Any:
    """Return a linear function at a position."""
    return table[row, first] + (right * table[row, first + 1] + below * table[row, first + 2])


def _are_regular(rays: ImageRays) -> bool:
    """Return whether the directions are linear in the position in the image."""
    if len(rays.across) > 1 or len(rays.down) > 1:
        return False
    ends = rays.directions[[0, rays.width - 1, -rays.width, -1]]
    right, below = rays.across[0] * (rays.width - 1), rays.down[0] * (len(rays.directions) // rays.width - 1)
    apart = ends - ends[0] - np.stack([np.zeros(3), right, below, right + below])
    return bool(np.abs(apart).max() <= _GRID * np.abs(ends).max())


@inlined
def _light_on(light: LampLight, face: int, number: int) -> Any:
    """Return the irradiance of a face in a pixel."""
    factor = light.ambient
    for lamp in range(light.by_lamp.shape[1]):
        part = light.by_lamp[face, lamp]
        if part >= 0.0:
            factor += part
        elif (light.blocked[number] >> np.uint64(lamp)) & np.uint64(1) == np.uint64(0):
            factor -= part
    return factor


@inlined
def _passes_left(rays: ImageRays, pixel: int, place: tuple[float, ...], corner: NDArray[np.float64]) -> Any:
    """Return on which side of a corner the line between two offsets in a pixel passes: positive to its left."""
    apart = 1 if rays.across.shape[0] > 1 else 0
    right, below, from_right, from_below = place
    across, down, centre = rays.across[pixel * apart], rays.down[pixel * apart], rays.directions[pixel]
    px = centre[0] + (from_right * across[0] + from_below * down[0])
    py = centre[1] + (from_right * across[1] + from_below * down[1])
    pz = centre[2] + (from_right * across[2] + from_below * down[2])
    dx = centre[0] + (right * across[0] + below * down[0])
    dy = centre[1] + (right * across[1] + below * down[1])
    dz = centre[2] + (right * across[2] + below * down[2])
    nx, ny, nz = py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx
    return nx * (corner[0] - rays.origin[0]) + ny * (corner[1] - rays.origin[1]) + nz * (corner[2] - rays.origin[2])


@inlined
def _alone(mesh: TexturedMesh, rays: ImageRays, pixel: int, face: int) -> Any:
    """Return whether all pixels around a pixel with a hit on a face show its body."""
    hits, width = rays.face, rays.width
    height = hits.shape[0] // width
    body, row, column = mesh.face_body[face], pixel // width, pixel % width
    for y in range(max(row - 1, 0), min(row + 2, height)):
        for x in range(max(column - 1, 0), min(column + 2, width)):
            other = hits[y * width + x]
            if other != face and (other < 0 or mesh.face_body[other] != body):
                return False
    return True


@kernel()
def _average_footprints(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, regular: bool, footprints: Footprints, raster: Raster,
    light: LampLight, arrived: NDArray[np.bool_], means: NDArray[np.float32],
) -> None:  # fmt: skip
    vertices, faces, neighbours, face_body, uv = mesh.vertices, mesh.faces, mesh.neighbours, mesh.face_body, mesh.uv
    origin, offsets, meeting, width = rays.origin, footprints.offsets, footprints.meeting, rays.width
    values, flat, cubic, tiled = raster.values, raster.values.ravel(), raster.cubic, raster.tiled
    texel_rows, texel_columns = values.shape
    gain, level = raster.gain / (36.0 if cubic else 1.0), raster.mean
    pixels, firsts, counts = footprints.pixels, footprints.firsts, footprints.counts
    lit, known = light.by_lamp.shape[0] > 0, meeting.shape[0] > 0
    form = np.empty(FORMS, dtype=np.float64)
    # Faces with entries in the table, in rows by the last digits of their numbers.
    table, faces_in = np.empty((_KNOWN, _ENTRIES), dtype=np.float64), np.empty(_KNOWN, dtype=np.int64)
    for entry in range(_KNOWN):
        faces_in[entry] = -1
    last = _KNOWN - 1
    reach = (np.float64(width), np.float64(rays.face.shape[0] // width)) if regular else (1.0, 1.0)
    most = 1
    for n in range(low, high):
        most = max(most, counts[n])
    # Texture coordinates and weights of the samples of a pixel.
    us, vs = np.empty(most, dtype=np.float64), np.empty(most, dtype=np.float64)
    shares = np.empty(most, dtype=np.float64)
    for n in range(low, high):
        pixel = pixels[n]
        # Of one type from the first use on: kernels are compiled for every combination of types.
        face = np.int64(rays.face[pixel])
        body = face_body[face]
        # Where intersections are determined, the pixels around matter for few faces.
        alone = _alone(mesh, rays, pixel, face) if not known or meeting[face] else True
        if not alone and not known:
            continue
        asked = not known or meeting[face]
        base, left, top = pixel, 0.0, 0.0
        if regular:
            base, left, top = 0, np.float64(pixel % width), np.float64(pixel // width)
        row = np.uint64(face & last)
        if not regular or faces_in[row] != face:
            write_forms(vertices, faces, face, origin, form)
            _write_lines(form, rays, base, reach, uv, face, table, row)
            faces_in[row] = face
        side = table[row, _SIDE]
        factor = _light_on(light, face, n) if lit else 1.0
        first, count = np.uint64(firsts[n]), np.uint64(counts[n])
        whole = alone
        for edge in range(_EDGES, _U, 3):
            apart = 0.5 * (abs(table[row, edge + 1]) + abs(table[row, edge + 2]))
            whole = whole and _at(table, row, edge, left, top) - apart > table[row, _BLUR]
        if whole:
            d0 = table[row, 0] + table[row, 3] + table[row, 6]
            d1 = table[row, 1] + table[row, 4] + table[row, 7]
            d2 = table[row, 2] + table[row, 5] + table[row, 8]
            for sample in range(count):
                right, below = left + offsets[first + sample, 0], top + offsets[first + sample, 1]
                inverse = 1.0 / (d0 + (right * d1 + below * d2))
                us[sample] = _at(table, row, _U, right, below) * inverse
                vs[sample] = _at(table, row, _V, right, below) * inverse
                shares[sample] = factor * footprints.weights[first + sample]
            arrived[n] = True
        else:
            # Start of the line to the next sample.
            from_right = from_below = 0.0
            for sample in range(count):
                right, below = left + offsets[first + sample, 0], top + offsets[first + sample, 1]
                found = False
                for _step in range(MOST_STEPS):
                    w0, w1 = _at(table, row, 0, right, below), _at(table, row, 3, right, below)
                    w2 = _at(table, row, 6, right, below)
                    ways, edge, corner = ways_out(w0, w1, w2)
                    if ways == 0:
                        found = True
                        break
                    if ways == 3:
                        break
                    if ways == 2:
                        # As in `walk_footprints`, by the side on which the line passes the corner.
                        place = (offsets[first + sample, 0], offsets[first + sample, 1], from_right, from_below)
                        to_left = _passes_left(rays, pixel, place, vertices[faces[face, corner]])
                        edge = (corner + 2) % 3 if side * to_left > 0.0 else corner
                    face = np.int64(neighbours[face, edge])
                    if face < 0 or face_body[face] != body:
                        break
                    row = np.uint64(face & last)
                    if not regular or faces_in[row] != face:
                        write_forms(vertices, faces, face, origin, form)
                        _write_lines(form, rays, base, reach, uv, face, table, row)
                        faces_in[row] = face
                    if table[row, _SIDE] != side:
                        break
                    if lit:
                        factor = _light_on(light, face, n)
                if not found or min(w0, w1, w2) <= table[row, _BLUR]:
                    break
                if known and meeting[face]:
                    if not asked:
                        alone, asked = _alone(mesh, rays, pixel, face), True
                    if not alone:
                        break
                inverse = 1.0 / (w0 + w1 + w2)
                us[sample] = _at(table, row, _U, right, below) * inverse
                vs[sample] = _at(table, row, _V, right, below) * inverse
                shares[sample] = factor * footprints.weights[first + sample]
                from_right, from_below = offsets[first + sample, 0], offsets[first + sample, 1]
                arrived[n] = sample == count - np.uint64(1)
            if not arrived[n]:
                continue
        mean = 0.0
        for sample in range(count):
            if cubic:
                value = np.float64(_spline_at(flat, texel_rows, texel_columns, us[sample], vs[sample]))
            else:
                value = np.float64(linear_at(values, us[sample], vs[sample], tiled))
            mean += shares[sample] * (gain * value + level)
        means[n] = mean
