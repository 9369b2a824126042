"""Cells with a single layer of surface against the number of faces over points, one by one."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.raycast import Topology
from scenetruth.truth.layer_kernels import FRONT, IGNORED, Layers, find_convex_faces, find_layers

Array = NDArray[Any]

WIDTH, HEIGHT, PINHOLE = 90, 70, (120.0, 44.0, 34.5)


def sphere(count: int, radius_mm: float) -> tuple[Array, Array]:
    """Return the hull of points on a sphere, with normals outwards."""
    from scipy.spatial import ConvexHull

    points = np.random.default_rng(3).normal(size=(count, 3))
    points *= radius_mm / np.linalg.norm(points, axis=1, keepdims=True)
    faces = ConvexHull(points).simplices
    corners = points[faces]
    inwards = np.linalg.det(corners) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return points, faces.astype(np.int32)


def sheet(count: int, size_mm: float, waves: float) -> tuple[Array, Array]:
    """Return a wavy sheet, which folds over itself in views from the side."""
    x, y = np.meshgrid(np.linspace(-1, 1, count), np.linspace(-1, 1, count))
    z = 0.3 * np.sin(waves * x + 1.3 * y) * np.cos(0.7 * waves * y)
    points = size_mm / 2 * np.stack([x, y, z], axis=-1).reshape(-1, 3)
    first = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [np.stack([first, first + 1, first + count], -1), np.stack([first + 1, first + count + 1, first + count], -1)]
    )
    return points, faces.astype(np.int32)


def turned(points: Array, angle: float, place: tuple[float, float, float]) -> Array:
    from scipy.spatial.transform import Rotation

    found: Array = Rotation.from_rotvec(angle * np.array([0.3, 1.0, 0.2])).apply(points) + place
    return found


def scene(angle: float) -> tuple[Array, Array, Array]:
    """Return vertices, faces and offsets of a sphere in front of two sheets, of which one is in parts behind it."""
    parts = [
        (turned(sphere(80, 9.0)[0], angle, (-6.0, 2.0, 80.0)), sphere(80, 9.0)[1]),
        (turned(sheet(17, 40.0, 5.0)[0], angle, (5.0, -2.0, 100.0)), sheet(17, 40.0, 5.0)[1]),
        (turned(sheet(2, 90.0, 0.0)[0], 0.2 * angle, (0.0, 0.0, 125.0)), sheet(2, 90.0, 0.0)[1]),
    ]
    sizes = np.cumsum([0, *(len(points) for points, _ in parts)])
    faces = np.concatenate([own + start for (_, own), start in zip(parts, sizes[:-1], strict=True)]).astype(np.int32)
    return np.concatenate([points for points, _ in parts]), faces, np.cumsum([0, *(len(own) for _, own in parts)])


def found_in(vertices: Array, faces: Array, offsets: Array) -> tuple[Layers, Array]:
    across = Topology.of(vertices, faces).sides_across
    convex = find_convex_faces(vertices, faces, across, offsets)
    return find_layers(vertices, faces, across, convex, offsets, PINHOLE, WIDTH, HEIGHT), convex


def covered(vertices: Array, faces: Array, rays: Array) -> tuple[Array, Array]:
    """Return which faces are over each ray, and at which depth, shape (rays, faces)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    weights = [rays @ np.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))]
    same = np.all([w > 0 for w in weights], axis=0) | np.all([w < 0 for w in weights], axis=0)
    normals = np.cross(b - a, c - a)
    with np.errstate(divide="ignore"):
        return same, np.einsum("ij,ij->i", normals, a) / (rays @ normals.T)


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.1, 1.9])
def test_single_layers_and_depths_against_all_faces(angle: float) -> None:
    vertices, faces, offsets = scene(angle)
    layers, convex = found_in(vertices, faces, offsets)
    assert convex[: offsets[1]].all()
    assert not convex[offsets[1] :].any()
    pixels = np.random.default_rng(5).uniform([-0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5], (4000, 2))
    focal, *centre = PINHOLE
    rays = np.column_stack([(pixels - centre) / focal, np.ones(len(pixels))])
    over, depth = covered(vertices, faces, rays)
    column, row = ((pixels + 0.5) * layers.inverse).astype(int).T
    decided = 0
    for body, (first, last) in enumerate(pairwise(offsets)):
        own = np.zeros(len(faces), dtype=bool)
        own[first:last] = True
        counted = over & own & (layers.sides & IGNORED == 0)
        top, left, rows, columns = layers.boxes[body]
        inside = (row >= top) & (row < top + rows) & (column >= left) & (column < left + columns)
        assert not counted[~inside].any()
        cell = layers.starts[body] + (row - top) * columns + column - left
        single = inside & layers.single[np.where(inside, cell, 0)]
        assert (counted[single].sum(axis=1) == 1).all()
        decided += int(single.sum())
        other = np.where(layers.nearest_body[row, column] == body, 1, 0)
        bound = layers.nearest[row, column, other]
        nearest = np.where(over & ~own, depth, np.inf).min(axis=1)
        assert (bound <= nearest * (1 + 1e-9)).all()
        # Nothing hides the points that are decided by both.
        front = np.where(counted, depth, np.inf).min(axis=1)
        clear = single & (front < bound)
        assert (front[clear] == np.where(over, depth, np.inf).min(axis=1)[clear]).all()
    assert decided > 2500


def test_back_faces_count_unless_a_body_is_convex_and_the_camera_outside() -> None:
    points, faces = sphere(60, 9.0)
    offsets = np.array([0, len(faces)])
    layers, convex = found_in(points + [0.0, 0.0, 60.0], faces, offsets)
    assert convex.all()
    assert ((layers.sides & IGNORED != 0) == (layers.sides & FRONT == 0)).all()
    # From inside, and where a face is missing, back faces are seen.
    layers, convex = found_in(points, faces, offsets)
    assert convex.all()
    assert not layers.single.any()
    layers, convex = found_in(points + [0.0, 0.0, 60.0], faces[1:], offsets - [0, 1])
    assert not convex.any()
    assert not (layers.sides & IGNORED).any()
    # A dent makes a body no longer convex.
    dented = points.copy()
    dented[0] *= 0.5
    assert not found_in(dented + [0.0, 0.0, 60.0], faces, offsets)[1].any()
    # Normals inwards.
    assert not found_in(points + [0.0, 0.0, 60.0], np.ascontiguousarray(faces[:, ::-1]), offsets)[1].any()


def test_no_cell_is_single_if_a_face_reaches_the_camera() -> None:
    vertices = np.array([[-5.0, -5.0, 50.0], [5.0, -5.0, 50.0], [0.0, 5.0, -1.0]])
    layers, _ = found_in(vertices, np.array([[0, 1, 2]], dtype=np.int32), np.array([0, 1]))
    assert not layers.single.any()
