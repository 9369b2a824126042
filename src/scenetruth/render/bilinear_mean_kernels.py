"""Kernels that average bilinear textures over pixel footprints exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast import ImageRays, TexturedMesh
from scenetruth.raycast.ray_triangle_kernels import DISTANCE, FORMS, edge_functions, write_forms
from scenetruth.render.footprint_kernels import Footprints, LampLight, Raster
from scenetruth.threads import in_bands

__all__ = ["MOST_CORNERS", "MOST_TEXELS", "average_bilinear", "polygon_mean"]

MOST_TEXELS = 24
"""Largest extent of a polygon along an axis of the texture, in texels."""
MOST_CORNERS = 7
"""Corners of a pixel that is cut by the three edges of a face."""

_LEAST = 128  # minimum number of pixels per thread
_MOST_FACES = 16
_GAUSS = 1.0 / np.sqrt(3.0)  # place of the Gauss points between the middle and the end of an interval
_SMALLEST = 1e-12  # area in square texels or pixels below which a polygon is a line
_MOST_PERSPECTIVE = 0.005  # relative change of the depth per pixel, above which the correction is inaccurate
_WHOLE = 1e-9  # difference of the sum of all areas from that of the pixel


@inlined
def polygon_mean(
    values: NDArray[np.float32], tiled: bool, corners: NDArray[np.float64], count: int, texels: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> Any:  # fmt: skip
    """Average a bilinear texture over a convex polygon that is seen in perspective.

    Green's theorem turns the integral over the polygon into one along its border: ∫ f = ∮ F dy with F = ∫ f dx.
    Between the lines through texel centres, F is a cubic polynomial along a straight line, which two Gauss points
    integrate exactly. The mean in the image is weighted by the inverse of the magnification, which varies with the
    depth: this variation is averaged over one point for each corner.

    ``values``: Texture, texel (i, j) at the point (j, i), repeated or with an extended border, shape (h, w).
    ``corners``: Place of the corners in texels, x and y, and a number proportional to the inverse depth, shape (more
      than ``count``, 3); overwritten.
    ``count``: Number of corners.
    ``texels``, ``sums``: Scratch, shape (`MOST_TEXELS` + 3, `MOST_TEXELS` + 3).
    Returns: Whether the mean was computed, not for polygons that are too large or have no area; and the mean.
    """
    rows, columns = values.shape
    left, top, most_x, most_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(count):
        left, most_x = min(left, corners[k, 0]), max(most_x, corners[k, 0])
        top, most_y = min(top, corners[k, 1]), max(most_y, corners[k, 1])
    if not (most_x - left <= MOST_TEXELS and most_y - top <= MOST_TEXELS):
        return False, 0.0
    # In texels from the first.
    first_x, first_y = np.floor(left), np.floor(top)
    for k in range(count):
        corners[k, 0] -= first_x
        corners[k, 1] -= first_y
    corners[count] = corners[0]
    area = 0.0
    for k in range(count):
        area += 0.5 * (corners[k + 1, 0] + corners[k, 0]) * (corners[k + 1, 1] - corners[k, 1])
    if not abs(area) > _SMALLEST:
        return False, 0.0
    across, down = int(most_x - first_x) + 1, int(most_y - first_y) + 1
    i0, j0 = int(first_x), int(first_y)
    if i0 < 0 or j0 < 0 or i0 + across >= columns or j0 + down >= rows:
        for j in range(down + 1):
            row = (j0 + j) % rows if tiled else min(max(j0 + j, 0), rows - 1)
            for i in range(across + 1):
                column = (i0 + i) % columns if tiled else min(max(i0 + i, 0), columns - 1)
                texels[j, i] = values[row, column]
    else:
        for j in range(down + 1):
            for i in range(across + 1):
                texels[j, i] = values[j0 + j, i0 + i]
    # Integrals of the rows from the first column on.
    for j in range(down + 1):
        total = 0.0
        sums[j, 0] = 0.0
        for i in range(across):
            total += 0.5 * (texels[j, i] + texels[j, i + 1])
            sums[j, i + 1] = total
    integral = 0.0
    for k in range(count):
        x, y = corners[k, 0], corners[k, 1]
        run, rise = corners[k + 1, 0] - x, corners[k + 1, 1] - y
        if rise == 0.0:
            continue
        per_x = 1.0 / run if run != 0.0 else np.inf
        per_y = 1.0 / rise
        # Cell of the start, and the next lines through texel centres.
        i, j = min(int(x), across - 1), min(int(y), down - 1)
        step_i, step_j = (1 if run > 0.0 else -1), (1 if rise > 0.0 else -1)
        if run < 0.0 and x == i and i > 0:
            i -= 1
        if rise < 0.0 and y == j and j > 0:
            j -= 1
        next_x = (i + (1 if run > 0.0 else 0) - x) * per_x if run != 0.0 else np.inf
        next_y = (j + (1 if rise > 0.0 else 0) - y) * per_y
        at = 0.0
        while True:
            to = min(next_x, next_y, 1.0)
            middle, half = 0.5 * (at + to), 0.5 * _GAUSS * (to - at)
            value = 0.0
            for side in range(2):
                t = middle + (half if side == 1 else -half)
                a, b = x + t * run - i, y + t * rise - j
                upper = sums[j, i] + a * (texels[j, i] + 0.5 * a * (texels[j, i + 1] - texels[j, i]))
                lower = sums[j + 1, i] + a * (texels[j + 1, i] + 0.5 * a * (texels[j + 1, i + 1] - texels[j + 1, i]))
                value += upper + b * (lower - upper)
            integral += 0.5 * value * (to - at) * rise
            if to >= 1.0:
                break
            at = to
            if next_x <= next_y:
                i = min(max(i + step_i, 0), across - 1)
                next_x += abs(per_x)
            else:
                j = min(max(j + step_j, 0), down - 1)
                next_y += abs(per_y)
    mean_x, mean_y, mean_depth = 0.0, 0.0, 0.0
    for k in range(count):
        mean_x += corners[k, 0] / count
        mean_y += corners[k, 1] / count
        mean_depth += corners[k, 2] / count
    weights, weighted, plain = 0.0, 0.0, 0.0
    for k in range(count):
        x, y = mean_x + _GAUSS * (corners[k, 0] - mean_x), mean_y + _GAUSS * (corners[k, 1] - mean_y)
        inverse = mean_depth / (mean_depth + _GAUSS * (corners[k, 2] - mean_depth))
        scale = inverse * inverse * inverse
        i, j = min(max(int(x), 0), across - 1), min(max(int(y), 0), down - 1)
        a, b = x - i, y - j
        upper = texels[j, i] + a * (texels[j, i + 1] - texels[j, i])
        lower = texels[j + 1, i] + a * (texels[j + 1, i + 1] - texels[j + 1, i])
        value = upper + b * (lower - upper)
        weights, weighted, plain = weights + scale, weighted + scale * value, plain + value
    return True, integral / area + (plain / count - weighted / weights)


@inlined
def _cut(places: NDArray[np.float64], count: int, scratch: NDArray[np.float64], line: NDArray[np.float64]) -> Any:
    """Cut a convex polygon by a line; return the number of corners left, and whether any were cut (Sutherland-Hodgman).

    ``places``: Corners (x, y), shape (n, 2). ``line``: Coefficients of 1, x and y of a form that is positive inside.
    """
    outside = False
    for k in range(count):
        outside = outside or line[0] + line[1] * places[k, 0] + line[2] * places[k, 1] < 0.0
    if not outside:
        return count, False
    left = 0
    for k in range(count):
        after = k + 1 if k + 1 < count else 0
        x, y, to_x, to_y = places[k, 0], places[k, 1], places[after, 0], places[after, 1]
        here, there = line[0] + line[1] * x + line[2] * y, line[0] + line[1] * to_x + line[2] * to_y
        if here >= 0.0:
            scratch[left, 0], scratch[left, 1] = x, y
            left += 1
        if (here >= 0.0) != (there >= 0.0):
            part = here / (here - there)
            scratch[left, 0], scratch[left, 1] = x + part * (to_x - x), y + part * (to_y - y)
            left += 1
    for k in range(left):
        places[k, 0], places[k, 1] = scratch[k, 0], scratch[k, 1]
    return left, True


def average_bilinear(
    mesh: TexturedMesh, rays: ImageRays, footprints: Footprints, raster: Raster, light: LampLight
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Average the radiance over pixels that show one surface with a bilinear texture, exactly.

    A pixel is cut by the edges of its faces, which are reached across these edges, and averaged on each by
    `polygon_mean`.

    ``footprints``: Pixels; samples are not used.
    Returns: Whether the mean was computed, and the means, shape (n,) each. Pixels are omitted where faces do not cover
    the pixel once; where they may intersect others, as in `average_footprints`; where the footprint has more than
    `MOST_TEXELS` texels along an axis; and where the surface is seen at a grazing angle.
    """
    count = footprints.pixels.shape[0]
    done, means = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.float32)
    in_bands(_average_bilinear, count, mesh, rays, footprints, raster, light, done, means, least=_LEAST)
    return done, means


