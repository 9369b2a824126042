"""Kernels of a tree of spheres around triangles, which finds the triangles between a point and a lamp."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel

__all__ = ["SurfaceTree", "build_tree", "find_between"]

_LEAF = 4  # triangles of a leaf of the tree
_DEPTH = 64  # most levels


class SurfaceTree(NamedTuple):
    """Triangles in a tree of spheres.

    ``spheres``: Centre and radius of each node, shape (k, 4).
    ``children``: Both children of a node; or, for leaves, minus the first place in ``order`` minus 1, and the number of
      its triangles, shape (k, 2).
    ``order``: Faces by leaf, shape (m,). ``covers``: Centre and radius of a sphere around each of them, shape (m, 4).
    ``corners``: Corners of all faces, shape (m, 3, 3).
    ``planes``: Vector at right angles to each face, and its product with the points of the face, shape (m, 4).
    ``neighbours``: Face across each edge that has the edge in the opposite direction, -1 for none, shape (m, 3).
    ``bodies``: Body of each face, shape (m,).
    """

    spheres: NDArray[np.float64]
    children: NDArray[np.int32]
    order: NDArray[np.int32]
    covers: NDArray[np.float64]
    corners: NDArray[np.float64]
    planes: NDArray[np.float64]
    neighbours: NDArray[np.int32]
    bodies: NDArray[np.int32]


def build_tree(
    corners_mm: NDArray[np.float64], neighbours: NDArray[np.int32], bodies: NDArray[np.int32]
) -> SurfaceTree:
    """Build the tree of triangles, shape (m, 3, 3).

    ``neighbours``: Face across each edge, -1 for none, shape (m, 3). ``bodies``: Body of each face, shape (m,).
    """
    corners = np.ascontiguousarray(corners_mm)
    spheres, children, order = _build(corners)
    covers, planes = _cover(corners, order), _planes(corners)
    facing = _facing_neighbours(corners, neighbours)
    return SurfaceTree(spheres, children, order, covers, corners, planes, facing, bodies)


@kernel()
def _planes(corners: NDArray[np.float64]) -> Any:
    """Return the planes of triangles, see `SurfaceTree`."""
    planes = np.empty((corners.shape[0], 4))
    for n in range(corners.shape[0]):
        planes[n, 3] = 0.0
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            one, other = corners[n, 1, i] - corners[n, 0, i], corners[n, 2, j] - corners[n, 0, j]
            third, fourth = corners[n, 1, j] - corners[n, 0, j], corners[n, 2, i] - corners[n, 0, i]
            planes[n, k] = one * other - third * fourth
            planes[n, 3] += planes[n, k] * corners[n, 0, k]
    return planes


@kernel()
def _facing_neighbours(corners: NDArray[np.float64], neighbours: NDArray[np.int32]) -> Any:
    """Return the neighbours that have the common edge in the opposite direction, with equal ends."""
    found = np.full(neighbours.shape, -1, dtype=np.int32)
    for face in range(corners.shape[0]):
        for edge in range(3):
            other, after = neighbours[face, edge], (edge + 1) % 3
            if other < 0:
                continue
            for place in range(3):
                following, equal = (place + 1) % 3, True
                for k in range(3):
                    equal = equal and corners[face, edge, k] == corners[other, following, k]
                    equal = equal and corners[face, after, k] == corners[other, place, k]
                if equal and neighbours[other, place] == face:
                    found[face, edge] = other
    return found


@kernel()
def _cover(corners: NDArray[np.float64], order: NDArray[np.int32]) -> Any:
    """Return spheres around triangles, in an order: around their mean, or the middle of a side if that is smaller."""
    out, centre = np.empty((len(order), 4)), np.empty(3)
    for place in range(len(order)):
        face = order[place]
        out[place, 3] = np.inf
        for c in range(4):
            far = 0.0
            for k in range(3):
                total = corners[face, 0, k] + corners[face, 1, k] + corners[face, 2, k]
                centre[k] = total / 3.0 if c == 3 else 0.5 * (total - corners[face, c, k])
            for corner in range(3):
                square = 0.0
                for k in range(3):
                    square += (corners[face, corner, k] - centre[k]) ** 2
                far = max(far, np.sqrt(square))
            if far < out[place, 3]:
                out[place, 0], out[place, 1], out[place, 2], out[place, 3] = centre[0], centre[1], centre[2], far
    return out


@kernel()
def _build(corners: NDArray[np.float64]) -> Any:
    """Split triangles at the middle of the longest side of the box around their centres."""
    count = corners.shape[0]
    centres = np.empty((count, 3))
    for n in range(count):
        for k in range(3):
            centres[n, k] = (corners[n, 0, k] + corners[n, 1, k] + corners[n, 2, k]) / 3.0
    order = np.arange(count).astype(np.int32)
    spheres = np.zeros((2 * count + 1, 4))
    children = np.zeros((2 * count + 1, 2), dtype=np.int32)
    stack = np.empty((_DEPTH * 2, 4), dtype=np.int64)
    stack[0] = 0, 0, count, 0
    waiting, used = 1, 1
    if count == 0:
        children[0, 0] = -1
        waiting = 0
    while waiting:
        waiting -= 1
        node, first, last, level = stack[waiting]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        least, most = np.full(3, np.inf), np.full(3, -np.inf)
        for place in range(first, last):
            face = order[place]
            for k in range(3):
                least[k], most[k] = min(least[k], centres[face, k]), max(most[k], centres[face, k])
                for c in range(3):
                    low[k], high[k] = min(low[k], corners[face, c, k]), max(high[k], corners[face, c, k])
        radius = 0.0
        for k in range(3):
            spheres[node, k] = 0.5 * (low[k] + high[k])
        for place in range(first, last):
            face = order[place]
            for c in range(3):
                far = 0.0
                for k in range(3):
                    far += (corners[face, c, k] - spheres[node, k]) ** 2
                radius = max(radius, far)
        spheres[node, 3] = np.sqrt(radius)
        if last - first <= _LEAF or level >= _DEPTH - 2:
            children[node, 0], children[node, 1] = -first - 1, last - first
            continue
        axis = 0
        for k in range(1, 3):
            if most[k] - least[k] > most[axis] - least[axis]:
                axis = k
        middle = 0.5 * (least[axis] + most[axis])
        left, right = first, last - 1
        while left <= right:
            if centres[order[left], axis] < middle:
                left += 1
            else:
                order[left], order[right] = order[right], order[left]
                right -= 1
        if left in (first, last):
            left = (first + last) // 2
        children[node, 0], children[node, 1] = used, used + 1
        stack[waiting] = used, first, left, level + 1
        stack[waiting + 1] = used + 1, left, last, level + 1
        waiting += 2
        used += 2
    return spheres[:used].copy(), children[:used].copy(), order


@subkernel()
def find_between(
    tree: SurfaceTree, start: tuple[float, float, float], near: float, lamp: tuple[float, float, float], radius: float,
    own: int, found: NDArray[np.int32],
) -> Any:  # fmt: skip
    """Find the faces that may lie between a sphere around a point and the sphere around a lamp.

    ``start``, ``near``: The point, and the radius of the sphere around it.
    ``lamp``, ``radius``: Centre and radius of the sphere around the lamp.
    ``own``: Face of the point, which is not found; -1 for none.
    ``found``: Buffer for the faces. Returns their number, which may exceed the size of the buffer.
    """
    spheres, children, order, covers = tree.spheres, tree.children, tree.order, tree.covers
    ax, ay, az = lamp[0] - start[0], lamp[1] - start[1], lamp[2] - start[2]
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    slope = max(radius - near, 0.0) / length
    wider = np.sqrt(1.0 + slope * slope)
    stack = np.empty(2 * _DEPTH, dtype=np.int32)
    stack[0] = 0
    waiting, count = 1, 0
    while waiting:
        waiting -= 1
        node = stack[waiting]
        dx, dy, dz = spheres[node, 0] - start[0], spheres[node, 1] - start[1], spheres[node, 2] - start[2]
        size = spheres[node, 3]
        along = dx * ax + dy * ay + dz * az
        if along < -size - near or along > length + radius + size:
            continue
        # The beam is a cone between the two spheres.
        reach = near * wider + slope * max(along, 0.0) + size * wider
        if dx * dx + dy * dy + dz * dz - along * along > reach * reach:
            continue
        if children[node, 0] >= 0:
            stack[waiting], stack[waiting + 1] = children[node, 0], children[node, 1]
            waiting += 2
            continue
        first = -children[node, 0] - 1
        for place in range(first, first + children[node, 1]):
            dx, dy, dz = covers[place, 0] - start[0], covers[place, 1] - start[1], covers[place, 2] - start[2]
            size = covers[place, 3]
            along = dx * ax + dy * ay + dz * az
            reach = near * wider + slope * max(along, 0.0) + size * wider
            if dx * dx + dy * dy + dz * dz - along * along > reach * reach or along < -size - near:
                continue
            if order[place] != own:
                if count < found.shape[0]:
                    found[count] = order[place]
                count += 1
    return count
