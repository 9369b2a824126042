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
    slope,
    write_forms,
)
from scenetruth.scene.texture.texture_kernels import cubic_weights, linear_at
from scenetruth.threads import in_bands

__all__ = ["Footprints", "LampLight", "Raster", "average_footprints", "sample_raster"]

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
    x, y = u * columns - 0.5, v * rows - 0.5
    fx, fy = np.floor(x), np.floor(y)
    left, top = int(fx) - 1, int(fy) - 1
    wx0, wx1, wx2, wx3 = cubic_weights(np.float32(x - fx))
    wy0, wy1, wy2, wy3 = cubic_weights(np.float32(y - fy))
    # Column by column, which compilers vectorise.
    if left >= 0 and top >= 0 and left + 3 < columns and top + 3 < rows:
        j0, down = np.uint64(top * columns + left), np.uint64(columns)
        j1, j2 = j0 + down, j0 + down + down
        j3, i1, i2, i3 = j2 + down, np.uint64(1), np.uint64(2), np.uint64(3)
        c0 = wy0 * flat[j0] + wy1 * flat[j1] + wy2 * flat[j2] + wy3 * flat[j3]
        c1 = wy0 * flat[j0 + i1] + wy1 * flat[j1 + i1] + wy2 * flat[j2 + i1] + wy3 * flat[j3 + i1]
        c2 = wy0 * flat[j0 + i2] + wy1 * flat[j1 + i2] + wy2 * flat[j2 + i2] + wy3 * flat[j3 + i2]
        c3 = wy0 * flat[j0 + i3] + wy1 * flat[j1 + i3] + wy2 * flat[j2 + i3] + wy3 * flat[j3 + i3]
    else:
        i0, i1 = np.uint64(left % columns), np.uint64((left + 1) % columns)
        i2, i3 = np.uint64((left + 2) % columns), np.uint64((left + 3) % columns)
        j0, j1 = np.uint64(top % rows * columns), np.uint64((top + 1) % rows * columns)
        j2, j3 = np.uint64((top + 2) % rows * columns), np.uint64((top + 3) % rows * columns)
        c0 = wy0 * flat[j0 + i0] + wy1 * flat[j1 + i0] + wy2 * flat[j2 + i0] + wy3 * flat[j3 + i0]
        c1 = wy0 * flat[j0 + i1] + wy1 * flat[j1 + i1] + wy2 * flat[j2 + i1] + wy3 * flat[j3 + i1]
        c2 = wy0 * flat[j0 + i2] + wy1 * flat[j1 + i2] + wy2 * flat[j2 + i2] + wy3 * flat[j3 + i2]
        c3 = wy0 * flat[j0 + i3] + wy1 * flat[j1 + i3] + wy2 * flat[j2 + i3] + wy3 * flat[j3 + i3]
    return (wx0 * c0 + wx1 * c1) + (wx2 * c2 + wx3 * c3)


def sample_raster(raster: Raster, uv: NDArray[np.float64], where: NDArray[np.int64], out: NDArray[np.float32]) -> None:
    """Write the radiance at the texture coordinates, shape (n, 2), with the given indices."""
    in_bands(_sample_raster, where.shape[0], raster, uv, where, out, least=_LEAST_POINTS)


@kernel(error_model="numpy")
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


