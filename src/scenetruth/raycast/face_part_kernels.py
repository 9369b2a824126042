"""Kernel that divides pixels on one surface into the parts of its faces, with exact areas."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast.mesh_topology import ImageRays, TexturedMesh
from scenetruth.raycast.ray_triangle_kernels import DISTANCE, FORMS, edge_functions, slope, write_forms
from scenetruth.threads import in_bands

__all__ = ["MOST_PARTS", "FaceParts", "divide_pixels"]

MOST_PARTS = 256
"""Maximum number of faces in a pixel that is divided."""

_FEW = 16  # space for the faces of a pixel, enlarged if necessary
_LEAST = 256  # minimum number of pixels per thread
_EMPTY = 1e-13  # area in px² below which a part is ignored
_WHOLE = 1e-9  # deviation of the sum of the areas from that of the pixel, by rounding
_MOST_CORNERS = 12  # of a square cut by three lines, with a margin
# Columns of the values of a part.
_AREA, _X, _Y, _B1, _B2, _DEPTH, _U, _V, _VALUES = range(9)


class FaceParts(NamedTuple):
    """Parts of faces in pixels, in the order of the pixels."""

    owner: NDArray[np.int64]
    """Index of the pixel of each part among the given pixels, ascending, shape (k,)."""
    face: NDArray[np.int32]
    """Face of each part, shape (k,)."""
    area: NDArray[np.float64]
    """Area in px², shape (k,); the sum over a pixel is 1."""
    offsets: NDArray[np.float64]
    """Centroid, as offset (x, y) from the pixel centre in px, shape (k, 2)."""
    weights: NDArray[np.float64]
    """Barycentric coordinates of the centroid, as in `Hits`, shape (k, 2)."""
    depth: NDArray[np.float64]
    """Depth of the centroid, as in `Hits`, shape (k,)."""
    uv: NDArray[np.float64]
    """Texture coordinates of the centroid, shape (k, 2)."""


def divide_pixels(
    mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], FaceParts]:
    """Divide pixels whose footprint crosses no silhouette into the parts of the faces that they show.

    From the face at the pixel centre on, all faces across edges in the pixel are clipped to it. A pixel is not divided
    if the parts do not fill it, or if it shows too many faces.

    ``pixels``: Pixel indices, shape (n,); each must have a hit.
    Returns: Whether a pixel is divided; whether a pixel next to it shows another body, which may hide its faces, shape
    (n,) each; and the parts of the divided pixels.
    """
    count = len(pixels)
    counts, beside = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.bool_)
    face, values = np.empty((count, _FEW), dtype=np.int32), np.empty((count, _FEW, _VALUES))
    in_bands(_divide_pixels, count, mesh, rays, pixels, counts, beside, face, values, least=_LEAST)
    many = np.flatnonzero(counts > _FEW)
    divided = counts > 0
    used = np.arange(_FEW) < np.where(counts > _FEW, 0, counts)[:, None]
    owner = np.nonzero(used)[0]
    face, values = face[used], values[used]
    if len(many):
        more, others = np.empty((len(many), MOST_PARTS), dtype=np.int32), np.empty((len(many), MOST_PARTS, _VALUES))
        again, near = np.empty(len(many), dtype=np.int64), np.empty(len(many), dtype=np.bool_)
        in_bands(_divide_pixels, len(many), mesh, rays, pixels[many], again, near, more, others, least=16)
        again[again > MOST_PARTS] = 0
        divided[many] = again > 0
        used = np.arange(MOST_PARTS) < again[:, None]
        owner = np.concatenate([owner, many[np.nonzero(used)[0]]])
        order = np.argsort(owner, kind="stable")
        owner = owner[order]
        face, values = np.concatenate([face, more[used]])[order], np.concatenate([values, others[used]])[order]
    return (
        divided,
        beside,
        FaceParts(
            owner,
            face,
            values[:, _AREA],
            values[:, _X : _Y + 1],
            np.ascontiguousarray(values[:, _B1 : _B2 + 1]),
            np.ascontiguousarray(values[:, _DEPTH]),
            np.ascontiguousarray(values[:, _U : _V + 1]),
        ),
    )


@inlined
def _next_to_other(mesh: TexturedMesh, rays: ImageRays, pixel: int, face: int) -> Any:
    """Return whether a pixel around a pixel with a hit on a face shows another body."""
    hits, width = rays.face, rays.width
    height = hits.shape[0] // width
    body, row, column = mesh.face_body[face], pixel // width, pixel % width
    for y in range(max(row - 1, 0), min(row + 2, height)):
        for x in range(max(column - 1, 0), min(column + 2, width)):
            other = hits[y * width + x]
            if other >= 0 and mesh.face_body[other] != body:
                return True
    return False


@kernel()
def _divide_pixels(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64],
    counts: NDArray[np.int64], beside: NDArray[np.bool_], face_out: NDArray[np.int32], values: NDArray[np.float64],
) -> None:  # fmt: skip
    vertices, faces, neighbours, face_body, uv = mesh.vertices, mesh.faces, mesh.neighbours, mesh.face_body, mesh.uv
    origin, apart, space = rays.origin, 1 if rays.across.shape[0] > 1 else 0, face_out.shape[1]
    form, lines = np.empty(FORMS), np.empty((3, 3))
    xs, ys, heights = np.empty(_MOST_CORNERS), np.empty(_MOST_CORNERS), np.empty(_MOST_CORNERS)
    new_x, new_y = np.empty(_MOST_CORNERS), np.empty(_MOST_CORNERS)
    # Faces that are clipped, or to be clipped: each part has at most three neighbours.
    listed, cut = np.empty(3 * space + 4, dtype=np.int32), np.empty(3, dtype=np.bool_)
    for n in range(low, high):
        pixel = pixels[n]
        start = rays.face[pixel]
        body, beside[n] = face_body[start], _next_to_other(mesh, rays, pixel, start)
        directions, across, down = rays.directions[pixel], rays.across[pixel * apart], rays.down[pixel * apart]
        counts[n], used, total, at, side = 0, 0, 0.0, 0, 0.0
        listed[0], waiting, failed = start, 1, False
        while at < waiting and not failed:
            face = listed[at]
            at += 1
            write_forms(vertices, faces, face, origin, form)
            if side == 0.0:
                side = 1.0 if form[DISTANCE] > 0.0 else -1.0
            if not side * form[DISTANCE] > 0.0 or face_body[face] != body:
                failed = True
                break
            c0, c1, c2 = edge_functions(form, directions[0], directions[1], directions[2])
            r0, r1, r2 = edge_functions(form, across[0], across[1], across[2])
            d0, d1, d2 = edge_functions(form, down[0], down[1], down[2])
            lines[0, 0], lines[0, 1], lines[0, 2] = side * c0, side * r0, side * d0
            lines[1, 0], lines[1, 1], lines[1, 2] = side * c1, side * r1, side * d1
            lines[2, 0], lines[2, 1], lines[2, 2] = side * c2, side * r2, side * d2
            corners = 4
            xs[0], xs[1], xs[2], xs[3] = -0.5, 0.5, 0.5, -0.5
            ys[0], ys[1], ys[2], ys[3] = -0.5, -0.5, 0.5, 0.5
            for edge in range(3):
                cut[edge] = False
                for k in range(corners):
                    heights[k] = lines[edge, 0] + (xs[k] * lines[edge, 1] + ys[k] * lines[edge, 2])
                    cut[edge] = cut[edge] or heights[k] < 0.0
                if not cut[edge]:
                    continue
                kept = 0
                for k in range(corners):
                    following = k + 1 if k + 1 < corners else 0
                    if heights[k] >= 0.0:
                        new_x[kept], new_y[kept] = xs[k], ys[k]
                        kept += 1
                    if (heights[k] < 0.0) != (heights[following] < 0.0):
                        share = heights[k] / (heights[k] - heights[following])
                        new_x[kept] = xs[k] + share * (xs[following] - xs[k])
                        new_y[kept] = ys[k] + share * (ys[following] - ys[k])
                        kept += 1
                corners = kept
                for k in range(corners):
                    xs[k], ys[k] = new_x[k], new_y[k]
            # Moments about the first corner.
            area, sum_x, sum_y = 0.0, 0.0, 0.0
            for k in range(1, corners - 1):
                ax, ay, bx, by = xs[k] - xs[0], ys[k] - ys[0], xs[k + 1] - xs[0], ys[k + 1] - ys[0]
                double = ax * by - bx * ay
                area += 0.5 * double
                sum_x, sum_y = sum_x + double * (ax + bx) / 6.0, sum_y + double * (ay + by) / 6.0
            if not area > _EMPTY:
                continue
            total += area
            if used < space:
                x, y = xs[0] + sum_x / area, ys[0] + sum_y / area
                w0 = lines[0, 0] + (x * lines[0, 1] + y * lines[0, 2])
                w1 = lines[1, 0] + (x * lines[1, 1] + y * lines[1, 2])
                w2 = lines[2, 0] + (x * lines[2, 1] + y * lines[2, 2])
                whole = w0 + w1 + w2
                b1, b2 = w1 / whole, w2 / whole
                dx = directions[0] + (x * across[0] + y * down[0])
                dy = directions[1] + (x * across[1] + y * down[1])
                dz = directions[2] + (x * across[2] + y * down[2])
                face_out[n, used] = face
                values[n, used, _AREA], values[n, used, _X], values[n, used, _Y] = area, x, y
                values[n, used, _B1], values[n, used, _B2] = b1, b2
                values[n, used, _DEPTH] = form[DISTANCE] / slope(form, dx, dy, dz)
                for k in range(2):
                    first = uv[face, 0, k]
                    values[n, used, _U + k] = first + b1 * (uv[face, 1, k] - first) + b2 * (uv[face, 2, k] - first)
            used += 1
            if used > space:
                break
            for k in range(3):
                # Edge k runs from corner k to corner k + 1, and its function has the number of the opposite corner.
                if not cut[(k + 2) % 3]:
                    continue
                other = neighbours[face, k]
                if other < 0:
                    continue
                new = True
                for entry in range(waiting):
                    if listed[entry] == other:
                        new = False
                        break
                if new:
                    listed[waiting] = other
                    waiting += 1
        if failed:
            continue
        # The rest of pixels with more faces than space is computed with more space.
        if used > space or abs(total - 1.0) < _WHOLE:
            counts[n] = used
