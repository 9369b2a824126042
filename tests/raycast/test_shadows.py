"""Shadows, held against every triangle in plain NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.raycast import ShadowCaster, Topology
from tests.helpers.faceted_surfaces import relief


def plainly_blocked(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], point: NDArray[np.float64], own: int,
    to_light: NDArray[np.float64], distance: float,
) -> tuple[bool, float]:  # fmt: skip
    """Try all triangles; return whether one is in the way, and how near to an edge or an end the closest call was."""
    corners = vertices[faces] - point
    # Solve b1 (q - p) + b2 (r - p) - along d = -p for every triangle p, q, r.
    columns = [
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
        np.broadcast_to(-to_light, (len(faces), 3)),
    ]
    matrix = np.stack(columns, axis=-1)
    flat = np.abs(np.linalg.det(matrix)) < 1e-9
    matrix[flat] = np.eye(3)
    b1, b2, along = np.linalg.solve(matrix, -corners[:, 0][..., None])[..., 0].T
    gaps = np.stack([b1, b2, 1 - b1 - b2, along, np.full(len(faces), distance) - along])
    inside = gaps.min(axis=0)
    inside[flat] = -1
    inside[own] = -1
    return bool((inside > 0).any()), float(np.abs(inside).min())


@pytest.mark.parametrize("parallel", [False, True])
@pytest.mark.parametrize("where_mm", [0.0, 5000.0])
def test_shadows_of_random_triangles(parallel: bool, where_mm: float) -> None:
    generator = np.random.default_rng(3)
    middles = generator.uniform(-50, 50, (60, 1, 3))
    vertices = (middles + generator.uniform(-20, 20, (60, 3, 3))).reshape(-1, 3) + where_mm
    faces = np.arange(180, dtype=np.int32).reshape(60, 3)
    own = generator.integers(0, 60, 2000).astype(np.int32)
    weights = generator.dirichlet([1, 1, 1], 2000)
    points = np.einsum("nk,nkc->nc", weights, vertices[faces[own]])
    if parallel:
        to_light = np.broadcast_to(np.array([0.36, -0.48, 0.8]), points.shape)
        distance = np.full(len(points), np.inf)
    else:
        away = where_mm + np.array([30.0, -20.0, 70.0]) - points
        distance = np.linalg.norm(away, axis=1)
        to_light = away / distance[:, None]
    caster = ShadowCaster(vertices, Topology.of(vertices, faces))
    blocked = caster.blocked(points, own, to_light, distance)
    if parallel:
        wanted = generator.random(len(points)) < 0.7
        found = caster.blocked_parallel(points, own, wanted, to_light[0])
        assert (found == (blocked & wanted)).all()
    compared = 0
    for n in range(len(points)):
        expected, gap = plainly_blocked(vertices, faces, points[n], int(own[n]), to_light[n], float(distance[n]))
        if gap > 1e-5:  # Embree's float32: nearer calls may go either way
            compared += 1
            assert blocked[n] == expected
    assert compared > 1900
    assert 0.2 < blocked.mean() < 0.95


@pytest.mark.parametrize("body", ["box", "ball"])
def test_a_convex_body_does_not_shade_what_faces_the_light(body: str) -> None:
    mesh = trimesh.creation.box((40, 50, 60)) if body == "box" else trimesh.creation.icosphere(3, 25.0)
    vertices, faces = np.asarray(mesh.vertices) + (3, 4, 660), np.asarray(mesh.faces, dtype=np.int32)
    generator = np.random.default_rng(4)
    own = generator.integers(0, len(faces), 20000).astype(np.int32)
    weights = generator.dirichlet([0.3, 0.3, 0.3], len(own))
    points = np.einsum("nk,nkc->nc", weights, vertices[faces[own]])
    to_light = generator.normal(size=points.shape)
    to_light /= np.linalg.norm(to_light, axis=1, keepdims=True)
    facing = np.einsum("ij,ij->i", np.asarray(mesh.face_normals)[own], to_light)
    caster = ShadowCaster(vertices, Topology.of(vertices, faces))
    blocked = caster.blocked(points, own, to_light, np.full(len(points), np.inf))
    assert not blocked[facing > 1e-6].any()
    # At an edge, the way through the body may be shorter than float32 can tell.
    assert blocked[(facing < -1e-3) & (weights.min(axis=1) > 1e-3)].all()


@settings(max_examples=25, deadline=None)
@given(seed=some.integers(0, 10_000), cells=some.integers(2, 40), low=some.floats(0.02, 1.0))
# The wall, edge-on, seems to float32 to be nearer than what shades it.
@example(seed=1, cells=3, low=0.25)
# The wall, edge-on, seems to be met by rays that pass beyond its ends.
@example(seed=0, cells=2, low=0.45703125)
@example(seed=3670, cells=30, low=0.036564758189070304)
def test_parallel_light_in_cells_finds_what_rays_through_embree_find(seed: int, cells: int, low: float) -> None:
    # Rough surfaces, one over the other, a wall that stands in the light's way edge-on, and slivers.
    generator = np.random.default_rng(seed)
    one, two = relief(seed, cells), relief(seed + 1, cells)
    way = np.array([np.cos(seed), np.sin(seed), low])
    way /= np.linalg.norm(way)
    size = np.ptp(one.vertices_mm[:, :2])
    wall = np.array([[0, 0, 0], [0, 0, 9], [0, 0, 0]]) + np.outer([0, 0, 1], way) * size / 3
    fan = np.column_stack([np.cos(np.arange(40)) * size, np.sin(np.arange(40)) * size, np.full(40, 7.0)])
    vertices = np.concatenate([one.vertices_mm, two.vertices_mm * [0.5, 0.6, 1] + [0, 0, 5], wall, [[0, 0, 8]], fan])
    start = len(one.vertices_mm) + len(two.vertices_mm)
    slivers = [[start + 3, start + 4 + k, start + 5 + k] for k in range(0, 38, 2)]
    faces = np.concatenate(
        [one.faces, two.faces + len(one.vertices_mm), [[start, start + 1, start + 2]], slivers]
    ).astype(np.int32)
    turn = Rotation.random(None, generator)
    vertices, to_light = turn.apply(vertices) + [0, 0, 500], turn.apply(way)
    own = generator.integers(0, len(faces), 3000).astype(np.int32)
    # Corners and edges among them, where every rounding counts.
    weights = generator.dirichlet([0.3, 0.3, 0.3], len(own))
    weights[:300] = np.eye(3)[generator.integers(0, 3, 300)]
    points = np.einsum("nk,nkc->nc", weights, vertices[faces[own]])
    caster = ShadowCaster(vertices, Topology.of(vertices, faces))
    distance = np.full(len(points), np.inf)
    expected = caster.blocked(points, own, np.broadcast_to(to_light, points.shape), distance)
    found = caster.blocked_parallel(points, own, np.ones(len(points), dtype=np.bool_), to_light)
    assert (found == expected).all()


def test_embree_is_seldom_asked_for_parallel_light(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = relief(3, 60)
    generator = np.random.default_rng(1)
    own = generator.integers(0, len(mesh.faces), 20_000).astype(np.int32)
    weights = generator.dirichlet([1, 1, 1], len(own))
    points = np.einsum("nk,nkc->nc", weights, mesh.vertices_mm[mesh.faces[own]])
    caster = ShadowCaster(mesh.vertices_mm, Topology.of(mesh.vertices_mm, mesh.faces))
    asked = []
    plainly = caster.blocked

    def blocked(points_mm: NDArray[np.float64], *others: Any) -> NDArray[np.bool_]:
        asked.append(len(points_mm))
        return plainly(points_mm, *others)

    monkeypatch.setattr(caster, "blocked", blocked)
    shaded = caster.blocked_parallel(points, own, np.ones(len(own), dtype=np.bool_), np.array([0.995, 0.0, 0.0998]))
    assert 0.05 < shaded.mean() < 0.95
    # Light that grazes: many faces are seen nearly edge-on.
    assert sum(asked) < 0.1 * len(points)


@pytest.mark.parametrize("seed", [0, 1])
def test_groups_of_faces_above_points_against_all_faces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 60
    corners = rng.uniform(-20, 20, (count, 1, 3)) + rng.uniform(-7, 7, (count, 3, 3))
    vertices, faces = corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    groups = rng.integers(0, 5, count).astype(np.uint8)
    weights = rng.dirichlet((1, 1, 1), 400)
    own = rng.integers(0, count, 400).astype(np.int32)
    points = np.einsum("nc,ncx->nx", weights, corners[own])
    to_light = rng.normal(size=3)
    to_light /= np.linalg.norm(to_light)
    wanted = rng.random(400) < 0.9
    shadows = ShadowCaster(vertices, Topology.of(vertices, faces))
    expected = np.zeros(400, dtype=np.uint64)
    for n in np.flatnonzero(wanted):
        # Solve p + s l = a + b1 u + b2 v for every face.
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        matrix = np.stack([u, v, np.broadcast_to(-to_light, u.shape)], axis=-1)
        b1, b2, s = np.linalg.solve(matrix, (points[n] - corners[:, 0])[..., None])[..., 0].T
        hit = (b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (s > 0) & (np.arange(count) != own[n])
        for group in groups[hit]:
            expected[n] |= np.uint64(1) << np.uint64(group)
    assert len(np.unique(expected)) > 8
    for on_faces in (False, True):
        found = shadows.groups_above(points, own, wanted, to_light, groups, on_faces=on_faces)
        np.testing.assert_array_equal(found, expected)
