"""What is seen in passing is about what there is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.raycast import Topology
from scenetruth.resources import quick_preview
from scenetruth.resources.quick_preview import make_quick_preview, without_interior
from scenetruth.resources.workload import list_object_workloads
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.scene_models import compute_image_times
from scenetruth.scene.scene_report import check_scene, describe_scene
from scenetruth.truth import GeometryPass, interior_warnings, truth_maps
from tests.helpers.mesh_files import gltf
from tests.helpers.nightly import by_night
from tests.helpers.scenes import LIBRARY, cube, small


@pytest.mark.parametrize("file", [*LIBRARY[::2], *by_night(*LIBRARY[1::2])], ids=lambda file: file.stem)
def test_the_library_is_seen_in_passing_as_it_is(file: Path) -> None:
    scene = small(file)
    preview = make_quick_preview(scene, list_object_workloads(scene)[0])
    world = build_scene(scene)
    assert preview.left_out == []
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg), 0.0)
    maps = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), scene.stage.baseline_mm, "standard")
    covered, known = np.isfinite(maps["depth"]).mean(), np.isfinite(preview.depth).mean()
    # Of an outline in pixels that are 1.7 times as large.
    assert known == pytest.approx(covered, abs=0.03)
    exact, about = describe_scene(scene, world, maps["depth"]), describe_scene(scene, preview.world, preview.depth)
    assert about.mean_disparity_px == pytest.approx(exact.mean_disparity_px, rel=0.01)
    for one, other in zip(exact.objects, about.objects, strict=True):
        extent = one.depth_mm[1] - one.depth_mm[0]
        assert other.depth_mm == pytest.approx(one.depth_mm, abs=0.15 * extent + 0.1)


@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_places_are_those_of_the_world(file: Path) -> None:
    scene = small(file, frames__count=3)
    world = build_scene(scene)
    for t in (-1.0, 0.0, 0.3):
        found = np.concatenate([body.positions_at(t) for body in world.bodies])
        np.testing.assert_allclose(found, world.at(t).vertices_mm, rtol=1e-12, atol=1e-12)


def test_few_moments_of_many_are_looked_at_with_both_ends() -> None:
    scene = cube(frames={"count": 9_999})
    preview = make_quick_preview(scene, list_object_workloads(scene)[0])
    times = compute_image_times(scene)
    assert len(preview.times) < 400
    assert {min(times), 0.0, max(times)} <= set(preview.times) <= set(times)


def test_of_many_objects_some_are_looked_at_and_the_others_named() -> None:
    item = cube().to_dict()["objects"][0] | {"texture": {"kind": "uniform"}}
    scene = cube(objects=[item | {"name": f"cube-{number}"} for number in range(250)])
    preview = make_quick_preview(scene, list_object_workloads(scene)[0])
    assert 50 <= len(preview.world.bodies) <= 100
    assert len(preview.left_out) + len(preview.world.bodies) == 250


def plates(width_mm: float, width_px: int) -> Scene:
    """A plate before a wall."""
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 200]}}
    plate = {
        "name": "plate",
        "mesh": {"kind": "plane", "size_mm": [width_mm, 80]},
        "pose": {"position_mm": [0, 0, 150]},
    }
    uniform = {"texture": {"kind": "uniform"}}
    size = {"width": width_px, "height": width_px * 3 // 4, "focal_length_px": 1.5 * width_px}
    return cube(camera=size, objects=[wall | uniform, plate | uniform])


@pytest.mark.parametrize("width_px", [96, 640])
@pytest.mark.parametrize(("width_mm", "narrow"), [(3.0, True), (25.0, False)])
def test_objects_without_interior_are_named_as_the_truth_does(width_px: int, width_mm: float, narrow: bool) -> None:
    scene = plates(width_mm, width_px)
    margin = width_px / 12
    preview = make_quick_preview(scene, list_object_workloads(scene)[0])
    assert without_interior(preview, margin) == (["plate"] if narrow else [])
    world = build_scene(scene)
    geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg), 0.0)
    maps = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), scene.stage.baseline_mm, "standard")
    assert bool(interior_warnings(world, maps["object_id"], maps["boundary_distance"], margin)) == narrow


def test_motions_that_cannot_be_are_told() -> None:
    item = cube().to_dict()["objects"][0]
    growth = {"kind": "growth", "rate_per_hour": -1e3}
    item |= {"mesh": {"kind": "plane", "size_mm": [40, 40], "resolution_mm": 1}, "deformation": [growth]}
    scene = cube(objects=[item], frames={"count": 9, "frame_interval_s": 60})
    with pytest.raises(st.SceneError) as exact:
        build_scene(scene)
    with pytest.raises(st.SceneError) as about:
        make_quick_preview(scene, list_object_workloads(scene)[0])
    assert [problem.path for problem in about.value.problems] == [problem.path for problem in exact.value.problems]


@pytest.mark.parametrize(("comment_bytes", "left_out"), [(0, []), (3_000_000, ["cube"])])
def test_meshes_that_take_long_to_read_are_left_out(tmp_path: Path, comment_bytes: int, left_out: list[str]) -> None:
    plain = cube().to_dict()
    trimesh.creation.box((20, 20, 20)).export(tmp_path / "box.obj")
    with (tmp_path / "box.obj").open("a") as file:
        file.write("\n" + "# 45678\n" * (comment_bytes // 8))
    plain["objects"][0] |= {"name": "cube", "mesh": {"kind": "file", "file": str(tmp_path / "box.obj")}}
    scene = st.Scene.from_dict(plain)
    assert make_quick_preview(scene, list_object_workloads(scene)[0]).left_out == left_out


@pytest.mark.parametrize("bands", [(), ("red", "nir_850")], ids=["grey", "bands"])
def test_surfaces_that_send_out_more_light_than_they_receive_are_found(bands: tuple[str, ...]) -> None:
    bright = {"texture": {"kind": "uniform", "radiance": 0.9}, "material": {"transmittance": 0.5}}
    tint = {"red": 0.2, "nir_850": 1.3} if bands else 1.3
    plain = cube().to_dict()
    plain["camera"]["bands"] = list(bands)
    plain["lighting"] = {"ambient": 1}
    item = plain["objects"][0]
    texture = {"kind": "noise", "wavelength_mm": [8, 20], "mean": 0.5}
    plain["objects"] = [item | bright | {"name": "sheet"}, item | {"name": "box", "tint": tint, "texture": texture}]
    scene = st.Scene.from_dict(plain)
    preview = make_quick_preview(scene, list_object_workloads(scene)[0])
    with pytest.raises(st.SceneError) as about:
        describe_scene(scene, preview.world, preview.depth)
    with pytest.raises(st.SceneError) as exact:
        check_scene(scene, build_scene(scene))
    assert about.value.problems == exact.value.problems
    assert {problem.path for problem in about.value.problems} == {"objects.0.material.transmittance", "objects.1.tint"}


def test_large_textures_are_not_painted(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = cube(lighting={"ambient": 1}, objects=[cube().to_dict()["objects"][0] | {"tint": 1.5}])
    parts = [replace(part, painted=False) for part in list_object_workloads(scene)[0]]
    assert make_quick_preview(scene, parts).unpainted == []
    monkeypatch.setattr(quick_preview, "_QUICKLY_PAINTED", parts[0].texels - 1)
    assert make_quick_preview(scene, parts).unpainted == ["cube"]


@pytest.mark.parametrize("most_texels", [10_000_000, 0], ids=["painted", "unpainted"])
def test_materials_of_files_are_seen_with_and_without_their_texture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_texels: int
) -> None:
    monkeypatch.setattr(quick_preview, "_QUICKLY_PAINTED", most_texels)
    corners = np.array([[-28, -28, 0], [28, -28, 0], [28, 28, 0], [-28, 28, 0]], dtype=np.float32)
    arrays = {"corners": corners, "index": np.array([0, 2, 1, 0, 3, 2], dtype=np.uint16)}
    primitive = {"attributes": {"POSITION": "@corners"}, "indices": "@index", "material": 0}
    gloss = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.1}}
    (tmp_path / "plate.gltf").write_text(gltf(arrays, primitive, materials=[gloss]))
    plain = cube().to_dict()
    lamp = {"kind": "sphere", "position_mm": [0, 0, 560], "radius_mm": 25, "irradiance": 0.1}
    plain["lighting"] = {"lights": [lamp | {"reference_distance_mm": 600}]}
    mesh = {"kind": "file", "file": str(tmp_path / "plate.gltf"), "unit_mm": 1}
    plain["objects"][0] |= {"mesh": mesh, "material": {"from_file": True}, "pose": {"position_mm": [0, 0, 600]}}
    scene = st.Scene.from_dict(plain)
    preview = make_quick_preview(scene, [replace(part, painted=False) for part in list_object_workloads(scene)[0]])
    assert len(preview.unpainted) == (most_texels == 0)
    with pytest.warns(st.SceneWarning, match="wider than its distance") as simulated:
        check_scene(scene, build_scene(scene))
    expected = [str(each.message) for each in simulated if "wider" in str(each.message)]
    assert [
        text for text in describe_scene(scene, preview.world, preview.depth).warnings if "wider" in text
    ] == expected


def test_surfaces_that_begin_at_the_camera_take_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quick_preview, "_MOST_PIECES", 500)
    monkeypatch.setattr(quick_preview, "_ALL_PIECES", 2_000)
    made: list[int] = []
    cut = quick_preview._cut

    def counted(pieces: NDArray[np.float64]) -> NDArray[np.float64]:
        made.append(4 * len(pieces))
        return cut(pieces)

    monkeypatch.setattr(quick_preview, "_cut", counted)
    # Seen edge on, from a hair before the camera to far away.
    floor = np.array([[[-1e3, 1e-3, 1e-3], [1e3, 1e-3, 1e-3], [0.0, 1e3, 1e6]]])
    depth, body = quick_preview._picture([floor], cube().camera)
    assert sum(made) > 500
    assert max(made) <= 2_000
    assert depth.shape == body.shape
    assert np.isfinite(depth).any()
