"""Many small faces against cells of rays: the same bits as every other way."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

from scenetruth.raycast import Hits, RayCaster, Topology
from scenetruth.raycast import ray_caster as caster_module
from tests.helpers.boxes_and_rays import boxes, brute_force, grid
from tests.helpers.faceted_surfaces import relief


def scattered(caster: RayCaster, *arguments: object) -> Hits:
    """Cast with cells, however few the faces are; Embree must not be asked."""
    with patch.object(caster_module, "_MOST_TILED", 0), patch.object(RayCaster, "_trace", side_effect=AssertionError):
        return not_by_faces(caster, *arguments)


def not_by_faces(caster: RayCaster, *arguments: object) -> Hits:
    """Cast without the search of regular grids face by face."""
    with patch.object(RayCaster, "_cover", return_value=None):
        return caster.cast(*arguments)  # type: ignore[arg-type]


@settings(max_examples=30, deadline=None)
@given(seed=some.integers(0, 10_000), count=some.integers(1, 3000), around=some.floats(0.001, 0.5))
def test_rays_in_any_order_against_brute_force(seed: int, count: int, around: float) -> None:
    generator = np.random.default_rng(seed)
    points, triangles = boxes(generator, 6, 300.0)
    directions = np.column_stack([generator.normal(size=(count, 2)) * around, np.ones(count)])
    directions *= generator.uniform(0.5, 2, (count, 1))
    turn = Rotation.random(None, generator).as_matrix()
    points, directions = points @ turn.T, directions @ turn.T
    origin = turn @ generator.uniform(-20, 20, 3)
    caster = RayCaster(points, Topology.of(points, triangles))
    near = np.linalg.norm(directions, axis=1) > 0
    # The cells look into one half space only.
    axis = directions.sum(axis=0) / np.linalg.norm(directions.sum(axis=0))
    near &= directions @ axis > 0.2 * np.linalg.norm(directions, axis=1)
    directions = directions[near]
    hits = scattered(caster, origin, directions)
    expected, doubt = brute_force(points, triangles, origin, directions)
    sure = doubt > 1e-10
    assert ((hits.face >= 0) == np.isfinite(expected))[sure].all()
    both = np.isfinite(expected) & sure
    np.testing.assert_allclose(hits.depth[both], expected[both], rtol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=some.integers(0, 10_000), cells=some.integers(5, 80), tilt=some.floats(0, 1.5))
def test_a_leaf_in_cells_in_tiles_and_traced_is_the_same_to_the_bit(seed: int, cells: int, tilt: float) -> None:
    mesh = relief(seed, cells)
    vertices = Rotation.from_rotvec([0.3, tilt, 0.1]).apply(mesh.vertices_mm) + [0, 0, 500]
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    directions = grid(64, 48, 550)
    one = scattered(caster, np.zeros(3), directions, 64)
    with patch.object(caster_module, "_MOST_TILED", 1 << 30):
        two = not_by_faces(caster, np.zeros(3), directions, 64)
    by_faces = caster._cover(np.zeros(3), directions, 64)
    assert by_faces is not None
    np.testing.assert_array_equal(by_faces.face, two.face)
    np.testing.assert_array_equal(by_faces.depth, two.depth)
    np.testing.assert_array_equal(by_faces.weights, two.weights)
    with patch.object(caster_module, "_MOST_RASTERED", 0):
        three = caster.cast(np.zeros(3), directions, 64)
    np.testing.assert_array_equal(one.face, two.face)
    np.testing.assert_array_equal(one.depth, two.depth)
    np.testing.assert_array_equal(one.weights, two.weights)
    same = one.face == three.face
    # Embree may miss slivers that float32 cannot tell from nothing.
    assert (~same).sum() <= 1
    np.testing.assert_array_equal(one.depth[same], three.depth[same])


@settings(max_examples=20, deadline=None)
@given(seed=some.integers(0, 10_000), count=some.integers(3, 400), tilt=some.floats(0, 1.6))
def test_slivers_in_cells_and_in_tiles_are_the_same_to_the_bit(seed: int, count: int, tilt: float) -> None:
    # Fans of long thin faces at all angles to the rows of cells, and one seen almost edge-on.
    generator = np.random.default_rng(seed)
    angles = np.sort(generator.uniform(0, 2 * np.pi, count))
    rim = np.column_stack([30 * np.cos(angles), 20 * np.sin(angles), generator.uniform(-3, 3, count)])
    vertices = np.concatenate([[[0, 0, 0]], rim])
    index = np.arange(1, count, dtype=np.int32)
    faces = np.column_stack([np.zeros_like(index), index, index + 1])
    vertices = Rotation.from_rotvec([tilt, 0.2, generator.uniform(0, 3)]).apply(vertices) + [0, 0, 500]
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    directions = grid(64, 48, 550)
    one = scattered(caster, np.zeros(3), directions, 64)
    with patch.object(caster_module, "_MOST_TILED", 1 << 30):
        two = not_by_faces(caster, np.zeros(3), directions, 64)
    by_faces = caster._cover(np.zeros(3), directions, 64)
    assert by_faces is not None
    np.testing.assert_array_equal(by_faces.face, two.face)
    np.testing.assert_array_equal(by_faces.depth, two.depth)
    np.testing.assert_array_equal(by_faces.weights, two.weights)
    assert tilt > 1.4 or (one.face >= 0).any()
    np.testing.assert_array_equal(one.face, two.face)
    np.testing.assert_array_equal(one.depth, two.depth)
    np.testing.assert_array_equal(one.weights, two.weights)


def test_a_turned_grid_behind_near_faces_and_grids_that_are_not_regular() -> None:
    mesh = relief(3, 8)
    turn = Rotation.from_rotvec([0.2, -0.4, 0.7]).as_matrix()
    # Part of the faces are beside or behind the origin.
    vertices = (mesh.vertices_mm + [32, 0, 5]) @ turn.T
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    directions = grid(64, 48, 60) @ turn.T
    hits = caster._cover(np.zeros(3), directions, 64)
    assert hits is not None
    other = not_by_faces(caster, np.zeros(3), directions, 64)
    for name in ("face", "depth", "weights"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(other, name))
    assert 0 < np.mean(hits.face >= 0) < 1
    bent = directions * np.linspace(1, 1.01, len(directions))[:, None]
    bent[100] += 1e-4
    assert caster._cover(np.zeros(3), bent, 64) is None
    assert caster._cover(np.zeros(3), np.tile(directions[0], (len(directions), 1)), 64) is None


def test_what_was_prepared_for_one_point_is_not_used_for_another() -> None:
    mesh = relief(1, 40)
    vertices = mesh.vertices_mm + [0, 0, 500]
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    directions = grid(64, 48, 550)
    first = caster.cast(np.zeros(3), directions, 64)
    second = caster.cast(np.array([9.0, 0, 0]), directions, 64)
    few = caster.cast(np.zeros(3), directions[::7])
    np.testing.assert_array_equal(few.face, first.face[::7])
    np.testing.assert_array_equal(few.depth, first.depth[::7])
    fresh = RayCaster(vertices, caster.topology).cast(np.array([9.0, 0, 0]), directions, 64)
    np.testing.assert_array_equal(second.depth, fresh.depth)
    assert (second.depth != first.depth).any()


def test_rays_elsewhere_after_others_from_the_same_point() -> None:
    # What was prepared looks forward; rays to the side need a frame of their own.
    mesh = relief(1, 20)
    vertices = np.concatenate([mesh.vertices_mm + [0, 0, 100], mesh.vertices_mm[:, [2, 1, 0]] + [100, 0, 0]])
    faces = np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices_mm)])
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    forward = grid(32, 32, 100)
    ahead = scattered(caster, np.zeros(3), forward, 32)
    aside = scattered(caster, np.zeros(3), forward[:, [2, 1, 0]], 32)
    np.testing.assert_allclose(aside.depth, ahead.depth, rtol=1e-13)


@pytest.mark.parametrize("limit", ["_MOST_LISTED", "_MOST_RASTERED"])
def test_beyond_the_limits_embree_is_asked(limit: str) -> None:
    mesh = relief(2, 30)
    vertices = mesh.vertices_mm + [0, 0, 500]
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    directions = grid(64, 48, 550)
    hits = scattered(caster, np.zeros(3), directions)
    with patch.object(caster_module, limit, 10), patch.object(caster_module, "_MOST_TILED", 0):
        traced = caster.cast(np.zeros(3), directions)
        assert "_embree" in vars(caster)
    assert (traced.face == hits.face).mean() > 0.999


def test_rays_that_are_nan_in_cells() -> None:
    mesh = relief(4, 30)
    vertices = mesh.vertices_mm + [0, 0, 500]
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    directions = grid(32, 32, 275)
    whole = scattered(caster, np.zeros(3), directions)
    directions[::5] = np.nan
    hits = scattered(caster, np.zeros(3), directions)
    assert (hits.face[::5] == -1).all()
    assert np.isnan(hits.depth[::5]).all()
    rest = np.arange(len(directions)) % 5 > 0
    np.testing.assert_array_equal(hits.depth[rest], whole.depth[rest])
    directions[:] = np.nan
    assert (scattered(caster, np.zeros(3), directions).face == -1).all()
