"""A kernel that walks from the face at a pixel's centre to the faces that the samples around it meet."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.raycast.footprints import ImageRays, TexturedMesh
from scenetruth.raycast.inside_kernels import DISTANCE, FORMS, edge_functions, rounding, slope, write_forms
from scenetruth.threads import in_bands

__all__ = ["walk_footprints"]

# Steps to one sample after which a pixel is given up: some hundred faces across a pixel.
_MOST_STEPS = 512
# Pixels that are worth a thread of their own.
_LEAST = 128


@numba.njit(cache=True, nogil=True)
def _ways_out(w0: float, w1: float, w2: float) -> Any:
    """Return outside how many edges a ray is, one of these edges, and the corner between them if they are two.

    Edge k runs from corner k to corner k + 1; -1 stands for no edge, or no corner.
    """
    if w0 < 0.0:
        if w1 < 0.0:
            return (3, -1, -1) if w2 < 0.0 else (2, 1, 2)
        return (2, 0, 1) if w2 < 0.0 else (1, 1, -1)
    if w1 < 0.0:
        return (2, 2, 0) if w2 < 0.0 else (1, 2, -1)
    return (1, 0, -1) if w2 < 0.0 else (0, -1, -1)


def walk_footprints(
    mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64], offsets: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Find the faces that the samples of pixels meet, for pixels whose footprint no silhouette or sharp edge crosses.

    The walk follows a straight line in the image from the pixel's centre to the first sample, from there to the second,
    and so on. It goes from face to face across the edges that the line crosses. The line stays in the footprint. Where
    no silhouette and no sharp edge is seen there, the footprint shows one smooth surface, and all faces on the line
    belong to it.

    A walk is given up where the surface ends, turns its other side, or belongs to another body; where one of the eight
    neighbouring pixels sees another body (the two may intersect); where a sample's ray passes exactly through an edge,
    so that it is inside two faces; and after too many steps.

    Parameters
    ----------
    mesh, rays
        The surface, and the rays of the whole image.
    pixels
        The pixels to take, shape (n,).
    offsets
        The samples' offsets from the pixel centre in px, (x, y), shape (k, 2).

    Returns
    -------
    tuple of numpy.ndarray
        Whether the walk reached all samples, shape (n,); face, (n, k), depth, (n, k), and barycentric coordinates,
        (n, k, 2), as of `Hits`; and texture coordinates, (n, k, 2).
    """
    count, samples = pixels.shape[0], offsets.shape[0]
    arrived = np.zeros(count, dtype=np.bool_)
    face = np.full((count, samples), -1, dtype=np.int32)
    depth = np.empty((count, samples), dtype=np.float64)
    weights = np.empty((count, samples, 2), dtype=np.float64)
    uv = np.empty((count, samples, 2), dtype=np.float64)
    out = (arrived, face, depth, weights, uv)
    in_bands(_walk_footprints, count, mesh, rays, pixels, offsets, *out, least=_LEAST)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _walk_footprints(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64], offsets: NDArray[np.float64],
    arrived: NDArray[np.bool_], face_out: NDArray[np.int32], depth_out: NDArray[np.float64],
    weights: NDArray[np.float64], uv_out: NDArray[np.float64],
) -> None:  # fmt: skip
    vertices, faces, neighbours, face_body, uv = mesh.vertices, mesh.faces, mesh.neighbours, mesh.face_body, mesh.uv
    origin, directions, across, down = rays.origin, rays.directions, rays.across, rays.down
    hits, width = rays.face, rays.width
    samples = offsets.shape[0]
    height = hits.shape[0] // width
    apart = 1 if across.shape[0] > 1 else 0
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
        if not alone:
            continue
        write_forms(vertices, faces, face, origin, form)
        side = 1.0 if form[DISTANCE] > 0.0 else -1.0
        step_x, step_y = across[pixel * apart], down[pixel * apart]
        # Where the line to the next sample begins.
        px, py, pz = directions[pixel, 0], directions[pixel, 1], directions[pixel, 2]
        for sample in range(samples):
            right, below = offsets[sample, 0], offsets[sample, 1]
            dx = directions[pixel, 0] + (right * step_x[0] + below * step_y[0])
            dy = directions[pixel, 1] + (right * step_x[1] + below * step_y[1])
            dz = directions[pixel, 2] + (right * step_x[2] + below * step_y[2])
            found = False
            for _step in range(_MOST_STEPS):
                w0, w1, w2 = edge_functions(form, dx, dy, dz)
                ways, edge, corner = _ways_out(side * w0, side * w1, side * w2)
                if ways == 0:
                    found = True
                    break
                if ways == 3:
                    break
                if ways == 2:
                    # The ray is outside both edges at a corner. The line passes the corner on one side: seen along the
                    # line from inside, the edge that ends at the corner is to the right, the one that begins there to
                    # the left.
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
            total = w0 + w1 + w2
            towards = slope(form, dx, dy, dz)
            # A ray through an edge, but for rounding, is inside two faces: only a search over all faces decides.
            blur = rounding(form, dx, dy, dz)
            if not found or min(abs(w0), abs(w1), abs(w2)) <= blur or not side * towards > 0.0:
                break
            b1, b2 = w1 / total, w2 / total
            face_out[n, sample], depth_out[n, sample] = face, form[DISTANCE] / towards
            weights[n, sample, 0], weights[n, sample, 1] = b1, b2
            for k in range(2):
                first = uv[face, 0, k]
                uv_out[n, sample, k] = first + b1 * (uv[face, 1, k] - first) + b2 * (uv[face, 2, k] - first)
            px, py, pz = dx, dy, dz
            arrived[n] = sample == samples - 1