@kernel()
def _average_bilinear(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, footprints: Footprints, raster: Raster, light: LampLight,
    done: NDArray[np.bool_], means: NDArray[np.float32],
) -> None:  # fmt: skip
    vertices, faces, neighbours, face_body, uv = mesh.vertices, mesh.faces, mesh.neighbours, mesh.face_body, mesh.uv
    origin, directions, steps_across, steps_down = rays.origin, rays.directions, rays.across, rays.down
    hits, width = rays.face, rays.width
    height = hits.shape[0] // width
    values, tiled, pixels, meeting = raster.values, raster.tiled, footprints.pixels, footprints.meeting
    gain, level = raster.gain, raster.mean
    rows, columns = values.shape
    by_lamp, ambient, dark_lamps = light.by_lamp, light.ambient, light.blocked
    lit, lamps, known = by_lamp.shape[0] > 0, by_lamp.shape[1], meeting.shape[0] > 0
    apart = 1 if steps_across.shape[0] > 1 else 0
    texels = np.empty((MOST_TEXELS + 3, MOST_TEXELS + 3), dtype=np.float64)
    sums = np.empty((MOST_TEXELS + 3, MOST_TEXELS + 3), dtype=np.float64)
    places = np.empty((MOST_CORNERS + 1, 2), dtype=np.float64)
    scratch = np.empty((MOST_CORNERS + 1, 2), dtype=np.float64)
    corners = np.empty((MOST_CORNERS + 1, 3), dtype=np.float64)
    lines, form = np.empty((3, 3), dtype=np.float64), np.empty(FORMS, dtype=np.float64)
    queue = np.empty(_MOST_FACES, dtype=np.int64)
    known_face = -1
    for n in range(low, high):
        pixel = pixels[n]
        queue[0] = hits[pixel]
        body = face_body[queue[0]]
        row, column = pixel // width, pixel % width
        alone = True
        for y in range(max(row - 1, 0), min(row + 2, height)):
            for x in range(max(column - 1, 0), min(column + 2, width)):
                other = hits[y * width + x]
                alone = alone and other >= 0 and face_body[other] == body
        if not (alone or known):
            continue
        at, queued, covered, mean, side = 0, 1, 0.0, 0.0, 0.0
        a = pixel * apart
        while at < queued:
            face = queue[at]
            if face != known_face:
                write_forms(vertices, faces, face, origin, form)
                known_face = face
            if at == 0:
                side = 1.0 if form[DISTANCE] > 0.0 else -1.0
            if not side * form[DISTANCE] > 0.0 or (not alone and meeting[face]):
                break
            centre = edge_functions(form, directions[pixel, 0], directions[pixel, 1], directions[pixel, 2])
            right = edge_functions(form, steps_across[a, 0], steps_across[a, 1], steps_across[a, 2])
            below = edge_functions(form, steps_down[a, 0], steps_down[a, 1], steps_down[a, 2])
            whole = True
            for k in range(3):
                lines[k, 0], lines[k, 1], lines[k, 2] = side * centre[k], side * right[k], side * below[k]
                whole = whole and lines[k, 0] >= 0.5 * (abs(lines[k, 1]) + abs(lines[k, 2]))
            places[0, 0], places[0, 1], places[1, 0], places[1, 1] = -0.5, -0.5, 0.5, -0.5
            places[2, 0], places[2, 1], places[3, 0], places[3, 1] = 0.5, 0.5, -0.5, 0.5
            count, across_edges = 4, 0
            area = 1.0
            at += 1
            if not whole:
                for k in range(3):
                    if count > 0:
                        count, was_cut = _cut(places, count, scratch, lines[k])
                        if was_cut:
                            across_edges |= 1 << ((k + 1) % 3)
                area = 0.0
                for k in range(count):
                    after = k + 1 if k + 1 < count else 0
                    area += 0.5 * (places[k, 0] * places[after, 1] - places[after, 0] * places[k, 1])
                if area <= _SMALLEST:
                    continue
            for edge in range(3):
                if (across_edges >> edge) & 1 == 0:
                    continue
                beyond = neighbours[face, edge]
                fresh = beyond >= 0
                for k in range(queued):
                    fresh = fresh and queue[k] != beyond
                if fresh and face_body[beyond] == body and queued < _MOST_FACES:
                    queue[queued] = beyond
                    queued += 1
            d0 = lines[0, 0] + lines[1, 0] + lines[2, 0]
            dx, dy = lines[0, 1] + lines[1, 1] + lines[2, 1], lines[0, 2] + lines[1, 2] + lines[2, 2]
            if not abs(dx) + abs(dy) <= _MOST_PERSPECTIVE * abs(d0):
                break
            for k in range(count):
                x, y = places[k, 0], places[k, 1]
                w1 = lines[1, 0] + lines[1, 1] * x + lines[1, 2] * y
                w2 = lines[2, 0] + lines[2, 1] * x + lines[2, 2] * y
                depth = d0 + dx * x + dy * y
                inverse = 1.0 / depth
                b1, b2 = w1 * inverse, w2 * inverse
                u0, v0 = uv[face, 0, 0], uv[face, 0, 1]
                corners[k, 0] = (u0 + b1 * (uv[face, 1, 0] - u0) + b2 * (uv[face, 2, 0] - u0)) * columns - 0.5
                corners[k, 1] = (v0 + b1 * (uv[face, 1, 1] - v0) + b2 * (uv[face, 2, 1] - v0)) * rows - 0.5
                corners[k, 2] = depth
            found, value = polygon_mean(values, tiled, corners, count, texels, sums)
            value = gain * value + level
            if not found:
                break
            if lit:
                factor = ambient
                for lamp in range(lamps):
                    part = by_lamp[face, lamp]
                    if part >= 0.0:
                        factor += part
                    elif (dark_lamps[n] >> np.uint64(lamp)) & np.uint64(1) == np.uint64(0):
                        factor -= part
                value *= factor
            mean += area * value
            covered += area
        if abs(covered - 1.0) <= _WHOLE:
            done[n], means[n] = True, mean