def average_footprints(
    mesh: TexturedMesh, rays: ImageRays, footprints: Footprints, raster: Raster, light: LampLight
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Average the radiance over pixels, whose samples are reached by walks as in `walk_footprints`.

    Next to pixels of other bodies, walks end at faces that intersect others.

    Returns: Whether the walk reached all samples, and the means, shape (n,) each.
    """
    count = footprints.pixels.shape[0]
    arrived, means = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.float32)
    in_bands(_average_footprints, count, mesh, rays, footprints, raster, light, arrived, means, least=_LEAST)
    return arrived, means


@kernel(error_model="numpy")
def _average_footprints(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, footprints: Footprints, raster: Raster, light: LampLight,
    arrived: NDArray[np.bool_], means: NDArray[np.float32],
) -> None:  # fmt: skip
    vertices, faces, neighbours, face_body, uv = mesh.vertices, mesh.faces, mesh.neighbours, mesh.face_body, mesh.uv
    origin, directions, across, down = rays.origin, rays.directions, rays.across, rays.down
    hits, width = rays.face, rays.width
    offsets, weights = footprints.offsets, footprints.weights
    values, flat, cubic, tiled = raster.values, raster.values.ravel(), raster.cubic, raster.tiled
    texel_rows, texel_columns = values.shape
    gain, level = raster.gain / (36.0 if cubic else 1.0), raster.mean
    by_lamp, dark_lamps, meeting = light.by_lamp, light.blocked, footprints.meeting
    pixels, firsts, counts = footprints.pixels, footprints.firsts, footprints.counts
    height = hits.shape[0] // width
    ambient = light.ambient
    apart, lit, lamps = 1 if across.shape[0] > 1 else 0, by_lamp.shape[0] > 0, by_lamp.shape[1]
    known = meeting.shape[0] > 0
    form = np.empty(FORMS, dtype=np.float64)
    for n in range(low, high):
        pixel = pixels[n]
        face = hits[pixel]
        body = face_body[face]
        alone = True
        row, column = pixel // width, pixel % width
        for y in range(max(row - 1, 0), min(row + 2, height)):
            for x in range(max(column - 1, 0), min(column + 2, width)):
                other = hits[y * width + x]
                alone = alone and other >= 0 and face_body[other] == body
        if not (alone or known):
            continue
        write_forms(vertices, faces, face, origin, form)
        side = 1.0 if form[DISTANCE] > 0.0 else -1.0
        right_x, right_y, right_z = across[pixel * apart, 0], across[pixel * apart, 1], across[pixel * apart, 2]
        down_x, down_y, down_z = down[pixel * apart, 0], down[pixel * apart, 1], down[pixel * apart, 2]
        cx, cy, cz = directions[pixel, 0], directions[pixel, 1], directions[pixel, 2]
        # Start of the line to the next sample.
        px, py, pz = cx, cy, cz
        mean, factor, lit_face = 0.0, 1.0, -1
        first, count = firsts[n], counts[n]
        for sample in range(first, first + count):
            right, below = offsets[sample, 0], offsets[sample, 1]
            dx = cx + (right * right_x + below * down_x)
            dy = cy + (right * right_y + below * down_y)
            dz = cz + (right * right_z + below * down_z)
            found = False
            for _step in range(MOST_STEPS):
                w0, w1, w2 = edge_functions(form, dx, dy, dz)
                ways, edge, corner = ways_out(side * w0, side * w1, side * w2)
                if ways == 0:
                    found = True
                    break
                if ways == 3:
                    break
                if ways == 2:
                    # As in `walk_footprints`, by the side on which the line passes the corner.
                    vertex = faces[face, corner]
                    nx, ny, nz = py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx
                    left = (
                        nx * (vertices[vertex, 0] - origin[0])
                        + ny * (vertices[vertex, 1] - origin[1])
                        + nz * (vertices[vertex, 2] - origin[2])
                    )
                    edge = (corner + 2) % 3 if side * left > 0.0 else corner
                face = neighbours[face, edge]
                if face < 0 or face_body[face] != body:
                    break
                write_forms(vertices, faces, face, origin, form)
                if not side * form[DISTANCE] > 0.0:
                    break
            blur = rounding(form, dx, dy, dz)
            if not found or min(abs(w0), abs(w1), abs(w2)) <= blur or not side * slope(form, dx, dy, dz) > 0.0:
                break
            if not alone and meeting[face]:
                break
            total = w0 + w1 + w2
            b1, b2 = w1 / total, w2 / total
            u0, v0 = uv[face, 0, 0], uv[face, 0, 1]
            u = u0 + b1 * (uv[face, 1, 0] - u0) + b2 * (uv[face, 2, 0] - u0)
            v = v0 + b1 * (uv[face, 1, 1] - v0) + b2 * (uv[face, 2, 1] - v0)
            if lit and face != lit_face:
                lit_face, factor = face, ambient
                for lamp in range(lamps):
                    part = by_lamp[face, lamp]
                    if part >= 0.0:
                        factor += part
                    elif (dark_lamps[n] >> np.uint64(lamp)) & np.uint64(1) == np.uint64(0):
                        factor -= part
            if cubic:
                value = np.float64(_spline_at(flat, texel_rows, texel_columns, u, v))
            else:
                value = np.float64(linear_at(values, u, v, tiled))
            mean += weights[sample] * factor * (gain * value + level)
            px, py, pz = dx, dy, dz
            arrived[n] = sample == first + count - 1
        means[n] = mean
