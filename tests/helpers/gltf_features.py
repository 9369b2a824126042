"""Features of glTF files; the values are those of the specification, by hand."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import PngImagePlugin

from tests.helpers.file_features import FileFeature
from tests.helpers.mesh_files import data_uri, gltf
from tests.helpers.polygon_features import png

__all__ = ["GLTF_FEATURES", "GREYS", "RAMP", "chunk"]

Plain = dict[str, Any]

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
INDEX = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)
# v increases downwards: the picture stands upright.
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)
PLAIN: Plain = {"attributes": {"POSITION": "@points"}, "indices": "@index"}
PICTURED: Plain = {"attributes": {"POSITION": "@points", "TEXCOORD_0": "@uv"}, "indices": "@index", "material": 0}
MIDDLE = (0.5, 0.4)
GREEN = 0.7152


def linear(value: float) -> float:
    """Return the radiance of an sRGB value (IEC 61966-2-1)."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


GREYS = [[51, 102], [153, 204]]
SHADES = tuple(
    (place, linear(value)) for place, value in (((0.25, 0.75), 0.2), ((0.25, 0.25), 0.6), ((0.75, 0.75), 0.4))
)
BASE: Plain = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}


def square(primitive: Plain = PLAIN, normalized: tuple[str, ...] = (), arrays: Plain | None = None, **more: Any) -> str:
    """Return a document with a unit square of two triangles."""
    return gltf({"points": POINTS, "index": INDEX, **(arrays or {})}, primitive, normalized, **more)


def pictured(material: Plain = BASE, picture: bytes | None = None, kind: str = "image/png", **more: Any) -> str:
    """Return a unit square with a picture."""
    image = {"uri": data_uri(png(GREYS) if picture is None else picture, kind)}
    arrays = more.pop("arrays", {"uv": UV})
    primitive = more.pop("primitive", PICTURED)
    base: Plain = {"textures": [{"source": 0}], "images": [image], "materials": [material]}
    return square(primitive, more.pop("normalized", ()), arrays, **{**base, **more})


def changed(text: str, change: Callable[[Plain], Any]) -> str:
    """Return a document after a change of its tree."""
    tree = json.loads(text)
    change(tree)
    return json.dumps(tree)


def binary(text: str, *, cut: int = 0) -> bytes:
    """Return a document as GLB."""
    tree = json.loads(text)
    data = base64.b64decode(tree["buffers"][0].pop("uri").partition(",")[2])
    head = json.dumps(tree).encode()
    head += b" " * (-len(head) % 4)
    parts = struct.pack("<II", len(head), 0x4E4F534A) + head + struct.pack("<II", len(data), 0x004E4942) + data
    whole = b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts
    return whole[: len(whole) - cut]


def one(name: str, content: str | bytes, occurs: str = "", **more: Any) -> FileFeature:
    """Return a feature of a single glTF file."""
    suffix = "glb" if isinstance(content, bytes) else "gltf"
    return FileFeature("glTF", name, {f"mesh.{suffix}": content}, occurs, **more)


def mode(number: int, index: list[int] | None, name: str, **more: Any) -> FileFeature:
    """Return a feature of a mode of primitives."""
    primitive: Plain = {"attributes": {"POSITION": "@points"}, "mode": number}
    arrays: Plain = {"points": POINTS}
    if index is not None:
        primitive["indices"], arrays["index"] = "@index", np.array(index, dtype=np.uint8)
    return one(name, gltf(arrays, primitive), "Asset Generator Mesh_PrimitiveMode", **more)


def sparse() -> str:
    """Return a square of zeros whose corners are replaced by a sparse accessor."""
    at, values = np.array([1, 2, 3], dtype=np.uint8), POINTS[1:]
    text = square(PLAIN, (), {"at": at, "values": values})

    def change(tree: Plain) -> None:
        views = {name: n for n, name in enumerate(("points", "index", "at", "values"))}
        entry = tree["accessors"][0]
        del entry["bufferView"]
        entry["sparse"] = {
            "count": 3,
            "indices": {"bufferView": views["at"], "componentType": 5121},
            "values": {"bufferView": views["values"]},
        }

    return changed(text, change)


