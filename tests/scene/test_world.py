"""Meshes and textures made real, from primitives and from files."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh.mesh_file import load_mesh_file
from scenetruth.scene.mesh.solids import make_box
from scenetruth.scene.scene_report import check_scene, describe_scene
from tests.scenes import SCENES, cube


def with_object(**changes: Any) -> st.Scene:
    item = cube().to_dict()["objects"][0]
    return cube(objects=[{**item, **changes}])


def ball(file: Path, **export: Any) -> Path:
    trimesh.creation.icosphere(subdivisions=2, radius=20.0).export(file, **export)
    return file


@pytest.mark.parametrize("form", ["obj", "ply", "glb", "stl"])
def test_mesh_files_give_the_same_depth(tmp_path: Path, form: str) -> None:
    scene = with_object(mesh={"kind": "file", "file": str(ball(tmp_path / f"ball.{form}"))}, motion=[])
    _, truth = st.simulate(scene.model_copy(update={"frames": scene.frames.model_copy(update={"count": 1})}))
    depth = truth["depth"].values[0]
    # The icosphere's vertices lie on the sphere of 20 mm; facets of 0.16 rad at its limb reach a bit farther.
    assert np.nanmin(depth) == pytest.approx(692.56 - 20, abs=0.4)
    assert np.nanmax(depth) == pytest.approx(692.56, abs=20 * 0.16)


def test_mesh_units() -> None:
    one = make_box((1, 1, 1))
    assert np.ptp(one.vertices_mm, axis=0).tolist() == [1, 1, 1]


def test_mesh_unit_mm_scales(tmp_path: Path) -> None:
    file = ball(tmp_path / "ball.ply")
    np.testing.assert_allclose(load_mesh_file(file, 2.0).vertices_mm, 2 * load_mesh_file(file).vertices_mm)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such mesh file"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces|cannot be read as a mesh"),
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "vertices that are not finite"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "has only faces of zero area"),
        ("this is not a mesh", "has no faces|cannot be read as a mesh"),
    ],
)
def test_bad_mesh_files(tmp_path: Path, content: str | None, message: str) -> None:
    file = tmp_path / "mesh.obj"
    if content is not None:
        file.write_text(content)
    scene = with_object(mesh={"kind": "file", "file": str(file)})
    with pytest.raises(st.SceneError, match=r"objects\.0\.mesh\.file: ") as caught:
        build_scene(scene)
    assert caught.match(message)


def textured_square(folder: Path) -> Path:
    """Write an OBJ square with its own texture: bright in the upper left quarter of the image."""
    picture = np.full((32, 32, 3), 51, dtype=np.uint8)
    picture[:16, :16] = 204
    imageio.imwrite(folder / "paint.png", picture)
    (folder / "square.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    (folder / "square.obj").write_text(
        "mtllib square.mtl\nusemtl paint\n"
        # Corners upper left, upper right, lower right, lower left, with v = 1 in the image's first row.
        "v -20 -20 0\nv 20 -20 0\nv 20 20 0\nv -20 20 0\nvt 0 1\nvt 1 1\nvt 1 0\nvt 0 0\nf 1/1 4/4 3/3\nf 1/1 3/3 2/2\n"
    )
    return folder / "square.obj"


@pytest.mark.parametrize("backend", ["raycast", "pyrender"])
@pytest.mark.parametrize("source", ["own", "own glb", "given", "plane"])
def test_image_textures_stand_upright(tmp_path: Path, backend: str, source: str) -> None:
    file = textured_square(tmp_path)
    texture: dict[str, Any] = (
        {"kind": "embedded"} if source == "own" else {"kind": "image", "file": str(tmp_path / "paint.png")}
    )
    mesh: dict[str, Any] = {"kind": "file", "file": str(file)}
    if source == "plane":
        mesh = {"kind": "plane", "size_mm": [40, 40]}
    scene = with_object(mesh=mesh, texture=texture, motion=[], pose={"position_mm": [0, 0, 660]})
    scene = st.Scene.from_dict(
        {
            **scene.to_dict(),
            "frames": {"count": 1},
            "stage": {"positions": 1, "baseline_mm": 5},
            "render": {"backend": backend},
        }
    )
    try:
        recording, _ = st.simulate(scene)
    except st.BackendUnavailableError as error:
        pytest.skip(str(error))
    image = recording["image"].values[0, 0]
    assert image[40, 60] == pytest.approx(0.8, abs=0.01)
    for y, x in ((40, 100), (80, 60), (80, 100)):
        assert image[y, x] == pytest.approx(0.2, abs=0.01)
    assert image[5, 5] == 0


@pytest.mark.parametrize("backend", ["raycast", "pyrender"])
def test_vertex_colours_are_interpolated(tmp_path: Path, backend: str) -> None:
    square = trimesh.Trimesh(
        vertices=[[-20, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]], faces=[[0, 3, 2], [0, 2, 1]], process=False
    )
    square.visual.vertex_colors = [[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 255], [0, 0, 0, 255]]
    square.export(tmp_path / "square.ply")
    plain = with_object(
        mesh={"kind": "file", "file": str(tmp_path / "square.ply")},
        texture={"kind": "embedded"},
        motion=[],
        pose={"position_mm": [0, 0, 660]},
    ).to_dict()
    plain |= {"frames": {"count": 1}, "stage": {"positions": 1, "baseline_mm": 5}, "render": {"backend": backend}}
    try:
        recording, _ = st.simulate(st.Scene.from_dict(plain))
    except st.BackendUnavailableError as error:
        pytest.skip(str(error))
    row = recording["image"].values[0, 0, 60]
    x = np.arange(160)
    expected = ((x - 79.5) * 660 / 1254 + 20) / 40
    inside = (expected > 0.02) & (expected < 0.98)
    np.testing.assert_allclose(row[inside], expected[inside], atol=1e-5)


def test_srgb_is_decoded(tmp_path: Path) -> None:
    imageio.imwrite(tmp_path / "grey.png", np.full((4, 4), 188, dtype=np.uint8))
    values = []
    for encoding in ("linear", "srgb"):
        scene = with_object(texture={"kind": "image", "file": str(tmp_path / "grey.png"), "encoding": encoding})
        values.append(float(build_scene(scene).bodies[0].texture.raster()[0, 0]))
    assert values[0] == pytest.approx(188 / 255)
    assert values[1] == pytest.approx(0.503, abs=1e-3)  # sRGB 188 is a linear half


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"texture": {"kind": "image", "file": "/nowhere.png"}}, r"objects\.0\.texture\.file: no such image file"),
        (
            {"texture": {"kind": "image", "file": str(SCENES / "cube.yaml")}},
            r"texture\.file: cannot be read as an image",
        ),
        ({"texture": {"kind": "embedded"}}, r"objects\.0\.texture\.kind: the mesh has no texture image"),
    ],
)
def test_bad_textures(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(st.SceneError, match=message):
        build_scene(with_object(**changes))


def test_image_on_a_mesh_without_uv(tmp_path: Path) -> None:
    imageio.imwrite(tmp_path / "grey.png", np.full((4, 4), 188, dtype=np.uint8))
    scene = with_object(
        mesh={"kind": "file", "file": str(ball(tmp_path / "ball.stl"))},
        texture={"kind": "image", "file": str(tmp_path / "grey.png")},
    )
    with pytest.raises(st.SceneError, match=r"objects\.0\.texture\.kind: the mesh has no UV coordinates.*noise"):
        build_scene(scene)


def test_all_objects_that_cannot_be_made_are_named() -> None:
    item = cube().to_dict()["objects"][0]
    broken = [
        {**item, "name": "one", "mesh": {"kind": "file", "file": "/no.obj"}},
        {**item, "name": "two", "texture": {"kind": "image", "file": "/no.png"}},
    ]
    with pytest.raises(st.SceneError) as caught:
        build_scene(cube(objects=broken))
    assert [problem.path for problem in caught.value.problems] == ["objects.0.mesh.file", "objects.1.texture.file"]


def test_charts_are_isometric_and_do_not_overlap() -> None:
    mesh = make_box((10, 20, 30))
    corners, chart = mesh.vertices_mm[mesh.faces], mesh.chart_mm
    for one, two in ((0, 1), (1, 2), (2, 0)):
        on_mesh = np.linalg.norm(corners[:, one] - corners[:, two], axis=1)
        np.testing.assert_allclose(np.linalg.norm(chart[:, one] - chart[:, two], axis=1), on_mesh)
    sides = chart.reshape(6, 6, 2)
    low, high = sides.min(axis=1), sides.max(axis=1)
    for one in range(6):
        for two in range(one):
            apart = (low[one] >= high[two] - 1e-9) | (low[two] >= high[one] - 1e-9)
            assert apart.any()


def test_box_projection_keeps_a_cubes_sides_isometric(tmp_path: Path) -> None:
    trimesh.creation.box((10, 20, 30)).export(tmp_path / "box.stl")
    mesh = load_mesh_file(tmp_path / "box.stl")
    corners = mesh.vertices_mm[mesh.faces]
    np.testing.assert_allclose(
        np.linalg.norm(mesh.chart_mm[:, 0] - mesh.chart_mm[:, 1], axis=1),
        np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1),
        rtol=1e-6,
    )


@pytest.mark.parametrize(
    ("position", "message"),
    [
        ([0, 0, -100], "'cube' is behind the camera; move it to Z > 0"),
        ([0, 0, 10], "'cube' reaches behind the camera"),
        ([5000, 0, 700], "'cube' is outside every image"),
    ],
)
def test_objects_that_cannot_be_seen(position: list[float], message: str) -> None:
    scene = with_object(pose={"position_mm": position})
    with pytest.raises(st.SceneError, match=r"objects\.0\.pose\.position_mm: ") as caught:
        st.simulate(scene)
    assert caught.match(message)


def test_textures_finer_than_two_pixels_are_warned_of() -> None:
    texture = {"kind": "noise", "wavelength_mm": [0.5, 4.0]}
    scene = with_object(texture=texture, mesh={"kind": "box", "size_mm": [12, 12, 12]})
    with pytest.warns(st.SceneWarning, match=r"'cube' has wavelengths down to 0\.8. px; finer than 2 px"):
        check_scene(scene, build_scene(scene))


def test_sound_scenes_are_not_warned_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = cube()
        check_scene(scene, build_scene(scene))


def test_report_of_the_cube() -> None:
    scene = cube()
    depth = np.array([[660.0, 700.0], [np.nan, 680.0]])
    report = describe_scene(scene, build_scene(scene), depth)
    disparity = 1254 * 5 / np.array([660, 700, 680])
    assert report.mean_disparity_px == pytest.approx(disparity.mean(), rel=1e-12)
    assert report.working_point_px == 9
    assert report.residual_disparity_px == pytest.approx((disparity.min() - 9, disparity.max() - 9))
    assert report.recording_bytes == 5 * 9 * 160 * 120 * 4
    (item,) = report.objects
    turn = Rotation.from_euler("yx", [45, 20], degrees=True)
    corners = turn.apply(make_box((49, 49, 49)).vertices_mm)[:, 2] + 692.56
    assert item.depth_mm == pytest.approx((corners.min() - 4, corners.max() + 4))
    assert item.wavelength_px == pytest.approx((3.2 * 1254 / item.depth_mm[1], 12 * 1254 / item.depth_mm[0]))


def test_the_last_snapshots_are_kept_and_are_those_of_their_times() -> None:
    world = build_scene(cube())
    times = [0.0, 1.0, 0.0, 2.5, 1.0, 2.5]
    for t in times:
        fresh = build_scene(cube()).at(t)
        kept = world.at(t)
        assert kept.t == t
        assert kept is world.at(t)
        assert (kept.vertices_mm == fresh.vertices_mm).all()
        assert (kept.velocities == fresh.velocities).all()
    # Memory stays flat, however many times are asked for.
    assert len(world._recent) == 2
