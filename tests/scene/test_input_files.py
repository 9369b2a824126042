"""Files that a scene names: whatever they are and hold, they are read or refused by name, soon and in little memory."""

from __future__ import annotations

import contextlib
import json
import os
import random
import struct
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some
from PIL import Image

import scenetruth as st
from scenetruth.resources import refuse_beyond_limits
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh.mesh_file import load_mesh_file
from scenetruth.scene.texture.image_textures import MAX_PIXELS, compute_luminance

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
    with pytest.raises(st.SceneError, match=r"must be one picture in grey or in colours \(got '2 pages'\)"):
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
    with pytest.raises(st.SceneError, match="claims 1,000,000,000,000 elements; it can have at most"):
        load_mesh_file(file)
    file = good_file(tmp_path, ".gltf")
    tree = json.loads(file.read_text())
    tree["accessors"][0] = {"componentType": 5126, "count": 10**9, "type": "VEC3"}
    file.write_text(json.dumps(tree))
    with pytest.raises(st.SceneError, match="claims 1,000,000,000 elements"):
        load_mesh_file(file)


def test_formats_that_unpack_are_not_tried(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "it.zip", "w") as archive:
        archive.writestr("it.obj", "v 0 0 0\n")
    with pytest.raises(st.SceneError, match="is no format that is read"):
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
    with pytest.raises(st.SceneError, match="cannot be read as a mesh"):
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
    with pytest.raises(st.SceneError, match=r"has .* numbers; at most 20,000,000 are read"):
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
