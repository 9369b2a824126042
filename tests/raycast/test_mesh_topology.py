"""Which edges of meshes are sharp, and which are parts of a smooth surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from scenetruth.camera import Camera, Viewpoint, pixel_rays
from scenetruth.raycast import RayCaster, Topology, mixed_pixels, scene_topology
from scenetruth.raycast.edge_kernels import contour_edges, face_sides
from scenetruth.scene.mesh import make_box
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of
from tests.helpers.sampled_borders import sampled_borders

CAMERA = Camera(width=96, height=72, focal_length_px=800)
FACES = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], dtype=np.int32)


def roof(fold_deg: float) -> NDArray[np.float64]:
    """Return two rectangles that meet in an upright edge, larger than the view, bent by an angle."""
    half = np.deg2rad(fold_deg / 2)
    x, z = 80 * np.cos(half), 80 * np.sin(half)
    return np.array([[-x, -80, z], [0, -80, 0], [x, -80, z], [-x, 80, z], [0, 80, 0], [x, 80, z]]) + [0.3, 0, 660]


def mixed_of(caster: RayCaster) -> NDArray[np.bool_]:
    hits = caster.cast(np.zeros(3), pixel_rays(CAMERA).directions, CAMERA.width)
    bodies = np.where(hits.face >= 0, 0, -1).astype(np.int32).reshape(CAMERA.height, CAMERA.width)
    return mixed_pixels(caster, Viewpoint.on_axis(0.0), CAMERA, bodies)


def test_a_scene_has_one_topology() -> None:
    scene = scene_of({"texture": {"kind": "uniform"}})
    world, other = world_of(scene, ball(3, 1)), world_of(scene, ball(4, 1))
    assert scene_topology(world) is scene_topology(world)
    for each in (world, other):
        expected = Topology.of(each.at(0).vertices_mm, each.faces, each.crease_deg)
        assert all((vars(scene_topology(each))[name] == value).all() for name, value in vars(expected).items())


@pytest.mark.parametrize(
    ("crease", "sharp"),
    [
        (1.0, True),
        (9.99, True),
        (10.01, False),
        # The smaller of the two faces' angles counts.
        ([30.0, 30.0, 9.99, 9.99], True),
        ([9.99, 9.99, 30.0, 30.0], True),
        ([30.0, 30.0, 10.01, 10.01], False),
        # Of angles of their own for the sides, those of the fold count: side 1 of face 0, side 2 of face 3.
        ([[1.0, 30.0, 1.0], [1.0] * 3, [1.0] * 3, [1.0, 1.0, 30.0]], False),
        ([[30.0, 30.0, 30.0], [30.0] * 3, [30.0] * 3, [30.0, 30.0, 1.0]], True),
    ],
)
def test_a_fold_is_an_edge_if_it_exceeds_the_crease_angle(crease: float | list[Any], sharp: bool) -> None:
    points = roof(10.0)
    mixed = mixed_of(RayCaster(points, Topology.of(points, FACES, np.asarray(crease))))
    # The fold projects to x = 47.5 + 800 * 0.3 / 660 = 47.86.
    assert mixed[:, 48].all() == sharp
    assert mixed.sum() == sharp * CAMERA.height


def test_boxes_have_a_crease_angle_of_one_degree() -> None:
    mesh = make_box((1, 2, 3))
    assert mesh.crease_deg == 1.0
    np.testing.assert_array_equal(
        Topology.of(mesh.vertices_mm, mesh.faces).edge_crease_cosine, np.cos(np.deg2rad(np.full(18, 1.0)))
    )


def test_a_world_gives_every_face_the_angle_of_its_mesh() -> None:
    leaf, cube = relief(1, 5), make_box((1, 2, 3))
    world = world_of(scene_of({}, {}), leaf, cube)
    np.testing.assert_array_equal(
        world.crease_deg, np.repeat([[60.0] * 3, [1.0] * 3], [len(leaf.faces), len(cube.faces)], axis=0)
    )


def jumps_within_pixels(caster: RayCaster) -> NDArray[np.bool_]:
    """Whether a pixel sees faces without a common corner side by side, and far apart, in 16 x 16 samples."""
    fine = 16
    y, x = np.mgrid[: CAMERA.height * fine, : CAMERA.width * fine]
    points = np.stack([(x + 0.5) / fine - 0.5, (y + 0.5) / fine - 0.5], axis=-1).reshape(-1, 2)
    hits = caster.cast(np.zeros(3), CAMERA.ray_directions(points), x.shape[1])
    tiled = (CAMERA.height, fine, CAMERA.width, fine)
    face, depth = hits.face.reshape(tiled), hits.depth.reshape(tiled)
    found = np.zeros((CAMERA.height, CAMERA.width), dtype=np.bool_)
    corners = caster.topology.faces
    for axis in (1, 3):
        one, two = (np.take(face, range(k, fine - 1 + k), axis=axis) for k in (0, 1))
        step = np.abs(np.diff(depth, axis=axis))
        common = (corners[one][..., :, None] == corners[two][..., None, :]).any(axis=(-1, -2))
        found |= ((one >= 0) & (two >= 0) & ~common & (step > 2.0)).any(axis=(1, 3))
    return found


@pytest.mark.parametrize("form", ["ball", "leaf on edge"])
def test_of_smooth_surfaces_only_the_silhouette_is_mixed(form: str) -> None:
    if form == "ball":
        mesh = ball(3, 4)
        vertices = mesh.vertices_mm + [0, 0, 660]
    else:
        # Looked at along the sheet: its waves hide each other, with folds inside.
        mesh = relief(3, 40, height=0.4)
        vertices = mesh.vertices_mm[:, [0, 2, 1]] + [0, 3, 660]
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces, mesh.crease_deg))
    mixed = mixed_of(caster)
    # Depth jumps, and borders with the background, at 16 x 16 samples per pixel.
    groups = np.zeros(len(mesh.faces), dtype=np.int32)
    outline = sampled_borders(caster, CAMERA, 0.0, groups)
    assert outline.sum() > 100
    assert not (outline & ~mixed).any()
    jumps = jumps_within_pixels(caster)
    assert jumps.sum() > 20 or form == "ball"
    assert not (jumps & ~mixed).any()
    if form == "ball":
        assert not (mixed & ~binary_dilation(outline, iterations=1)).any()
    sharp = mixed_of(RayCaster(vertices, Topology.of(vertices, mesh.faces)))
    assert sharp.sum() > 1.5 * mixed.sum()


def test_the_kernel_against_a_plain_reading() -> None:
    mesh = ball(5, 2)
    generator = np.random.default_rng(1)
    faces = mesh.faces.copy()
    # Some faces inside out, and some missing.
    faces[::7] = faces[::7, ::-1]
    faces = faces[generator.uniform(size=len(faces)) > 0.1]
    topology = Topology.of(mesh.vertices_mm, faces, generator.uniform(0, 40, len(faces)))
    origin = np.array([5.0, 3.0, -90.0])
    normals, front = face_sides(mesh.vertices_mm, faces, origin)
    corners = mesh.vertices_mm[faces]
    expected = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, expected, atol=1e-14)
    np.testing.assert_array_equal(front, np.einsum("ij,ij->i", expected, origin - corners[:, 0]) > 0)
    one, two = topology.edge_faces.T
    cosine = np.einsum("ij,ij->i", normals[one], normals[two]) * np.where(topology.edge_flipped, -1, 1)
    turned = (front[one] != front[two]) != topology.edge_flipped
    plain = (two < 0) | topology.edge_crowded | turned | (cosine < topology.edge_crease_cosine)
    found = contour_edges(
        normals, front, topology.edge_faces, topology.edge_flipped, topology.edge_crowded, topology.edge_crease_cosine
    )
    np.testing.assert_array_equal(found, plain)
    assert 0.1 < plain.mean() < 0.9
    assert topology.edge_flipped.any()
    assert (two < 0).any()