def interleaved() -> str:
    """Return a square whose positions and texture coordinates alternate in one buffer view."""
    rows = np.concatenate([POINTS, UV], axis=1).astype(np.float32)
    text = pictured(arrays={"uv": UV, "rows": np.zeros((10, 2), np.float32)})

    def change(tree: Plain) -> None:
        data = bytearray(base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2]))
        view = tree["bufferViews"][3]
        data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] = rows.tobytes()
        tree["buffers"][0]["uri"] = data_uri(bytes(data))
        view["byteStride"] = 20
        tree["accessors"][0] |= {"bufferView": 3, "byteOffset": 0}
        tree["accessors"][2] |= {"bufferView": 3, "byteOffset": 12}

    return changed(text, change)


def with_external() -> dict[str, str | bytes]:
    """Return a document with a buffer and a picture in files whose names have spaces."""
    tree = json.loads(pictured())
    buffer = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])
    tree["buffers"][0]["uri"], tree["images"][0]["uri"] = "my%20buffer.bin", "the%20textures/grey%C3%A9.png"
    return {"mesh.gltf": json.dumps(tree), "my buffer.bin": buffer, "the textures/greyé.png": png(GREYS)}


def coloured(kind: Any, width: int, *, stated: bool = True, **more: Any) -> str:
    """Return a square with green vertices."""
    full = 1 if kind is np.float32 else np.iinfo(kind).max
    colours = np.zeros((4, width))
    colours[:, 1] = 0.5 if kind is np.float32 else 1
    colours[:, 3:] = 1
    primitive = {"attributes": {"POSITION": "@points", "COLOR_0": "@colours"}, "indices": "@index"}
    normalized = ("colours",) if stated and kind is not np.float32 else ()
    return square(primitive, normalized, {"colours": (colours * full).astype(kind)}, **more)


def transformed(**transform: Any) -> str:
    """Return a pictured square whose texture has a KHR_texture_transform."""
    base = {"baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": transform}}}
    return pictured(
        {"pbrMetallicRoughness": base},
        extensionsUsed=["KHR_texture_transform"],
        extensionsRequired=["KHR_texture_transform"],
    )


def chunk(name: bytes, data: bytes) -> PngImagePlugin.PngInfo:
    """Return a chunk of a PNG file."""
    found = PngImagePlugin.PngInfo()
    found.add(name, data)
    return found


def opacity(values: Any) -> bytes:
    """Return a white picture with an opacity."""
    alpha = np.asarray(values, dtype=np.uint8)
    return png(np.dstack([np.full_like(alpha, 255)] * 3 + [alpha]))


# Opacity falls from 1 at u = 1/8 to 0 at u = 7/8 in four texels: half of the surface is below 1/2.
RAMP = opacity([[255, 170, 85, 0]] * 4)
NODE: Plain = {"mesh": 0}


def nodes(*entries: Plain, roots: list[int] | None = None, **more: Any) -> str:
    """Return a document with nodes."""
    return square(nodes=list(entries), scenes=[{"nodes": [0] if roots is None else roots}], **more)


def skinned() -> str:
    """Return a square whose corners follow two joints, of which the second is moved by 2 along x."""
    joints = np.zeros((4, 4), dtype=np.uint8)
    joints[1:3, 0] = 1
    weights = np.zeros((4, 4), dtype=np.float32)
    weights[:, 0] = 1
    primitive = {
        "attributes": {"POSITION": "@points", "JOINTS_0": "@joints", "WEIGHTS_0": "@weights"},
        "indices": "@index",
    }
    return nodes(
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"children": [2]},
        {"translation": [2, 0, 0]},
        roots=[0, 1],
        primitive=primitive,
        arrays={"joints": joints, "weights": weights},
        skins=[{"joints": [1, 2]}],
    )


def morphed() -> str:
    """Return a square whose right side is moved by half of a target of 2 along x."""
    moves = np.array([[0, 0, 0], [2, 0, 0], [2, 0, 0], [0, 0, 0]], dtype=np.float32)
    primitive = {**PLAIN, "targets": [{"POSITION": "@moves"}]}
    return changed(square(primitive, (), {"moves": moves}), lambda tree: tree["meshes"][0].update(weights=[0.5]))


