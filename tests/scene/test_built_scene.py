"""Meshes and textures made real, from primitives and from files, or refused by name."""

from __future__ import annotations

import contextlib
import json
import os
import random
import struct
import time
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some
from PIL import Image
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.resources import refuse_beyond_limits
from scenetruth.scene import built_scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import load_mesh_file, make_box
from scenetruth.scene.scene_report import check_scene, describe_scene
from scenetruth.scene.texture import MAX_PIXELS, compute_luminance
from tests.helpers.scenes import SCENES, cube


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
            r"texture\.file: cannot be read as an image: its format is not recognised; save it as PNG, TIFF or JPEG",
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


def test_the_last_snapshots_are_kept_and_are_those_of_their_times(monkeypatch: pytest.MonkeyPatch) -> None:
    world = build_scene(cube())
    times = [0.0, 1.0, 0.0, 2.5, 1.0, 2.5, 4.0, 3.0, 5.0, 0.0]
    for t in times:
        fresh = build_scene(cube()).at(t)
        kept = world.at(t)
        assert kept.t == t
        assert kept is world.at(t)
        assert (kept.vertices_mm == fresh.vertices_mm).all()
        assert (kept.velocities == fresh.velocities).all()
    # Memory stays flat, however many times are asked for.
    for t in range(70):
        world.at(float(t))
    assert len(world._recent) == 64
    monkeypatch.setattr(built_scene, "_SNAPSHOT_NUMBERS", 6 * 9 * 8)
    world.at(-1.0)
    assert len(world._recent) == 6
    monkeypatch.setattr(built_scene, "_SNAPSHOT_NUMBERS", 1)
    world.at(-2.0)
    assert list(world._recent) == [68.0, 69.0, -1.0, -2.0]


def test_expected_rates_come_with_the_vertices() -> None:
    world, alone = build_scene(cube()), build_scene(cube())
    world.expect_rates([1.0])
    assert world.at(0.0).rates is None
    rates = world.at(1.0).rates
    assert rates is not None
    np.testing.assert_array_equal(rates, alone.rates_at(1.0))
    np.testing.assert_array_equal(rates, alone.surface_at(1.0)[:, 3:6])
    np.testing.assert_array_equal(world.at(1.0).accelerations, alone.at(1.0).accelerations)


BOX = trimesh.creation.box((10, 10, 10))


def scene_of(
    mesh: dict[str, Any], texture: dict[str, Any], deformation: list[dict[str, Any]] | None = None
) -> st.Scene:
    item = {"name": "it", "mesh": mesh, "texture": texture, "deformation": deformation or []}
    return st.Scene.from_dict(
        {
            "camera": {"width": 20, "height": 20, "focal_length_px": 20},
            "stage": {"positions": 2, "baseline_mm": 1},
            "frames": {"count": 2},
            "objects": [item | {"pose": {"position_mm": [0, 0, 100]}}],
        }
    )


def make(file: Path, what: str) -> None:
    """Build a world of a file used as a mesh, a picture, or an array."""
    plane = {"kind": "plane", "size_mm": [9, 9]}
    if what == "mesh":
        build_scene(scene_of({"kind": "file", "file": str(file)}, {"kind": "uniform"}))
    elif what == "image":
        build_scene(scene_of(plane, {"kind": "image", "file": str(file)}))
    else:
        mesh = file.parent / "good.ply"
        BOX.export(mesh)
        entry = {"kind": "nodal", "file": str(file)}
        build_scene(scene_of({"kind": "file", "file": str(mesh)}, {"kind": "uniform"}, [entry]))


MESHES = [".obj", ".ply", ".glb", ".gltf", ".stl", ".off"]
PICTURES = [".png", ".jpg", ".tif", ".bmp", ".gif"]
ARRAYS = [".npy", ".npz"]
ALL = [(suffix, "mesh") for suffix in MESHES] + [(s, "image") for s in PICTURES] + [(s, "array") for s in ARRAYS]


def good_file(folder: Path, suffix: str) -> Path:
    file = folder / f"it{suffix}"
    if suffix == ".gltf":
        parts = trimesh.exchange.gltf.export_gltf(trimesh.Scene(BOX))
        for name, content in parts.items():
            (folder / ("it.gltf" if name.endswith(".gltf") else name)).write_bytes(content)
    elif suffix in MESHES:
        BOX.export(file)
    elif suffix in PICTURES:
        Image.fromarray(np.arange(400, dtype=np.uint8).reshape(20, 20)).save(file)
    elif suffix == ".npy":
        np.save(file, np.zeros((2, len(BOX.vertices), 3)))
    else:
        np.savez(file, it=np.zeros((2, len(BOX.vertices), 3)))
    return file


