"""Mixed pixels against a brute-force look at many points of every pixel's footprint."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.camera import Camera, Viewpoint, pixel_rays
from scenetruth.raycast import RayCaster, Topology, mixed_pixels, places_in_pixels
from scenetruth.scene.built_scene import build_scene
from scenetruth.truth import GeometryPass, truth_maps
from tests.helpers.nightly import nightly
from tests.helpers.sampled_borders import sampled_borders
from tests.helpers.scenes import cube


@nightly
@pytest.mark.parametrize("x_mm", [0.0, -10.0])
@pytest.mark.parametrize("distortion", [None, {"k1": -9.0, "p1": 0.05, "p2": -0.02}])
def test_against_dense_sampling_of_the_cube(x_mm: float, distortion: dict[str, float] | None) -> None:
    camera = {"width": 160, "height": 120, "focal_length_px": 1254, "principal_point_px": [79.3, 59.6]}
    scene = cube(camera=camera | {"distortion": distortion})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    geometry = GeometryPass(world, topology, 0.0)
    truth = truth_maps(geometry, scene.camera, Viewpoint.on_axis(x_mm), 5.0)
    # The two triangles of a side are one group: there is no edge between them.
    sampled = sampled_borders(geometry.caster, scene.camera, x_mm, np.arange(12, dtype=np.int32) // 2)
    mixed = truth["mixed"]
    # What sampling sees must be marked; what it misses is a corner cut by less than a sample's distance.
    # Lines that a lens bends are cut into pieces of 1/64 px: a corner cut by less may go unmarked.
    assert (sampled & ~mixed).sum() <= (0 if distortion is None else 4)
    assert (mixed & ~sampled).sum() <= 0.1 * mixed.sum()
    assert mixed.sum() > 300


def test_an_edge_along_the_border_of_two_columns_belongs_to_both() -> None:
    scene = cube()
    world = build_scene(scene)
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces), 0.0)
    mixed = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), 5.0)["mixed"]
    # The cube's front edge projects to x = 79.5 from y = 38.0 downwards.
    assert mixed[40:119, 79:81].all()
    assert not mixed[40:119, [78, 81]].any()


def test_hidden_edges_are_not_marked() -> None:
    screen = {
        "name": "screen",
        "mesh": {"kind": "plane", "size_mm": [400, 400]},
        "pose": {"position_mm": [0, 0, 500]},
        "texture": {"kind": "uniform"},
    }
    scene = cube()
    plain = scene.to_dict()
    from scenetruth.scene import Scene

    both = Scene.from_dict({**plain, "objects": [*plain["objects"], screen]})
    world = build_scene(both)
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces), 0.0)
    truth = truth_maps(geometry, both.camera, Viewpoint.on_axis(0.0), 5.0)
    assert (truth["object_id"] == 1).all()
    assert not truth["mixed"].any()


def test_bodies_that_cut_into_each_other_have_a_mixed_border() -> None:
    walls = [
        {
            "name": name,
            "mesh": {"kind": "plane", "size_mm": [900, 900]},
            "pose": {"position_mm": [0, 0, 660], "rotations": [{"axis": [0, 1, 0], "angle_deg": angle}]},
            "texture": {"kind": "uniform"},
        }
        for name, angle in (("left", 20), ("right", -20))
    ]
    scene = cube(objects=walls)
    world = build_scene(scene)
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces), 0.0)
    truth = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), 5.0)
    changes = np.diff(truth["object_id"], axis=1) != 0
    assert (changes.sum(axis=1) == 1).all()
    beside = truth["mixed"][:, :-1] | truth["mixed"][:, 1:]
    assert beside[changes].all()
    assert truth["mixed"].sum() == 2 * scene.camera.height


def test_edges_that_run_behind_the_camera_are_cut() -> None:
    vertices = np.array([[-5.0, 10, -50], [5, 10, -50], [5, 10, 300], [-5, 10, 300]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    camera = Camera(width=64, height=64, focal_length_px=100)
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    directions = camera.ray_directions(camera.pixel_grid()).reshape(-1, 3)
    bodies = np.where(caster.cast(np.zeros(3), directions, 64).face >= 0, 0, -1).reshape(64, 64)
    mixed = mixed_pixels(caster, Viewpoint.on_axis(0.0), camera, bodies.astype(np.int32))
    # A road that narrows to its far end: two borders in every row that shows it.
    rows = np.flatnonzero((bodies >= 0).any(axis=1))
    assert len(rows) > 20
    assert mixed[rows].any(axis=1).all()
    assert mixed.sum() < 6 * len(rows) + 10


@pytest.mark.parametrize("distortion", [None, {"k1": -9.0, "p1": 0.05, "p2": -0.02}])
def test_places_in_pixels_are_those_of_rays(distortion: dict[str, float] | None) -> None:
    camera = Camera(width=64, height=48, focal_length_px=1254, principal_point_px=(30.3, 25.6), distortion=distortion)
    rays, generator = pixel_rays(camera), np.random.default_rng(3)
    across, down = (np.broadcast_to(item, rays.directions.shape) for item in rays.steps)
    pixels = np.sort(generator.integers(0, 64 * 48, 200))
    offsets, depths = generator.uniform(-9, 9, (200, 2, 2)), generator.uniform(100, 900, (200, 2))
    depths[::5] *= -1
    steps = offsets[..., :1] * across[pixels, None] + offsets[..., 1:] * down[pixels, None]
    points = depths[..., None] * (rays.directions[pixels, None] + steps)
    multiples, places = places_in_pixels(rays.directions, rays.steps, 64, pixels, points)
    np.testing.assert_allclose(multiples, depths, rtol=1e-12)
    # Positions of up to 64 px in float64, from directions with 1e-16 of a focal length.
    np.testing.assert_allclose(places, offsets, rtol=0, atol=1e-11)
