"""The kernel that writes all maps against the same maps in plain NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Camera, Distortion, Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene.built_scene import build_scene
from scenetruth.truth import GeometryPass, truth_maps
from tests.helpers.scenes import cube


def plain_maps(
    geometry: GeometryPass, camera: Camera, viewpoint: Viewpoint, baseline: float
) -> dict[str, NDArray[Any]]:
    directions = camera.ray_directions(camera.pixel_grid()).reshape(-1, 3)
    in_world = viewpoint.directions_to_world(directions)
    hits = geometry.caster.cast(viewpoint.position_mm, in_world, grid_width=camera.width)
    world, depth, seen = geometry.world, hits.depth, hits.face >= 0
    velocity = viewpoint.directions_to_camera(hits.interpolate(world.faces, geometry.snapshot.velocities))
    rates = (velocity[:, :2] - directions[:, :2] * velocity[:, 2:]) / depth[:, None]
    corners = geometry.snapshot.vertices_mm[world.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normals[hits.face] / np.linalg.norm(normals[hits.face], axis=1, keepdims=True)
    normal *= -np.sign(np.einsum("ij,ij->i", normal, in_world))[:, None]
    normal[~seen] = np.nan
    body = world.face_body[hits.face]
    maps = {
        "depth": depth,
        "velocity": velocity.T,
        "disparity": camera.focal_px * baseline / depth,
        "flow": camera.compute_flow(directions, rates).T,
        "normal": viewpoint.directions_to_camera(normal).T,
        "object_id": np.where(seen, body, -1),
        "face_id": np.where(seen, hits.face - world.face_offsets[body], -1),
    }
    return {name: values.reshape(*values.shape[:-1], camera.height, camera.width) for name, values in maps.items()}


@pytest.mark.parametrize("distortion", [None, Distortion(k1=-8.0, p1=0.1)], ids=["pinhole", "lens"])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.02, -0.015, 0.4)], ids=["straight", "turned"])
def test_maps_are_those_of_plain_numpy(distortion: Distortion | None, turn: tuple[float, float, float]) -> None:
    scene = cube()
    screen = {
        "name": "screen",
        "mesh": {"kind": "plane", "size_mm": [400, 60]},
        "pose": {"position_mm": [0, 0, 800]},
        "texture": {"kind": "uniform"},
        "motion": [{"kind": "rotation", "axis": [0, 1, 0], "rate_deg_per_frame": 2}],
    }
    from scenetruth.scene import Scene

    plain = scene.to_dict()
    world = build_scene(Scene.from_dict({**plain, "objects": [*plain["objects"], screen]}))
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces), 1.5)
    camera = scene.camera.model_copy(update={"distortion": distortion})
    viewpoint = Viewpoint(np.array([3.0, -1.0, 2.0]), Rotation.from_rotvec(turn).as_matrix())
    found, expected = truth_maps(geometry, camera, viewpoint, 5.0), plain_maps(geometry, camera, viewpoint, 5.0)
    assert set(np.unique(found["object_id"])) == {-1, 0, 1}
    for name, values in expected.items():
        assert found[name].dtype == (np.int32 if name.endswith("_id") else np.float64)
        # Rotations before or after interpolation round differently: a few units of 1e-16 of the largest value.
        np.testing.assert_allclose(found[name], values, rtol=1e-13, atol=1e-13, err_msg=name)
    # A velocity that all corners share comes out to the bit.
    if not any(turn):
        assert (found["velocity"][:, found["object_id"] == 0] == [[0.1], [-0.05], [-1.0]]).all()
