"""Ray casting against an independent float64 test of every triangle, and the faces that Embree guesses."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

from scenetruth.raycast import Hits, RayCaster, Topology, ray_caster
from scenetruth.raycast import ray_caster as caster_module
from scenetruth.raycast.ray_caster import EmbreeMesh
from scenetruth.scene.mesh import make_box
from tests.helpers.boxes_and_rays import boxes, brute_force, grid


@pytest.mark.parametrize("most_rastered", [100_000, 0], ids=["raster", "embree"])
@settings(max_examples=40, deadline=None)
@given(seed=some.integers(0, 10_000), distance=some.floats(150, 2000), count=some.integers(1, 12))
def test_boxes_in_any_pose_against_brute_force(most_rastered: int, seed: int, distance: float, count: int) -> None:
    generator = np.random.default_rng(seed)
    points, triangles = boxes(generator, count, distance)
    caster = RayCaster(points, Topology.of(points, triangles))
    origin = np.array([generator.uniform(-20, 20), 0, 0])
    directions = grid(64, 48, 0.4 * distance)
    with patch.object(caster_module, "_MOST_RASTERED", most_rastered):
        hits = caster.cast(origin, directions, grid_width=64)
    expected, doubt = brute_force(points, triangles, origin, directions)
    met = np.isfinite(expected)
    # Where a ray passes an edge within rounding, both answers are right.
    sure = doubt > 1e-10
    assert ((hits.face >= 0) == met)[sure].all()
    both = met & sure
    np.testing.assert_allclose(hits.depth[both], expected[both], rtol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=some.integers(0, 10_000), tilt=some.floats(0, 3.1), bend=some.floats(0, 0.3))
def test_rastered_and_traced_grids_are_the_same_to_the_bit(seed: int, tilt: float, bend: float) -> None:
    generator = np.random.default_rng(seed)
    points, triangles = boxes(generator, 8, 300.0)
    turn = Rotation.from_rotvec(tilt * generator.normal(size=3) / 2).as_matrix()
    directions = grid(53, 41, 110)
    # A lens that bends lines, and rays of any length.
    directions[:, :2] *= 1 + bend * (directions[:, :2] ** 2).sum(axis=1, keepdims=True)
    directions *= generator.uniform(0.5, 2, (len(directions), 1))
    caster = RayCaster(points @ turn.T, Topology.of(points, triangles))
    origin = turn @ generator.uniform(-20, 20, 3)
    rastered = caster.cast(origin, directions @ turn.T, grid_width=53)
    with patch.object(caster_module, "_MOST_RASTERED", 0):
        traced = caster.cast(origin, directions @ turn.T, grid_width=53)
    same = rastered.face == traced.face
    # Embree may miss slivers that float32 cannot tell from nothing.
    assert (~same).sum() <= 1
    assert (rastered.face >= 0).sum() > 50
    np.testing.assert_array_equal(rastered.depth[same], traced.depth[same])
    np.testing.assert_array_equal(rastered.weights[same], traced.weights[same])


@settings(max_examples=30, deadline=None)
@given(seed=some.integers(0, 10_000))
def test_faces_around_and_behind_the_eye_against_brute_force(seed: int) -> None:
    generator = np.random.default_rng(seed)
    # Triangles on all sides, many across the plane of the eye.
    points = generator.normal(size=(30, 3)) * [40, 40, 60]
    triangles = np.arange(30, dtype=np.int32).reshape(10, 3)
    directions = grid(61, 47, 12)  # 136 degrees across
    hits = RayCaster(points, Topology.of(points, triangles)).cast(np.zeros(3), directions, grid_width=61)
    expected, doubt = brute_force(points, triangles, np.zeros(3), directions)
    sure = doubt > 1e-10
    assert ((hits.face >= 0) == np.isfinite(expected))[sure].all()
    both = np.isfinite(expected) & sure
    np.testing.assert_allclose(hits.depth[both], expected[both], rtol=1e-10)


def test_grids_that_look_all_around_are_traced() -> None:
    mesh = make_box((40, 50, 60))
    around = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    directions = np.stack([np.sin(around), np.zeros(360), np.cos(around)], axis=-1)
    hits = RayCaster(mesh.vertices_mm, Topology.of(mesh.vertices_mm, mesh.faces)).cast(np.zeros(3), directions, 360)
    expected = np.minimum(20 / np.maximum(np.abs(np.sin(around)), 1e-9), 30 / np.maximum(np.abs(np.cos(around)), 1e-9))
    np.testing.assert_allclose(hits.depth, expected, rtol=1e-12)


def test_rays_that_are_nan_meet_nothing_and_spoil_no_others() -> None:
    mesh = make_box((40, 40, 40))
    vertices = mesh.vertices_mm + [0, 0, 300]
    directions = grid(32, 32, 300)
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    whole = caster.cast(np.zeros(3), directions, 32)
    directions[::7] = np.nan
    hits = caster.cast(np.zeros(3), directions, 32)
    assert (hits.face[::7] == -1).all()
    rest = np.ones(len(directions), dtype=bool)
    rest[::7] = False
    np.testing.assert_array_equal(hits.depth[rest], whole.depth[rest])


def test_rays_exactly_at_shared_edges_and_vertices_never_slip_through() -> None:
    # A fan of triangles whose inner edges and centre lie exactly on pixel centres.
    angles = np.arange(8) * np.pi / 4
    rim = np.column_stack([np.cos(angles), np.sin(angles)]).round(12) * 16
    vertices = np.column_stack([np.vstack([[0, 0], rim]), np.full(9, 32.0)])
    faces = np.array([[0, 1 + n, 1 + (n + 1) % 8] for n in range(8)], dtype=np.int32)
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    steps = np.arange(-8, 9)
    x, y = np.meshgrid(steps, steps)
    directions = np.stack([x / 32, y / 32, np.ones_like(x)], axis=-1).reshape(-1, 3)
    hits = caster.cast(np.zeros(3), directions, grid_width=len(steps))
    assert (hits.face >= 0).all()
    np.testing.assert_allclose(hits.depth, 32, rtol=1e-15)


def test_interpolation_is_exact_for_affine_functions_of_position() -> None:
    vertices = np.array([[-30.0, -20, 90], [40, -25, 110], [35, 30, 130], [-28, 33, 105]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    directions = grid(32, 32, 80)
    hits = caster.cast(np.zeros(3), directions, grid_width=32)
    seen = hits.face >= 0
    assert seen.sum() > 300
    points = directions * hits.depth[:, None]
    np.testing.assert_allclose(hits.interpolate(faces, vertices)[seen], points[seen], atol=1e-12)
    assert np.isnan(hits.interpolate(faces, vertices)[~seen]).all()


def test_the_nearest_of_two_faces_that_cut_into_each_other_wins() -> None:
    one = np.array([[-50.0, -50, 90], [50, -50, 110], [50, 50, 110], [-50, 50, 90]])
    two = np.array([[-50.0, -50, 110], [50, -50, 90], [50, 50, 90], [-50, 50, 110]])
    vertices = np.concatenate([one, two])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], dtype=np.int32)
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    directions = grid(51, 41, 70)
    hits = caster.cast(np.zeros(3), directions, grid_width=51)
    slope = directions[:, 0] * 0.2
    expected = np.minimum(100 / (1 - slope), 100 / (1 + slope))
    np.testing.assert_allclose(hits.depth, expected, rtol=1e-13)


@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_far_from_the_origin_of_the_world(shift: float) -> None:
    mesh = make_box((40, 40, 40))
    vertices = mesh.vertices_mm + [shift, 0, 300]
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    hits = caster.cast(np.array([shift, 0.0, 0.0]), grid(64, 64, 300), grid_width=64)
    seen = hits.face >= 0
    # The front face spans 40 / 280 * 300 = 42.86 px: 42 pixel centres.
    assert seen.sum() == 42 * 42
    np.testing.assert_allclose(hits.depth[seen], 280, atol=1e-11 * (1 + shift))


def test_sides_are_those_of_each_origin() -> None:
    box = make_box((2, 2, 2))
    caster = RayCaster(box.vertices_mm, Topology.of(box.vertices_mm, box.faces))
    for origin in (np.array([0.0, 0.0, -9.0]), np.array([0.0, 0.0, 9.0]), np.zeros(3)):
        normals, front = caster.sides(origin)
        # Sides towards a point outside of the box, and none from its centre.
        np.testing.assert_array_equal(front, normals @ origin > 1)
        np.testing.assert_allclose(normals, caster.face_normals, atol=1e-15)


def test_covered_rays_are_counted_as_areas() -> None:
    from scenetruth.raycast.raster_kernels import count_covered

    grid, infinite = np.array([-1.0, 0.5, 2.0, -0.25]), np.inf
    boxes = np.array(
        [
            [-1.0, 0.0, 1.0, 1.5],
            [-9.0, -0.5, 0.0, 9.0],
            [-infinite, infinite, -infinite, infinite],
            [1.0, -1.0, 0.0, 1.0],
        ]
    )
    # Columns from -1 to 9 in 20 steps, rows from 2 down to 0 in 8.
    assert count_covered(boxes[:1], grid, 20, 8) == pytest.approx(2 * 2)
    assert count_covered(boxes[1:2], grid, 20, 8) == pytest.approx(1 * 8)
    assert count_covered(boxes[2:3], grid, 20, 8) == pytest.approx(20 * 8)
    assert count_covered(boxes[3:], grid, 20, 8) == 0
    assert count_covered(boxes, grid, 20, 8) == pytest.approx(4 + 8 + 160)


def test_topology_of_a_box() -> None:
    mesh = make_box((1, 2, 3))
    topology = Topology.of(mesh.vertices_mm, mesh.faces)
    assert len(topology.edges) == 18  # Euler: V - E + F = 2 with 8 vertices and 12 faces
    assert (topology.edge_faces >= 0).all()
    assert not topology.edge_flipped.any()
    assert not topology.edge_crowded.any()
    for face, neighbours in enumerate(topology.face_neighbours):
        for neighbour in neighbours:
            assert face in topology.face_neighbours[neighbour]
            assert len(set(mesh.faces[face]) & set(mesh.faces[neighbour])) == 2


def test_topology_welds_vertices_at_texture_seams() -> None:
    mesh = make_box((1, 2, 3))
    split = mesh.vertices_mm[mesh.faces].reshape(-1, 3)
    faces = np.arange(len(split), dtype=np.int32).reshape(-1, 3)
    welded, plain = Topology.of(split, faces), Topology.of(mesh.vertices_mm, mesh.faces)
    assert len(welded.edges) == len(plain.edges)
    assert (np.sort(welded.face_neighbours, axis=1) == np.sort(plain.face_neighbours, axis=1)).all()


def test_boxes_are_wound_outwards() -> None:
    mesh = make_box((1, 2, 3))
    corners = mesh.vertices_mm[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1)) > 0).all()


@pytest.mark.parametrize("shape", [(), (1,), (2,), (2, 3)])
def test_interpolation_against_a_plain_reading(shape: tuple[int, ...]) -> None:
    generator = np.random.default_rng(2)
    faces = generator.integers(0, 50, (30, 3)).astype(np.int32)
    face = generator.integers(-1, 30, 400).astype(np.int32)
    weights = generator.dirichlet([1, 1, 1], 400)[:, 1:]
    hits = Hits(face, np.ones(400), weights)
    values, corners = generator.normal(size=(50, *shape)), generator.normal(size=(30, 3, *shape))
    b1, b2 = (weights[:, k].reshape(-1, *[1] * len(shape)) for k in range(2))
    for corner_values, found in (
        (values[faces[face]], hits.interpolate(faces, values)),
        (corners[face], hits.interpolate_corners(corners)),
    ):
        first, second, third = (corner_values[:, k] for k in range(3))
        expected = first + b1 * (second - first) + b2 * (third - first)
        expected[face < 0] = np.nan
        np.testing.assert_array_equal(found, expected)
    # What all corners share comes out unchanged.
    assert (hits.interpolate(faces, np.full((50, *shape), 0.1))[face >= 0] == 0.1).all()


# Two squares across Z, far from the origin: the near one covers a part of the far one.
VERTICES = np.array(
    [[-9, -9, 50], [0, -9, 50], [0, 9, 50], [-9, 9, 50], [-20, -20, 80], [20, -20, 80], [20, 20, 80], [-20, 20, 80]],
    dtype=np.float64,
) + np.array([1e4, 0, 0])
FACES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], dtype=np.int32)
START = np.array([1e4, 0.0, 0.0])
DIRECTIONS = np.array([[-3.0, -6.0, 50.0], [-6.0, 3.0, 50.0], [5.0, 1.0, 80.0], [30.0, 0.0, 50.0]])


def test_the_nearest_face_is_found_from_one_start_and_from_many() -> None:
    mesh = EmbreeMesh(VERTICES, FACES)
    expected = [0, 1, 2, -1]
    assert mesh.first_faces(START, DIRECTIONS).tolist() == expected
    assert mesh.first_faces(np.tile(START, (4, 1)), DIRECTIONS).tolist() == expected
    # From behind, the far square is met first.
    behind = mesh.first_faces(START + 2 * DIRECTIONS[:3], -DIRECTIONS[:3])
    assert (behind >= 2).all()


def test_pieces_give_what_all_rays_at_once_give() -> None:
    mesh = EmbreeMesh(VERTICES, FACES)
    with patch.object(ray_caster, "_PIECE", 3):
        assert mesh.first_faces(START, DIRECTIONS).tolist() == [0, 1, 2, -1]