@pytest.mark.parametrize(("suffix", "what"), ALL)
def test_good_files_are_read(tmp_path: Path, suffix: str, what: str) -> None:
    make(good_file(tmp_path, suffix), what)


@pytest.mark.parametrize(("suffix", "what"), ALL)
def test_what_is_no_such_file_is_refused(tmp_path: Path, suffix: str, what: str) -> None:
    file = good_file(tmp_path, suffix)
    content, wrong = file.read_bytes(), []
    dice = random.Random(1)
    wrong += [b"", b"\0" * 100, dice.randbytes(1000), b"hello\n" * 10, b"{" * 3000, b"[" * 100_000]
    wrong += [content[: len(content) // 3], content[: len(content) // 2] + dice.randbytes(40)]
    for attempt in wrong:
        file.write_bytes(attempt)
        started = time.process_time()
        with contextlib.suppress(st.SceneError):
            make(file, what)
            # A picture may be cut where only the last rows are, a list of vertices between two of them.
            assert attempt in wrong[6:], attempt[:20]
        assert time.process_time() - started < 5


@pytest.mark.parametrize(("suffix", "what"), [(".ply", "mesh"), (".obj", "mesh"), (".png", "image"), (".npy", "array")])
def test_what_is_no_file_is_not_opened(tmp_path: Path, suffix: str, what: str) -> None:
    file = tmp_path / f"it{suffix}"
    with pytest.raises(st.SceneError, match=r"objects\.0\.\w+(\.0)?\.file: no such .*file"):
        make(file, what)
    with pytest.raises(st.SceneError, match=r"no such .*file"):
        make(tmp_path / ("x" * 300 + suffix), what)
    os.mkfifo(file)
    with pytest.raises(st.SceneError, match="is not a regular file"):
        make(file, what)
    file.unlink()
    file.mkdir()
    with pytest.raises(st.SceneError):
        make(file, what)


def test_all_files_that_are_missing_are_told_together(tmp_path: Path) -> None:
    scene = scene_of(
        {"kind": "file", "file": "gone.ply"},
        {"kind": "image", "file": "gone.png"},
        [{"kind": "meshes", "files": ["one.ply", "two.ply"]}],
    )
    BOX.export(tmp_path / "one.ply")
    other = scene.objects[0].model_dump(mode="json")
    other |= {"name": "other", "mesh": {"kind": "file", "file": "one.ply"}, "texture": {"kind": "uniform"}}
    scene = st.Scene.from_dict({**scene.to_dict(), "objects": [scene.to_dict()["objects"][0], other]})
    expected = ["0.mesh.file", "0.texture.file", "0.deformation.0.files.1", "1.deformation.0.files.1"]
    for refuse in (build_scene, lambda scene, folder: refuse_beyond_limits(scene, folder=folder)):
        with pytest.raises(st.SceneError, match=r"0\.mesh\.file: no such mesh file") as caught:
            refuse(scene, tmp_path)
        paths = [problem.path for problem in caught.value.problems]
        assert sorted(paths) == sorted(f"objects.{path}" for path in expected)


def png_of(width: int, height: int) -> bytes:
    """A PNG file of zeros, of some kilobytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(b"\0" * (width + 1)) for _ in range(min(height, 12_000))) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(13_100, 13_000), (2**31 - 1, 2**31 - 1), (60_000, 60_000)])
def test_pictures_are_refused_by_their_headers(tmp_path: Path, size: tuple[int, int]) -> None:
    file = tmp_path / "bomb.png"
    file.write_bytes(png_of(*size) if size[0] == 13_100 else png_of(100, 100).replace(
        struct.pack(">II", 100, 100), struct.pack(">II", *size)))  # fmt: skip
    started = time.process_time()
    with pytest.raises(st.SceneError, match=rf"pixels, more than {MAX_PIXELS:,}|cannot be read as an image"):
        make(file, "image")
    assert time.process_time() - started < 1


def test_pictures_with_several_pages_or_odd_values_are_refused(tmp_path: Path) -> None:
    frames = [Image.fromarray(np.full((8, 8), value, dtype=np.uint8)) for value in (0, 200)]
    frames[0].save(tmp_path / "moving.gif", save_all=True, append_images=frames[1:])
    with pytest.raises(st.SceneError, match=r"must be a single grey or colour image \(got '2 pages'\)"):
        make(tmp_path / "moving.gif", "image")
    Image.fromarray(np.full((8, 8), np.nan, dtype=np.float32)).save(tmp_path / "nan.tif")
    with pytest.raises(st.SceneError, match="holds values that are not finite"):
        make(tmp_path / "nan.tif", "image")


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
@pytest.mark.parametrize("shape", [(1500, 900), (1500, 900, 3), (3, 5, 1), (3, 5, 4)])
def test_luminance_is_the_same_in_parts(encoding: str, shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    rows = [compute_luminance(row[None], encoding)[0] for row in image]
    np.testing.assert_array_equal(compute_luminance(image, encoding), np.stack(rows))


def test_meshes_are_refused_by_what_they_claim(tmp_path: Path) -> None:
    file = tmp_path / "it.ply"
    head = "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
    file.write_text(head.format(10**12) + "property float z\nend_header\n")
    with pytest.raises(st.SceneError, match="declares 1,000,000,000,000 elements; the maximum is"):
        load_mesh_file(file)
    file = good_file(tmp_path, ".gltf")
    tree = json.loads(file.read_text())
    tree["accessors"][0] = {"componentType": 5126, "count": 10**9, "type": "VEC3"}
    file.write_text(json.dumps(tree))
    with pytest.raises(st.SceneError, match="declares 1,000,000,000 elements"):
        load_mesh_file(file)


def test_formats_that_unpack_are_not_tried(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "it.zip", "w") as archive:
        archive.writestr("it.obj", "v 0 0 0\n")
    with pytest.raises(st.SceneError, match="unsupported format"):
        load_mesh_file(tmp_path / "it.zip")


@pytest.mark.parametrize(
    "text",
    [
        "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "v 1e400 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999999999999999\n",
        "v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n",
        "v 0 0 0\nv 1 0 0\n",
        "f 1 2 3\n",
        "v a b c\nf 1 2 3\n",
    ],
)
def test_meshes_that_make_no_sense(tmp_path: Path, text: str) -> None:
    (tmp_path / "it.obj").write_text(text)
    with pytest.raises(st.SceneError, match="file: "):
        make(tmp_path / "it.obj", "mesh")


def test_what_a_mesh_refers_to_is_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "it.mtl").write_text("newmtl a\nmap_Kd pipe.png\n")
    text = "mtllib it.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
    (tmp_path / "it.obj").write_text(text)
    with contextlib.suppress(st.SceneError):
        make(tmp_path / "it.obj", "mesh")
    file = good_file(tmp_path, ".gltf")
    tree = json.loads(file.read_text())
    tree["buffers"][0]["uri"] = "pipe.png"
    file.write_text(json.dumps(tree))
    with pytest.raises(st.SceneError, match=r'"pipe\.png", which cannot be read'):
        make(file, "mesh")


def test_arrays_are_refused_by_their_headers(tmp_path: Path) -> None:
    file = tmp_path / "it.npy"
    with file.open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 8, 3)})
    with pytest.raises(st.SceneError, match=r"cannot be read as an array|has 24,000,000,000 numbers"):
        make(file, "array")
    with zipfile.ZipFile(tmp_path / "it.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("it.npy", "w") as to:
        np.lib.format.write_array_header_1_0(to, {"descr": "<f8", "fortran_order": False, "shape": (10**6, 8, 3)})
        for _ in range(192):
            to.write(bytes(10**6))
    with pytest.raises(st.SceneError, match=r"has .* values; the maximum is 20,000,000"):
        make(tmp_path / "it.npz", "array")
    np.save(file, np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(st.SceneError, match="cannot be read as an array"):
        make(file, "array")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=some.data())
def test_files_with_changed_bytes_are_read_or_refused(tmp_path: Path, data: Any) -> None:
    suffix, what = data.draw(some.sampled_from([entry for entry in ALL if entry[0] not in (".jpg",)]))
    file = good_file(tmp_path, suffix)
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(some.integers(1, 4))):
        content[data.draw(some.integers(0, len(content) - 1))] = data.draw(some.integers(0, 255))
    file.write_bytes(content[: data.draw(some.integers(1, len(content)) | some.just(len(content)))])
    with contextlib.suppress(st.SceneError):
        make(file, what)
