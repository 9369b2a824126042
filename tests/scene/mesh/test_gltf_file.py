"""glTF files: accessors, primitives, nodes, skins, materials and extensions as the specification has them."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.scene.texture import Picture
from tests.helpers.mesh_files import area_of, data_uri, gltf, read, refusal

POINTS = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], dtype=np.float32)
SQUARE = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)
PLAIN: dict[str, Any] = {"attributes": {"POSITION": "@points"}, "indices": "@index"}


def square(**more: Any) -> str:
    return gltf({"points": POINTS, "index": SQUARE}, PLAIN, **more)


def changed(text: str, *path: Any, value: Any) -> str:
    """Return a document with another value at a path."""
    document = json.loads(text)
    here = document
    for key in path[:-1]:
        here = here[key]
    here[path[-1]] = value
    return json.dumps(document)


def test_a_square_in_any_container(tmp_path: Path) -> None:
    text = square()
    assert area_of(read(tmp_path / "a.gltf", text)) == pytest.approx(4)
    document = json.loads(text)
    import base64

    binary = base64.b64decode(document["buffers"][0].pop("uri").partition(",")[2])
    (tmp_path / "my buffer.bin").write_bytes(binary)
    document["buffers"][0]["uri"] = "my%20buffer.bin"
    assert area_of(read(tmp_path / "b.gltf", json.dumps(document))) == pytest.approx(4)
    del document["buffers"][0]["uri"]
    tree = json.dumps(document).encode()
    tree += b" " * (-len(tree) % 4)
    parts = struct.pack("<II", len(tree), 0x4E4F534A) + tree + struct.pack("<II", len(binary), 0x004E4942) + binary
    glb = b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts
    assert area_of(read(tmp_path / "c.glb", glb)) == pytest.approx(4)
    assert "cut off" in refusal(tmp_path / "d.glb", glb[:-8])


@pytest.mark.parametrize(
    ("mode", "index", "faces"),
    [(4, [0, 1, 2, 0, 2, 3], 2), (5, [0, 1, 3, 2], 2), (6, [0, 1, 2, 3], 2), (6, None, 2)],
)
def test_lists_strips_and_fans(tmp_path: Path, mode: int, index: list[int] | None, faces: int) -> None:
    arrays = {"points": POINTS} | ({} if index is None else {"index": np.array(index, dtype=np.uint8)})
    primitive = {"attributes": {"POSITION": "@points"}, "mode": mode} | ({} if index is None else {"indices": "@index"})
    mesh = read(tmp_path / "a.gltf", gltf(arrays, primitive))
    assert len(mesh.faces) == faces
    assert area_of(mesh) == pytest.approx(4)
    corners = mesh.vertices_mm[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    assert not any("turned" in note for note in mesh.file_notes)


def test_sparse_accessors(tmp_path: Path) -> None:
    document = json.loads(gltf({"points": POINTS, "index": SQUARE, "at": np.array([1, 2], dtype=np.uint16),
                                "moved": np.array([[4, 0, 0], [4, 2, 0]], dtype=np.float32)}, PLAIN))  # fmt: skip
    sparse = {"count": 2, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    document["accessors"][0]["sparse"] = sparse
    assert area_of(read(tmp_path / "a.gltf", json.dumps(document))) == pytest.approx(8)
    # Without a buffer view, all others are zero.
    del document["accessors"][0]["bufferView"]
    document["meshes"][0]["primitives"][0]["indices"] = 1
    mesh = read(tmp_path / "b.gltf", json.dumps(document))
    assert area_of(mesh) == pytest.approx(4)
    wrong = changed(json.dumps(document), "accessors", 0, "sparse", "count", value=9)
    assert "9 sparse values of 4" in refusal(tmp_path / "c.gltf", wrong)


@pytest.mark.parametrize(("kind", "full"), [(np.int8, 127), (np.uint8, 255), (np.int16, 32767), (np.uint16, 65535)])
def test_quantised_and_normalised_positions(tmp_path: Path, kind: Any, full: int) -> None:
    whole = {"points": (POINTS / 2 * full).astype(kind), "index": SQUARE}
    used: dict[str, Any] = {
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
    }
    mesh = read(tmp_path / "a.gltf", gltf(whole, PLAIN, normalized=("points",), **used))
    assert area_of(mesh) == pytest.approx(1)
    scaled: dict[str, Any] = {"nodes": [{"mesh": 0, "scale": [2 / full] * 3}]}
    assert area_of(read(tmp_path / "b.gltf", gltf(whole, PLAIN, **used, **scaled))) == pytest.approx(4)
    # Without the extension, positions are floats.
    assert "POSITION of component type" in refusal(tmp_path / "c.gltf", gltf(whole, PLAIN))


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("accessors", 0, "type"), "VEC2", "POSITION of type 'VEC2' instead of VEC3"),
        (("accessors", 0, "type"), "SCALAR", "POSITION of type 'SCALAR'"),
        (("accessors", 1, "componentType"), 5126, "indices of component type FLOAT"),
        (("accessors", 0, "count"), 40, "exceed their buffer view"),
        (("accessors", 0, "count"), 3, "vertex 3 of its primitive, from 0: there are 3"),
        (("accessors", 0, "count"), -1, "of -1 elements"),
        (("accessors", 1, "count"), 5, "no multiple of 3"),
        (("accessors", 0, "bufferView"), 7, "bufferViews 7, of which there are 2"),
        (("meshes", 0, "primitives", 0, "attributes"), {}, "without POSITION"),
        (("meshes", 0, "primitives", 0, "mode"), 9, "of mode 9"),
        (("meshes", 0, "primitives", 0, "mode"), 1, "no faces"),
        (("nodes", 0, "mesh"), "0", "meshes '0'"),
        (("nodes", 0, "children"), [0], "below two others, or below itself"),
        (("nodes", 0, "rotation"), [1, 1, 1, 1], "no unit quaternion"),
        (("nodes", 0, "matrix"), [1, 2], "not 16 numbers"),
        (("asset", "version"), "1.0", 'version "1.0"'),
        (("asset",), 5, "no asset"),
        (("extensionsRequired",), ["KHR_draco_mesh_compression"], "compressed by Draco"),
        (("extensionsRequired",), ["ACME_secret"], "requires the extension ACME_secret"),
        (("extensionsUsed",), ["EXT_mesh_gpu_instancing"], "repeats meshes"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path: Path, path: tuple[Any, ...], value: Any, reason: str) -> None:
    assert reason in refusal(tmp_path / "a.gltf", changed(square(), *path, value=value))


def test_unknown_extensions_that_are_used_are_named(tmp_path: Path) -> None:
    mesh = read(tmp_path / "a.gltf", square(extensionsUsed=["ACME_secret"]))
    assert any("ACME_secret" in note for note in mesh.file_notes)


def test_nodes_of_the_default_scene(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    nodes: list[dict[str, Any]] = [
        {"children": [1, 2], "translation": [10, 0, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [half, 0, 0, half]},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 5, 1]},
        {"mesh": 0, "translation": [99, 99, 99]},
    ]
    scenes = [{"nodes": [3]}, {"nodes": [0]}]
    mesh = read(tmp_path / "a.gltf", square(nodes=nodes, scenes=scenes, scene=1))
    assert area_of(mesh) == pytest.approx(2 * 16)
    # A quarter turn about x maps (x, y, 0) to (x, 0, y); then twice as large, 10 to the right.
    np.testing.assert_allclose(mesh.vertices_mm[:4], [[10, 0, 0], [14, 0, 0], [14, 0, 4], [10, 0, 4]], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices_mm[4:, 2], 10)
    assert area_of(read(tmp_path / "b.gltf", square(nodes=nodes, scenes=scenes, scene=0))) == pytest.approx(4)
    # Without scenes, all roots are shown.
    assert area_of(read(tmp_path / "c.gltf", square(nodes=nodes, scenes=[]))) == pytest.approx(36)


def test_skins_and_morph_targets_rest_in_their_default_pose(tmp_path: Path) -> None:
    arrays: dict[str, Any] = {
        "points": POINTS,
        "index": SQUARE,
        "joints": np.array([[0, 1, 0, 0]] * 4, dtype=np.uint8),
        "weights": np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0]], dtype=np.float32),
        "inverse": np.stack([np.eye(4), np.eye(4)]).astype(np.float32),
        "moves": np.array([[0, 0, 1]] * 4, dtype=np.float32),
    }
    attributes = {"POSITION": "@points", "JOINTS_0": "@joints", "WEIGHTS_0": "@weights"}
    skinned: dict[str, Any] = {
        # The node of a skinned mesh does not move it.
        "nodes": [{"mesh": 0, "skin": 0, "translation": [50, 0, 0]}, {}, {"translation": [0, 0, 4]}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": "@inverse"}],
        "scenes": [{"nodes": [0, 1, 2]}],
    }
    mesh = read(tmp_path / "a.gltf", gltf(arrays, PLAIN | {"attributes": attributes}, **skinned))
    np.testing.assert_allclose(mesh.vertices_mm, [[0, 0, 0], [2, 0, 4], [2, 2, 4], [0, 2, 2]])
    morphed = PLAIN | {"targets": [{"POSITION": "@moves"}]}
    mesh = read(tmp_path / "b.gltf", gltf(arrays, morphed, nodes=[{"mesh": 0, "weights": [0.25]}]))
    np.testing.assert_allclose(mesh.vertices_mm[:, 2], 0.25)


def png(values: NDArray[Any]) -> bytes:
    out = io.BytesIO()
    imageio.imwrite(out, values, extension=".png")
    return out.getvalue()


GREY = np.array([[10, 60], [120, 250]], dtype=np.uint8)
CORNERS_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)


def textured(material: dict[str, Any], values: NDArray[Any] = GREY, uv: NDArray[Any] = CORNERS_UV, **more: Any) -> str:
    arrays = {"points": POINTS, "index": SQUARE, "uv": uv}
    primitive = {"attributes": {"POSITION": "@points", "TEXCOORD_0": "@uv"}, "indices": "@index", "material": 0}
    common: dict[str, Any] = {"textures": [{"source": 0, "sampler": 0}], "samplers": [{}],
              "images": [{"uri": data_uri(png(values), "image/png")}]}  # fmt: skip
    return gltf(arrays, primitive, ("uv",) if uv.dtype.kind == "u" else (), materials=[material], **(common | more))


def linear(grey: NDArray[Any]) -> NDArray[np.float64]:
    """Return sRGB grey values of 8 bits in proportion to radiance."""
    value = grey / 255
    return np.where(value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92)


BASE = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}


@pytest.mark.parametrize("kind", [np.float32, np.uint8, np.uint16])
def test_textures_are_srgb_with_rows_downwards(tmp_path: Path, kind: Any) -> None:
    full = 1 if kind is np.float32 else np.iinfo(kind).max
    mesh = read(tmp_path / "a.gltf", textured(BASE, uv=(CORNERS_UV * full).astype(kind)))
    assert mesh.appearance is not None
    laid = mesh.appearance.lay(None)
    np.testing.assert_allclose(laid.values, linear(GREY), rtol=1e-6)
    np.testing.assert_allclose(laid.uv[0], CORNERS_UV[:3], atol=1e-7)
    assert laid.tiled


def test_factors_multiply_textures(tmp_path: Path) -> None:
    base = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.25, 0, 1]}}
    mesh = read(tmp_path / "a.gltf", textured(base))
    assert mesh.appearance is not None
    share = 0.2126 * 0.5 + 0.7152 * 0.25
    np.testing.assert_allclose(mesh.appearance.lay(None).values, share * linear(GREY), rtol=1e-6)


def test_texture_transforms_follow_the_example_of_the_specification(tmp_path: Path) -> None:
    # It uses the lower left quadrant of the picture, turned clockwise by a quarter.
    moved = {"KHR_texture_transform": {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}}
    base = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": moved}}}
    mesh = read(tmp_path / "a.gltf", textured(base))
    assert mesh.appearance is not None
    uv = mesh.appearance.lay(None).uv
    np.testing.assert_allclose(uv[0], np.array([[0, 1], [0, 0.5], [0.5, 0.5]]), atol=1e-7)


@pytest.mark.parametrize(
    ("wraps", "inside"), [((10497, 10497), None), ((33071, 33071), None), ((33648, 10497), 60), ((10497, 33071), 250)]
)
def test_wrap_modes(tmp_path: Path, wraps: tuple[int, int], inside: int | None) -> None:
    sampler: dict[str, Any] = {"samplers": [{"wrapS": wraps[0], "wrapT": wraps[1]}]}
    mesh = read(tmp_path / "a.gltf", textured(BASE, uv=CORNERS_UV * 4, **sampler))
    assert mesh.appearance is not None
    laid = mesh.appearance.lay(None)
    # Centres of texels on the square from 0 to 2, where u and v go from 0 to 4.
    at = np.array([[0.75, 0.25], [1.25, 0.25], [1.75, 0.25], [0.75, 1.75]])
    step, start = laid.uv[0, 1] - laid.uv[0, 0], laid.uv[0, 0]
    across = np.array([step[0] / 4, (laid.uv[0, 2] - laid.uv[0, 1])[1] / 4])
    found = Picture(laid.values, laid.tiled).radiance(start + at * across)
    modes: dict[int, Any] = {
        10497: lambda n: n % 2,
        33071: lambda n: min(max(n, 0), 1),
        33648: lambda n: [0, 1, 1, 0][n % 4],
    }
    expected: list[Any] = [GREY[modes[wraps[1]](int(2 * v)), modes[wraps[0]](int(2 * u))] for u, v in at]
    np.testing.assert_allclose(found, linear(np.array(expected)), rtol=1e-5)
    assert inside is None or inside in expected


def test_vertex_colours_are_linear(tmp_path: Path) -> None:
    for kind, full in ((np.float32, 1), (np.uint8, 255), (np.uint16, 65535)):
        colours = (np.array([[0, 0, 0, 1], [1, 1, 1, 1], [0, 1, 0, 1], [1, 0, 0, 1]]) * full).astype(kind)
        arrays = {"points": POINTS, "index": SQUARE, "colours": colours}
        primitive = {"attributes": {"POSITION": "@points", "COLOR_0": "@colours"}, "indices": "@index", "material": 0}
        material = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}
        normalized = () if kind is np.float32 else ("colours",)
        mesh = read(tmp_path / "a.gltf", gltf(arrays, primitive, normalized, materials=[material]))
        assert mesh.appearance is not None
        np.testing.assert_allclose(mesh.appearance.radiances(None), [[0, 0.5, 0.3576], [0, 0.3576, 0.1063]])


def test_opacity(tmp_path: Path) -> None:
    whole = np.dstack([GREY, GREY, GREY, np.full_like(GREY, 255)])
    half = whole.copy()
    half[0, 0, 3] = 0
    # Opaque materials ignore the opacity of a picture.
    for values in (whole, half):
        mesh = read(tmp_path / "a.gltf", textured(BASE, values))
        assert mesh.appearance is not None
        np.testing.assert_allclose(mesh.appearance.lay(None).values, linear(GREY), rtol=1e-6)
    assert area_of(read(tmp_path / "b.gltf", textured(BASE | {"alphaMode": "MASK"}, whole))) == pytest.approx(4)
    mesh = read(tmp_path / "d.gltf", textured(BASE | {"alphaMode": "BLEND"}))
    assert mesh.appearance is not None
    with pytest.raises(ValueError, match="BLEND"):
        mesh.appearance.lay(None)


def test_several_materials(tmp_path: Path) -> None:
    document = json.loads(textured(BASE, uv=CORNERS_UV * 3))
    document["materials"].append({"pbrMetallicRoughness": {"baseColorFactor": [0.125, 0.125, 0.125, 1]}})
    first = document["meshes"][0]["primitives"][0]
    document["meshes"][0]["primitives"].append({**first, "material": 1})
    document["meshes"][0]["primitives"].append({**first, "material": 0})
    document["nodes"][0]["mesh"] = 0
    mesh = read(tmp_path / "a.gltf", json.dumps(document))
    # The same triangles thrice: one of each is kept.
    assert len(mesh.faces) == 2
    document["meshes"].append({"primitives": [{**first, "material": 1}]})
    document["meshes"][0]["primitives"] = [first]
    document["nodes"].append({"mesh": 1, "translation": [0, 0, 1]})
    document["scenes"] = [{"nodes": [0, 1]}]
    mesh = read(tmp_path / "b.gltf", json.dumps(document))
    assert mesh.appearance is not None
    laid = mesh.appearance.lay(None)
    picture = Picture(laid.values, laid.tiled)
    np.testing.assert_allclose(picture.radiance(laid.uv[2:].reshape(-1, 2)), 0.125, rtol=1e-6)
    # u and v go from 0 to 3: the centres of the four texels of the middle copy.
    for row in range(2):
        for column in range(2):
            share = (1 + (np.array([column, row]) + 0.5) / 2) / 3
            corner, right, down = laid.uv[0, 0], laid.uv[0, 1] - laid.uv[0, 0], laid.uv[0, 2] - laid.uv[0, 1]
            found = picture.radiance((corner + share[0] * right + share[1] * down)[None])
            np.testing.assert_allclose(found, linear(GREY[row, column]), rtol=1e-5)
