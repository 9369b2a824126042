"""Mesh files: which of their edges are edges of the object, and the normals that light falls on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.errors import SceneError
from scenetruth.raycast import Topology
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.mesh import load_mesh_file, make_box, make_sphere
from scenetruth.scene.scene_report import describe_scene
from scenetruth.truth import GeometryPass, truth_maps
from tests.helpers.ball_mesh import DISTANCE, RADIUS, Floats, ball, write
from tests.helpers.nightly import nightly
from tests.helpers.scenes import cube


def scene_with(file: Path, mesh: dict[str, Any] | None = None, **changes: Any) -> st.Scene:
    item = {
        "name": "thing",
        "mesh": {"kind": "file", "file": str(file), **(mesh or {})},
        "pose": {"position_mm": [0, 0, DISTANCE]},
        "texture": {"kind": "uniform", "radiance": 1.0},
        "motion": changes.pop("motion", []),
    }
    render = {"backend": "raycast", "supersampling": 1}
    return cube(objects=[item], render=render, frames={"count": 1}, **changes)


def maps_of(scene: st.Scene, world: BuiltScene | None = None) -> dict[str, NDArray[Any]]:
    world = world or build_scene(scene)
    geometry = GeometryPass(world, Topology.of(world.at(0.0).vertices_mm, world.faces, world.crease_deg), 0.0)
    return truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), scene.stage.baseline_mm)


def test_a_curved_file_has_no_mixed_pixels_inside(tmp_path: Path) -> None:
    files = [ball(tmp_path / f"plain.{form}", normals=False) for form in ("obj", "stl")]
    files += [ball(tmp_path / f"own.{form}", normals=True) for form in ("obj", "ply", "glb")]
    for file in files:
        scene = scene_with(file)
        maps = maps_of(scene)
        away = np.hypot(*np.moveaxis(scene.camera.pixel_grid() - scene.camera.principal_point, -1, 0))
        inside = away < 0.9 * RADIUS * scene.camera.focal_px / DISTANCE
        assert maps["mixed"].any()
        assert not maps["mixed"][inside].any(), file
        # As sharp as files once were, its facets are edges.
        assert maps_of(scene_with(file, {"crease_deg": 1.0}))["mixed"][inside].mean() > 0.2
        # The smooth surface bulges by 1 / R; where facets were edges, it was flat.
        curvature = maps["curvature"][:, inside]
        np.testing.assert_allclose(curvature, 1 / RADIUS, rtol=0.2)


@pytest.mark.parametrize("own", [None, "split", "averaged"])
def test_a_box_keeps_its_edges(tmp_path: Path, own: str | None) -> None:
    mesh = make_box((30, 30, 30))
    corners = mesh.vertices_mm[mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    normals = {
        None: None,
        "split": np.repeat(flat[:, None], 3, axis=1),
        "averaged": corners / np.linalg.norm(corners, axis=2, keepdims=True),
    }[own]
    loaded = load_mesh_file(write(tmp_path / "box.obj", mesh.vertices_mm, mesh.faces, normals))
    topology = Topology.of(loaded.vertices_mm, loaded.faces, loaded.crease_deg)
    one, two = topology.edge_faces.T
    cosine = np.einsum("ij,ij->i", flat[one], flat[two])
    sharp = cosine < topology.edge_crease_cosine
    # Twelve edges; the diagonals of the six sides are none.
    assert sharp.sum() == 12
    np.testing.assert_array_equal(sharp, cosine < 0.5)


def test_normals_of_the_truth_stay_those_of_the_triangles(tmp_path: Path) -> None:
    scene = scene_with(ball(tmp_path / "ball.obj", normals=True))
    world, maps = build_scene(scene), maps_of(scene)
    corners = world.at(0.0).vertices_mm[world.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    seen = maps["face_id"] >= 0
    expected = flat[maps["face_id"][seen]]
    np.testing.assert_allclose(np.abs(np.einsum("ij,ji->i", expected, maps["normal"][:, seen])), 1, atol=1e-12)


def fold(angle_deg: float) -> tuple[Floats, NDArray[np.int32], Floats]:
    """Return two triangles that meet at an angle, and the normals of each at its corners."""
    angle = np.deg2rad(angle_deg)
    vertices = np.array([[0, 0, 0], [0, 10, 0], [-10, 0, 0], [10 * np.cos(angle), 0, 10 * np.sin(angle)]])
    faces = np.array([[0, 1, 2], [1, 0, 3]], dtype=np.int32)
    normals = np.array([[0, 0, 1.0], [-np.sin(angle), 0, np.cos(angle)]])
    return vertices, faces, np.repeat(normals[:, None], 3, axis=1)


def creases(file: Path, crease_deg: float | None = None) -> Floats:
    mesh = load_mesh_file(file, crease_deg=crease_deg)
    return np.broadcast_to(mesh.crease_deg, mesh.faces.shape)


def test_the_files_own_normals_decide(tmp_path: Path) -> None:
    vertices, faces, flat = fold(20.0)
    common = np.broadcast_to([0.0, 0.0, 1.0], flat.shape).copy()
    # Faces at 20°: an edge if the normals jump, smooth if they are the same.
    assert creases(write(tmp_path / "flat.obj", vertices, faces, flat))[0, 0] == 0
    assert creases(write(tmp_path / "common.obj", vertices, faces, common))[0, 0] == 60
    # A normal that jumps at one end of the edge is enough; elsewhere, it says nothing of this edge.
    for corner, sharp in ((0, True), (1, True), (2, False)):
        bent = common.copy()
        bent[1, corner] = flat[1, 0]
        found = creases(write(tmp_path / "bent.obj", vertices, faces, bent))
        assert (found[0, 0] == 0, found[1, 0] == 0) == (sharp, sharp)
    # The scene has the last word.
    assert (creases(tmp_path / "flat.obj", 30.0) == 30.0).all()
    assert load_mesh_file(tmp_path / "flat.obj", crease_deg=30.0).corner_normals is None
    # An inside-out neighbour has normals of the other sense.
    turned = common.copy()
    turned[1] *= -1
    assert creases(write(tmp_path / "turned.obj", vertices, faces[:, ::-1], turned))[0, 1] == 60


def test_normals_that_are_none_leave_it_to_the_angle(tmp_path: Path) -> None:
    for angle, expected in ((20.0, False), (80.0, True)):
        vertices, faces, flat = fold(angle)
        for bad in (0.0, np.nan):
            broken = flat.copy()
            broken[1] = bad
            mesh = load_mesh_file(write(tmp_path / "broken.obj", vertices, faces, broken))
            assert mesh.corner_normals is not None
            assert np.isnan(mesh.corner_normals[1]).all()
            np.testing.assert_allclose(mesh.corner_normals[0], flat[0], atol=1e-6)
            topology = Topology.of(mesh.vertices_mm, mesh.faces, mesh.crease_deg)
            inner = (topology.edge_faces >= 0).all(axis=1)
            assert (np.cos(np.deg2rad(angle)) < topology.edge_crease_cosine[inner]).tolist() == [expected]


def test_normals_turn_with_the_nodes_of_a_gltf_scene(tmp_path: Path) -> None:
    mesh = make_sphere(RADIUS, 8.0)
    part = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, vertex_normals=mesh.vertices_mm / RADIUS, process=False)
    scene = trimesh.Scene()
    stretched = np.diag([1.0, 2.0, 1.0, 1.0])
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    scene.add_geometry(part, transform=turned @ stretched)
    (tmp_path / "turned.glb").write_bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=True))
    loaded = load_mesh_file(tmp_path / "turned.glb")
    assert loaded.corner_normals is not None
    # Of the ellipsoid (x / R)² + (y / 2R)² + (z / R)² = 1.
    straight = loaded.vertices_mm[loaded.faces] @ turned[:3, :3]
    expected = straight / [1.0, 4.0, 1.0]
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    np.testing.assert_allclose(loaded.corner_normals @ turned[:3, :3], expected, atol=1e-5)


@pytest.mark.parametrize("form", ["ply", "glb", "off"])
def test_vertices_that_no_face_uses_count_nowhere(tmp_path: Path, form: str) -> None:
    """One lies far behind the camera, one between those that are used: neither is seen, nor grows."""
    mesh = make_sphere(RADIUS, 8.0)
    half = len(mesh.vertices_mm) // 2
    before, after = np.split(mesh.vertices_mm, [half])
    stray = np.concatenate([before, [[0, 0, 0]], after, [[9e3, 0, -5e3]]])
    faces = mesh.faces + (mesh.faces >= half)
    reports, bodies = [], []
    for name, vertices, used in (("whole", mesh.vertices_mm, mesh.faces), ("stray", stray, faces)):
        scene = scene_with(write(tmp_path / f"{name}.{form}", vertices, used))
        plain = scene.to_dict()
        plain["objects"][0]["deformation"] = [{"kind": "growth", "rate_per_hour": 0.5, "base_to_tip": [0, 1]}]
        scene = st.Scene.from_dict(plain)
        world = build_scene(scene)
        reports.append(describe_scene(scene, world, np.full((2, 2), DISTANCE)))
        bodies.append(world.bodies[0])
    # But for the number of vertices of the file.
    assert [replace(one, content=()) for one in reports[0].objects] == [
        replace(one, content=()) for one in reports[1].objects
    ]
    assert replace(reports[0], objects=()) == replace(reports[1], objects=())
    np.testing.assert_array_equal(bodies[0].positions_at(1.0), bodies[1].positions_at(1.0))
    np.testing.assert_array_equal(bodies[0].uv, bodies[1].uv)
    assert bodies[1].mesh.with_all_nodes.vertices_mm == pytest.approx(stray, rel=1e-6)


@pytest.mark.parametrize("angle", [0, 181, "sharp"])
def test_impossible_crease_angles_are_refused(tmp_path: Path, angle: Any) -> None:
    with pytest.raises(SceneError, match=r"objects\.0\.mesh\.crease_deg"):
        scene_with(ball(tmp_path / "ball.obj", 8.0, normals=False), {"crease_deg": angle})


def lambert(scene: st.Scene, to_light: Floats) -> tuple[Floats, Floats]:
    """Return the exact shade of the sphere at pixel centres, and the cosine of the angle at which it is seen."""
    ray = scene.camera.ray_directions(scene.camera.pixel_grid().reshape(-1, 2))
    a, b = np.einsum("ij,ij->i", ray, ray), ray[:, 2] * DISTANCE
    root = b**2 - a * (DISTANCE**2 - RADIUS**2)
    with np.errstate(invalid="ignore"):
        normal = (ray * ((b - np.sqrt(root)) / a)[:, None] - [0, 0, DISTANCE]) / RADIUS
    facing = -np.einsum("ij,ij->i", normal, ray) / np.sqrt(a)
    shape = (scene.camera.height, scene.camera.width)
    return np.maximum(normal @ to_light, 0).reshape(shape), facing.reshape(shape)


@nightly
@pytest.mark.parametrize("normals", [False, True], ids=["without normals", "with its own normals"])
def test_light_on_a_smooth_file_is_lamberts_to_second_order(tmp_path: Path, normals: bool) -> None:
    to_light = np.array([-2.0, -1.0, -1.0]) / np.sqrt(6)
    sun = {"kind": "directional", "direction": (-to_light).tolist(), "irradiance": 1.0}
    turn = [{"kind": "rotation", "axis": [1, 1, 0], "rate_deg_per_frame": 25.0}]
    worst: list[float] = []
    flat: list[float] = []
    for resolution in (4.0, 2.0, 1.0):
        file = ball(tmp_path / f"ball_{resolution}.obj", resolution, normals=normals)
        for mesh, figures in (({}, worst), ({"crease_deg": 0.01}, flat)):
            scene = scene_with(file, mesh, lighting={"lights": [sun], "shadows": True}, motion=turn)
            with RaycastRenderer(build_scene(scene), scene.camera, 0.0, 1, scene.lighting) as renderer:
                # The mesh has turned: its normals with it.
                image = renderer.render(1.0, Viewpoint.on_axis(0.0)).astype(np.float64)
            exact, facing = lambert(scene, to_light)
            seen = np.nan_to_num(facing) > 0.5
            error = np.abs(image - exact)
            # The terminator and what is dark too: no steps of facets that their neighbours shade.
            figures.append(error[seen].max())
    assert worst[-1] < 5e-4
    assert np.log2(worst[0] / worst[-1]) / 2 > 1.8
    # Facets err at first order.
    assert 0.5 < np.log2(flat[0] / flat[-1]) / 2 < 1.3
    assert flat[-1] > 50 * worst[-1]


@pytest.mark.parametrize("form", ["obj", "ply", "stl", "off"])
def test_a_file_that_another_program_writes_is_read_when_it_is_whole(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = ball(tmp_path / f"ball.{form}", 20.0, normals=False)
    expected, content = load_mesh_file(file), file.read_bytes()
    count = 0
    read = Path.read_bytes

    def changed(path: Path) -> bytes:
        nonlocal count
        count += 1
        found = read(path)
        if count <= most:
            # The first half, as a writer leaves it in between.
            path.write_bytes(content[: len(content) // 2 + count])
            return read(path)
        if found != content:
            path.write_bytes(content)
        return found

    most = 1
    monkeypatch.setattr(Path, "read_bytes", changed)
    np.testing.assert_array_equal(load_mesh_file(file).vertices_mm, expected.vertices_mm)
    assert count == 3
    count, most = 0, 100
    with pytest.raises(SceneError, match=rf"ball\.{form} changes while it is read: wait until") as caught:
        load_mesh_file(file)
    assert len(caught.value.problems) == 1


def test_a_file_that_disappears_while_it_is_counted_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = ball(tmp_path / "ball.obj", 20.0, normals=False)
    opened = Path.open

    def missing(path: Path, *args: Any, **keywords: Any) -> Any:
        path.unlink(missing_ok=True)
        return opened(path, *args, **keywords)

    monkeypatch.setattr(Path, "open", missing)
    mesh = st.Scene.from_dict(scene_with(file).to_dict()).objects[0].mesh
    with pytest.raises(SceneError, match=r"no such mesh file"):
        mesh.size(Path())
