"""Kernels for the first hits of rays anywhere in the pixels of a regular grid, pixel by pixel, in float64."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel
from scenetruth.raycast.mesh_topology import ImageRays
from scenetruth.raycast.ray_triangle_kernels import (
    BLUR_X,
    BLUR_Y,
    BLUR_Z,
    HIGH_U,
    HIGH_V,
    LOW_U,
    LOW_V,
    PLANE_MARGIN,
    RANGES,
    W0_X,
    W1_X,
    W2_X,
    components,
    depth_on,
    edge_functions,
    inside,
    rounding,
    weigh,
)
from scenetruth.threads import in_bands

__all__ = ["RayGrid", "pixel_hits", "sample_directions"]

_MARGIN = 1e-5  # deviation of rays from their pixel, in steps of the grid
_NEARER = 1e-9  # relative margin of depths for rounding
_MANY_RAYS = 4  # minimum number of rays in a pixel for which its faces are sorted by depth
_SORTED, _MOST_SORTED = (
    256,
    1024,
)  # maximum number of faces in a pixel that are sorted by depth, for few and for many rays
_CROWD = 64  # minimum number of rays in a pixel for which more faces are sorted
_LEAST_CAST = 2048  # minimum number of rays per thread
_BLOCK = 4  # pixels along a side of the blocks in which pixels with rays are marked
_FACES_PER_PIXEL = 12  # space for the faces of a pixel, enlarged if necessary


def sample_directions(rays: ImageRays, pixels: NDArray[np.int64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the directions of rays at offsets (x, y) in px from the centres of pixels, shape (n, 3)."""
    directions = np.empty((pixels.shape[0], 3))
    in_bands(_sample_directions, pixels.shape[0], rays, pixels, offsets, directions, least=_LEAST_CAST)
    return directions