def set_(*path: Any, value: Any) -> Callable[[Plain], None]:
    """Return a change of one value."""

    def change(tree: Any) -> None:
        for key in path[:-1]:
            tree = tree[key]
        tree[path[-1]] = value

    return change


def masked(**more: Any) -> Plain:
    """Return a material that is cut out."""
    return {**BASE, "alphaMode": "MASK", **more}


COLOUR_MASK: Plain = {"attributes": {"POSITION": "@points", "COLOR_0": "@colours"}, "indices": "@index", "material": 0}
QUANTISED = ["KHR_mesh_quantization"]
BYTES = (POINTS * 100).astype(np.int8)

GLTF_FEATURES = (
    one("triangles, JSON", square(), "Sample Assets Triangle", area=1, polygons=2),
    one("binary container", binary(square()), "Sample Assets Box", area=1, polygons=2),
    one("binary container that is cut off", binary(square(), cut=8), rejected="cut off"),
    FileFeature(
        "glTF",
        "buffer and picture in files with spaces and accents",
        with_external(),
        "Sample Assets Box With Spaces, Unicode❤♻Test",
        1,
        2,
        SHADES,
    ),
    one("buffer that is missing", changed(square(), set_("buffers", 0, "uri", value="no.bin")), rejected="no.bin"),
    one(
        "positions and texture coordinates interleaved",
        interleaved(),
        "Asset Generator Buffer_Interleaved",
        area=1,
        shades=SHADES,
    ),
    one("sparse accessor without a buffer view", sparse(), "Sample Assets SimpleSparseAccessor", area=1, polygons=2),
    mode(4, None, "triangles without indices: 4 vertices", rejected="no multiple of 3"),
    mode(5, [0, 1, 3, 2], "triangle strip", area=1, polygons=2),
    mode(6, [0, 1, 2, 3], "triangle fan", area=1, polygons=2),
    mode(6, None, "triangle fan without indices", area=1, polygons=2),
    mode(1, [0, 1], "lines alone", rejected="no faces"),
    one(
        "strip of one index",
        changed(square({**PLAIN, "mode": 5}), set_("accessors", 1, "count", value=1)),
        "assimp TriangleStripOneIndex.gltf",
        rejected="strip or fan of 1",
    ),
    one(
        "index beyond the vertices",
        square(arrays={"index": np.array([0, 1, 4], dtype=np.uint16)}),
        "assimp IndexOutOfRange.gltf",
        rejected="refers to vertex 4",
    ),
    one(
        "accessor of a wrong type",
        changed(square(), set_("accessors", 0, "type", value="SCALAR")),
        "assimp wrongTypes",
        rejected="of type 'SCALAR' instead of VEC3",
    ),
    one(
        "numbers beyond their buffer view",
        changed(square(), set_("accessors", 0, "count", value=99)),
        rejected="exceed",
    ),
    one(
        "positions that are not finite",
        square(arrays={"points": np.full((4, 3), np.inf, np.float32)}),
        "assimp BoxWithInfinites.glb",
        rejected="not finite",
    ),
    one(
        "quantised positions (KHR_mesh_quantization)",
        square(arrays={"points": BYTES}, extensionsUsed=QUANTISED, extensionsRequired=QUANTISED),
        "Sample Assets AnimatedMorphCube glTF-Quantized",
        area=1e4,
        polygons=2,
    ),
    one(
        "quantised and normalised positions",
        square(PLAIN, ("points",), {"points": np.array(POINTS * 32767, np.int16)}, extensionsUsed=QUANTISED),
        "assimp Triangle-Mesh-Quantized",
        area=1,
        polygons=2,
    ),
    one("integer positions without the extension", square(arrays={"points": BYTES}), rejected="BYTE instead of FLOAT"),
    one(
        "Draco",
        square(extensionsRequired=["KHR_draco_mesh_compression"]),
        "assimp draco/2CylinderEngine.gltf",
        rejected="Draco",
    ),
    one(
        "meshopt",
        square(extensionsUsed=["EXT_meshopt_compression"]),
        "Sample Assets BrainStem glTF-Meshopt",
        rejected="meshopt",
    ),
    one(
        "instances",
        square(extensionsUsed=["EXT_mesh_gpu_instancing"]),
        "Sample Assets SimpleInstancing",
        rejected="instancing",
    ),
    one("unknown extension that is required", square(extensionsRequired=["VENDOR_x"]), rejected="VENDOR_x"),
    one("unknown extension that is used", square(extensionsUsed=["VENDOR_x"]), area=1, note="extension VENDOR_x"),
    one(
        "version 2 that requires 2.1",
        changed(square(), lambda tree: tree["asset"].update(minVersion="2.1")),
        rejected="requires a reader of glTF 2.1",
    ),
    one("version 1", changed(square(), set_("asset", "version", value="1.0")), rejected="version 2"),
    one(
        "moved, scaled and turned nodes",
        nodes(
            {"children": [1], "scale": [2, 3, 1]},
            {**NODE, "translation": [5, 0, 0], "rotation": [0, 0, 0.5**0.5, 0.5**0.5]},
        ),
        "Asset Generator Node_Attribute",
        area=6,
        polygons=2,
    ),
    one("matrix of a node", nodes({**NODE, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1]}), area=4),
    one("negative scale", nodes({**NODE, "scale": [-2, 1, 1]}), "Sample Assets NegativeScaleTest", area=2),
    one("a mesh at two nodes", nodes(NODE, {**NODE, "translation": [3, 0, 0]}, roots=[0, 1]), area=2, polygons=4),
    one(
        "nodes outside the default scene",
        nodes(NODE, {**NODE, "translation": [3, 0, 0]}),
        "Sample Assets MultipleScenes",
        area=1,
    ),
    one(
        "default scene that is not the first",
        changed(
            nodes(NODE, {**NODE, "scale": [2, 2, 2]}),
            lambda tree: tree.update(scenes=[{"nodes": [0]}, {"nodes": [1]}], scene=1),
        ),
        area=4,
    ),
    one(
        "no scene",
        changed(square(), lambda tree: (tree.pop("scenes"), tree.pop("scene"))),
        "assimp NoScene.gltf",
        area=1,
    ),
    one("node below itself", nodes({"children": [0]}), "assimp RecursiveNodes.gltf", rejected="below itself"),
    one("rotation that is no unit quaternion", nodes({**NODE, "rotation": [1, 1, 1, 1]}), rejected="unit quaternion"),
    one("skin", skinned(), "Sample Assets SimpleSkin", area=3, polygons=2),
    one("morph target with a weight", morphed(), "Sample Assets SimpleMorph", area=2, polygons=2),
    one("picture, embedded", pictured(), "Sample Assets BoxTextured", area=1, shades=SHADES),
    one("picture in a buffer view", binary(pictured()), "", area=1, shades=SHADES),
    one(
        "texture coordinates of 16 bits",
        pictured(arrays={"uv": (UV * 65535).astype(np.uint16)}, normalized=("uv",)),
        "Sample Assets BoxTextured",
        area=1,
        shades=SHADES,
    ),
    one(
        "integer texture coordinates that are not normalised",
        pictured(arrays={"uv": (UV * 255).astype(np.uint8)}),
        rejected="TEXCOORD_0 of integers that are not normalized",
    ),
    one(
        "second texture coordinates",
        pictured(
            {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}},
            arrays={"uv": UV * 0, "second": UV},
            primitive={**PICTURED, "attributes": {**PICTURED["attributes"], "TEXCOORD_1": "@second"}},
        ),
        "Sample Assets MultiUVTest",
        area=1,
        shades=SHADES,
    ),
    one(
        "colour factor times picture",
        pictured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1]}}),
        "Asset Generator Material_MetallicRoughness",
        area=1,
        shades=(((0.25, 0.75), linear(0.2) / 2),),
    ),
    one(
        "texture offset",
        transformed(offset=[0.5, 0]),
        "Sample Assets TextureTransformTest",
        area=1,
        shades=(((0.25, 0.75), linear(0.4)),),
    ),
    one("texture scale", transformed(scale=[0.5, 0.5], offset=[0.25, 0.25]), area=1, shades=(((0, 1), linear(0.2)),)),
    one(
        "texture rotation by a quarter, counter-clockwise",
        transformed(rotation=np.pi / 2, offset=[0, 1]),
        "Sample Assets TextureTransformTest",
        area=1,
        shades=(((0.25, 0.75), linear(0.6)), ((0.75, 0.75), linear(0.2))),
    ),
    one(
        "repeated picture",
        pictured(arrays={"uv": UV * 2}),
        "Sample Assets TextureSettingsTest",
        area=1,
        shades=(((0.625, 0.375), linear(0.2)),),
    ),
    one(
        "mirrored picture",
        pictured(
            arrays={"uv": UV * 2}, samplers=[{"wrapS": 33648, "wrapT": 33648}], textures=[{"source": 0, "sampler": 0}]
        ),
        "Asset Generator Texture_Sampler",
        area=1,
        # From u = 1 to 2 and v = 1 to 2 it stands reversed.
        shades=(((0.625, 0.375), linear(0.8)), ((0.125, 0.875), linear(0.2))),
    ),
    one(
        "clamped picture",
        pictured(
            arrays={"uv": UV * 4}, samplers=[{"wrapS": 33071, "wrapT": 33071}], textures=[{"source": 0, "sampler": 0}]
        ),
        "Asset Generator Texture_Sampler",
        area=1,
        shades=(((0.9, 0.1), linear(0.8)),),
    ),
    one(
        "nearest sampler",
        pictured(samplers=[{"magFilter": 9728}], textures=[{"source": 0, "sampler": 0}]),
        area=1,
        shades=SHADES,
        note="without interpolation",
    ),
    one(
        "WebP (EXT_texture_webp)",
        pictured(
            picture=png(np.dstack([GREYS] * 3), "WEBP", lossless=True),
            kind="image/webp",
            textures=[{"extensions": {"EXT_texture_webp": {"source": 0}}}],
            extensionsUsed=["EXT_texture_webp"],
        ),
        "Sample Assets CarConcept glTF-WEBP",
        area=1,
        shades=SHADES,
    ),
    one(
        "KTX2 alone (KHR_texture_basisu)",
        pictured(
            textures=[{"extensions": {"KHR_texture_basisu": {"source": 0}}}], extensionsUsed=["KHR_texture_basisu"]
        ),
        "Sample Assets FlightHelmet glTF-KTX-BasisU",
        rejected="KHR_texture_basisu",
        of_colours=True,
    ),
    one(
        "Exif orientation, which glTF ignores",
        pictured(
            picture=png(
                GREYS,
                exif=b"Exif\x00\x00II*\x00\x08\x00\x00\x00\x01\x00\x12\x01"
                b"\x03\x00\x01\x00\x00\x00\x06\x00\x00\x00\x00\x00\x00\x00",
            )
        ),
        "",
        area=1,
        shades=SHADES,
    ),
    one(
        "gAMA of 1, which glTF ignores",
        pictured(picture=png(GREYS, pnginfo=chunk(b"gAMA", (100000).to_bytes(4, "big")))),
        "",
        area=1,
        shades=SHADES,
    ),
    one(
        "specular-glossiness",
        pictured(
            {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 0}}}},
            extensionsUsed=["KHR_materials_pbrSpecularGlossiness"],
        ),
        "Sample Assets SpecGlossVsMetalRough",
        area=1,
        shades=SHADES,
    ),
    one(
        "unlit",
        pictured({**BASE, "extensions": {"KHR_materials_unlit": {}}}, extensionsUsed=["KHR_materials_unlit"]),
        "Sample Assets UnlitTest",
        area=1,
        shades=SHADES,
    ),
    one(
        "metallic reflection",
        pictured({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 1}}),
        "Sample Assets CompareMetallic",
        area=1,
        shades=SHADES,
        note="metallic reflection",
    ),
    one(
        "normal map",
        pictured({**BASE, "normalTexture": {"index": 0}}),
        "Sample Assets CompareNormal",
        area=1,
        note="normalTexture",
    ),
    one(
        "colours of vertices, float",
        coloured(np.float32, 3),
        "Sample Assets BoxVertexColors",
        area=1,
        shades=((MIDDLE, GREEN / 2),),
    ),
    one(
        "colours of vertices, 8 bits with opacity",
        coloured(np.uint8, 4),
        "Asset Generator Mesh_PrimitiveVertexColor",
        area=1,
        shades=((MIDDLE, GREEN),),
    ),
    one(
        "colours of vertices, 16 bits",
        coloured(np.uint16, 3),
        "Asset Generator Mesh_PrimitiveVertexColor",
        area=1,
        shades=((MIDDLE, GREEN),),
    ),
    one(
        "colours of vertices, 16 bits that are not declared normalised",
        coloured(np.uint16, 4, stated=False),
        "godot issue 44798",
        area=1,
        shades=((MIDDLE, GREEN),),
    ),
    one(
        "colours of vertices times a picture",
        pictured(
            arrays={"uv": UV, "colours": np.full((4, 3), 0.5, np.float32)},
            primitive={**PICTURED, "attributes": {**PICTURED["attributes"], "COLOR_0": "@colours"}},
        ),
        "Sample Assets VertexColorTest",
        area=1,
        rejected="multiply a picture",
        of_colours=True,
    ),
    one("alphaMode OPAQUE", pictured(BASE, RAMP), "Asset Generator Material_Alpha", area=1, shades=((MIDDLE, 1.0),)),
    one(
        "alphaMode MASK at 1/2",
        pictured(masked(), RAMP),
        "Sample Assets CompareAlphaCoverage",
        area=0.5,
        note="cut along",
    ),
    # Opacity is 1 - (u - 1/8) 4/3 between the outer texels: 1/4 at u = 11/16.
    # The picture is repeated: from u = 7/8 it rises to 1 within 1/4, and is 1/4 at u = 15/16.
    one(
        "alphaMode MASK at 1/4",
        pictured(masked(alphaCutoff=0.25), RAMP),
        "Asset Generator Material_AlphaMask",
        area=0.75,
    ),
    one(
        "alphaMode MASK times the opacity of the colour factor",
        pictured(
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, 0.5]},
                "alphaMode": "MASK",
                "alphaCutoff": 0.25,
            },
            RAMP,
        ),
        "",
        area=0.5,
    ),
    one(
        "alphaMode MASK with opacities of vertices",
        square(COLOUR_MASK, (), {"colours": np.full((4, 4), 0.25, np.float32)}, materials=[{"alphaMode": "MASK"}]),
        "",
        rejected="opacities of vertices",
    ),
    one(
        "alphaMode MASK that leaves nothing",
        pictured(masked(), opacity([[9, 9], [9, 9]])),
        rejected="transparent everywhere",
    ),
    one(
        "alphaMode that glTF does not have",
        pictured({**BASE, "alphaMode": "HASHED"}),
        area=1,
        rejected="alphaMode 'HASHED'",
        of_colours=True,
    ),
    one(
        "alphaMode BLEND of an opaque picture",
        pictured({**BASE, "alphaMode": "BLEND"}),
        "Sample Assets AlphaBlendModeTest",
        area=1,
        rejected="alphaMode BLEND",
        of_colours=True,
    ),
    one(
        "alphaMode BLEND of a transparent picture",
        pictured({**BASE, "alphaMode": "BLEND"}, RAMP),
        rejected="alphaMode BLEND",
    ),
    one(
        "hidden nodes (KHR_node_visibility)",
        nodes(
            {"children": [1], "extensions": {"KHR_node_visibility": {"visible": False}}},
            NODE,
            {**NODE, "translation": [3, 0, 0]},
            roots=[0, 2],
            extensionsUsed=["KHR_node_visibility"],
        ),
        "Sample Assets CubeVisibility",
        area=1,
        polygons=2,
    ),
    one(
        "card of two faces",
        square({**PLAIN}, (), {"index": np.array([0, 1, 2, 0, 2, 3, 2, 1, 0, 3, 2, 0], np.uint16)}),
        "Sample Assets TwoSidedPlane",
        area=1,
        note="stand twice",
    ),
)