@kernel()
def _sample_directions(
    low: int, high: int, rays: ImageRays, pixels: NDArray[np.int64], offsets: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> None:  # fmt: skip
    apart = 1 if rays.across.shape[0] > 1 else 0
    for n in range(np.uint64(low), np.uint64(high)):
        pixel, right, below = pixels[n], offsets[n, 0], offsets[n, 1]
        for k in range(3):
            step = right * rays.across[pixel * apart, k] + below * rays.down[pixel * apart, k]
            directions[n, k] = rays.directions[pixel, k] + step


class RayGrid(NamedTuple):
    """Regular grid of pixels in the central projection of a mesh along an axis."""

    vertices: NDArray[np.float64]
    """World positions in mm, shape (n, 3)."""
    faces: NDArray[np.int32]
    """Vertex indices of the faces, shape (m, 3)."""
    origin: NDArray[np.float64]
    """Origin of the rays in mm, shape (3,)."""
    frame: NDArray[np.float64]
    """Two unit vectors across the axis and the axis, as rows of a rotation."""
    steps: NDArray[np.float64]
    """Lowest u, its step from column to column, lowest v, its step from row to row, see `grid_steps`."""
    width: int
    """Pixels per row."""
    height: int
    """Number of rows."""


def pixel_hits(
    grid: RayGrid,
    forms: NDArray[np.float64],
    boxes: NDArray[np.float64],
    directions: NDArray[np.float64],
    pixels: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the first hit of rays anywhere in the pixels of a grid; bit-identical to `raster_hits`.

    ``forms``, ``boxes``: Of all faces, see `prepare_faces`.
    ``directions``: Directions of the rays, shape (n, 3).
    ``pixels``: Pixel of each ray in row-major order, ascending, shape (n,).
    """
    count = directions.shape[0]
    row_start = np.searchsorted(pixels, np.arange(grid.height + 1) * grid.width)
    face, depth = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    least = max(grid.height * _LEAST_CAST // max(count, 1), 1)
    in_bands(
        _pixel_hits, grid.height, grid, forms, boxes, row_start, pixels, directions, face, depth, weights, least=least
    )
    return face, depth, weights


@inlined
def _touched(one: float, other: float, low: float, per_step: float, first: int, last: int) -> Any:
    """Return the first and last + 1 of the pixels, half a step around grid lines, between two places, in a range."""
    start, end, least, most = (one - low) * per_step, (other - low) * per_step, float(first), float(last)
    start, end = min(start, end) - 0.5 - _MARGIN, max(start, end) + 0.5 + _MARGIN
    return int(np.ceil(min(max(start, least), most))), int(np.floor(min(max(end, least - 1.0), most - 1.0))) + 1


@inlined
def _write_edges(
    form: NDArray[np.float64], grid: RayGrid, largest: float, edges: NDArray[np.float64]
) -> None:  # fmt: skip
    """Write the edge functions of a face, divided by the ray component along the axis, as functions of column and row.

    Each of the three is followed by its largest change from the centre of a pixel to its corners, with margins.
    """
    blur = form[BLUR_X] + form[BLUR_Y] + form[BLUR_Z]
    for k in range(3):
        first = (W0_X, W1_X, W2_X)[k]
        nx, ny, nz = form[first], form[first + 1], form[first + 2]
        along_u, along_v, constant = components(nx, ny, nz, grid.frame)
        right, below = along_u * grid.steps[1], along_v * grid.steps[3]
        edges[k, 0] = along_u * grid.steps[0] + along_v * grid.steps[2] + constant
        edges[k, 1], edges[k, 2] = right, below
        margin = (PLANE_MARGIN * np.sqrt(nx * nx + ny * ny + nz * nz) + blur) * largest
        edges[k, 3] = (0.5 + _MARGIN) * (abs(right) + abs(below)) + margin


@inlined
def _nearest(grid: RayGrid, face: int) -> Any:
    """Return the smallest distance of the corners of a face along the axis."""
    nearest = np.inf
    for corner in range(3):
        vertex = grid.faces[face, corner]
        x = grid.vertices[vertex, 0] - grid.origin[0]
        y = grid.vertices[vertex, 1] - grid.origin[1]
        z = grid.vertices[vertex, 2] - grid.origin[2]
        nearest = min(nearest, x * grid.frame[2, 0] + y * grid.frame[2, 1] + z * grid.frame[2, 2])
    return nearest


@inlined
def _may_touch(edges: NDArray[np.float64], x: float, y: float) -> Any:
    """Return whether any ray in a pixel may be inside the three edges of a face."""
    one = edges[0, 0] + edges[0, 1] * x + edges[0, 2] * y
    two = edges[1, 0] + edges[1, 1] * x + edges[1, 2] * y
    three = edges[2, 0] + edges[2, 1] * x + edges[2, 2] * y
    positive = (one >= -edges[0, 3]) & (two >= -edges[1, 3]) & (three >= -edges[2, 3])
    negative = (one <= edges[0, 3]) & (two <= edges[1, 3]) & (three <= edges[2, 3])
    return positive | negative


@kernel()
def _pixel_hits(
    low: int, high: int, grid: RayGrid, forms: NDArray[np.float64], boxes: NDArray[np.float64],
    row_start: NDArray[np.int64], pixels: NDArray[np.int64], directions: NDArray[np.float64],
    face_out: NDArray[np.int32], depth_out: NDArray[np.float64], weights: NDArray[np.float64],
) -> None:  # fmt: skip
    width, steps, frame = grid.width, grid.steps, grid.frame
    start, end = row_start[low], row_start[high]
    largest = 1.0 + abs(steps[0]) + abs(steps[2]) + width * abs(steps[1]) + grid.height * abs(steps[3])
    # First ray and column of each pixel with rays, and the number of such pixels before each pixel.
    firsts, place_of = np.empty(end - start + 1, dtype=np.int32), np.empty(end - start + 1, dtype=np.int32)
    count, last = 0, 0
    numbers = np.empty((high - low) * width + 1, dtype=np.int32)
    for n in range(start, end):
        if n == start or pixels[n] != pixels[n - 1]:
            pixel = pixels[n] - low * width
            # Slices take long to compile.
            while last <= pixel:
                numbers[last] = count
                last += 1
            firsts[count], place_of[count] = n, pixel % width
            count += 1
    while last < numbers.shape[0]:
        numbers[last] = count
        last += 1
    firsts[count] = end
    # Blocks of pixels with rays: most faces touch none.
    blocks_across = (width - 1) // _BLOCK + 1
    # Zeros of further types take long to compile.
    occupied = np.empty(((high - low - 1) // _BLOCK + 1) * blocks_across, dtype=np.int32)
    for block in range(occupied.shape[0]):
        occupied[block] = 0
    for number in range(count):
        row = pixels[firsts[number]] // width - low
        occupied[row // _BLOCK * blocks_across + place_of[number] // _BLOCK] = 1
    per_column, per_row = 1.0 / steps[1], 1.0 / steps[3]
    # Faces that may touch a pixel, and the number of the pixel.
    space, used = 1024 + _FACES_PER_PIXEL * count, 0
    listed, place = np.empty(space, dtype=np.int32), np.empty(space, dtype=np.int32)
    ends = np.empty(count + 1, dtype=np.int32)
    for number in range(count + 1):
        ends[number] = 0
    edges, near = np.empty((3, 4), dtype=np.float64), np.empty(forms.shape[0], dtype=np.float64)
    for face in range(forms.shape[0]):
        if not boxes[face, LOW_V] <= boxes[face, HIGH_V]:
            continue
        top, bottom = _touched(boxes[face, LOW_V], boxes[face, HIGH_V], steps[2], per_row, low, high)
        if top >= bottom:
            continue
        left, right = _touched(boxes[face, LOW_U], boxes[face, HIGH_U], steps[0], per_column, 0, width)
        if left >= right:
            continue
        found = False
        for row in range((top - low) // _BLOCK, (bottom - low - 1) // _BLOCK + 1):
            for column in range(left // _BLOCK, (right - 1) // _BLOCK + 1):
                found = found or occupied[row * blocks_across + column] != 0
        if not found:
            continue
        ready = False
        for y in range(top, bottom):
            row = (y - low) * width
            first, last = numbers[row + left], numbers[row + right]
            if first == last:
                continue
            if not ready:
                _write_edges(forms[face], grid, largest, edges)
                near[face], ready = _nearest(grid, face), True
            if used + last - first > space:
                space = 2 * space + last - first
                more, places = np.empty(space, dtype=np.int32), np.empty(space, dtype=np.int32)
                for entry in range(used):
                    more[entry], places[entry] = listed[entry], place[entry]
                listed, place = more, places
            for number in range(first, last):
                if _may_touch(edges, float(place_of[number]), float(y)):
                    listed[used], place[used] = face, number
                    used += 1
    for entry in range(used):
        ends[place[entry] + 1] += 1
    for number in range(count):
        ends[number + 1] += ends[number]
    own = np.empty(used, dtype=np.int32)
    # Filled from the end, so that the end of each pixel becomes that of the pixel before.
    for entry in range(used - 1, -1, -1):
        number = place[entry]
        ends[number + 1] -= 1
        own[ends[number + 1]] = listed[entry]
    order = np.empty(_MOST_SORTED, dtype=np.int32)
    # Ranges of the sorted faces: most rays in a pixel with small faces are outside most of them.
    ranges, nears = np.empty((_MOST_SORTED, RANGES), dtype=np.float64), np.empty(_MOST_SORTED, dtype=np.float64)
    for number in range(count):
        n, after = firsts[number], firsts[number + 1]
        first, last = ends[number + 1], ends[number + 2] if number + 1 < count else used
        few = last - first <= (_MOST_SORTED if after - n >= _CROWD else _SORTED) and after - n >= _MANY_RAYS
        if few:
            for k in range(last - first):
                face = own[first + k]
                at, distance = k, near[face]
                while at > 0 and nears[at - 1] > distance:
                    order[at], nears[at] = order[at - 1], nears[at - 1]
                    at -= 1
                order[at], nears[at] = face, distance
            for k in range(last - first):
                for part in range(RANGES):
                    ranges[k, part] = boxes[order[k], part]
        for ray in range(n, after):
            dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
            across, down, along = components(dx, dy, dz, frame)
            u, v = across / along, down / along
            best, nearest, limit = -1, np.inf, np.inf
            for k in range(last - first):
                if few:
                    if nears[k] > limit:
                        break
                    if not (
                        (ranges[k, LOW_U] <= u)
                        & (u <= ranges[k, HIGH_U])
                        & (ranges[k, LOW_V] <= v)
                        & (v <= ranges[k, HIGH_V])
                    ):
                        continue
                face = order[k] if few else own[first + k]
                if not few and near[face] > limit:
                    continue
                form = forms[face]
                w0, w1, w2 = edge_functions(form, dx, dy, dz)
                if not inside(w0, w1, w2, rounding(form, dx, dy, dz)):
                    continue
                depth = depth_on(form, dx, dy, dz)
                if depth > 0.0 and (depth < nearest or (depth == nearest and face < best)):
                    best, nearest = face, depth
                    limit = nearest * along * (1.0 + _NEARER)
            face_out[ray], depth_out[ray], weights[ray, 0], weights[ray, 1] = best, np.nan, 0.0, 0.0
            if best >= 0:
                depth_out[ray] = nearest
                weights[ray, 0], weights[ray, 1] = weigh(forms[best], dx, dy, dz)
