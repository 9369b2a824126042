"""Meshes of glTF files: primitives, skins and morph targets at rest, materials."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.file_preflight import MAX_ELEMENTS
from scenetruth.scene.mesh.gltf_document import GltfDocument
from scenetruth.scene.mesh.polygon_mesh import FileGloss, FileMaterial, MeshFileError, PolygonMesh, TextureMap

__all__ = ["read_gltf"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Plain = dict[str, Any]

_BYTE, _UNSIGNED_BYTE, _SHORT, _UNSIGNED_SHORT, _UNSIGNED_INT, _FLOAT = 5120, 5121, 5122, 5123, 5125, 5126
_ANY_SIZE = (_FLOAT, _BYTE, _UNSIGNED_BYTE, _SHORT, _UNSIGNED_SHORT)  # with KHR_mesh_quantization
_UNIT = (_FLOAT, _UNSIGNED_BYTE, _UNSIGNED_SHORT)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST = 9728
_GLOSS = ("ior", "specular", "clearcoat", "diffuse_transmission")  # extensions of materials that change reflection
_READ_MATERIALS = (
    "KHR_materials_unlit",
    "KHR_materials_pbrSpecularGlossiness",
    *(f"KHR_materials_{name}" for name in _GLOSS),
)
_MOST_AMPLITUDE = 0.6  # of the reflected field, for the largest refractive index, 4
_LEAST_ROUGHNESS = 0.01  # of surfaces without roughness, whose highlights are points
_OPAQUE_ALPHA = 0.5  # cut-off if none is given
_UNUSED_MAPS = ("normalTexture", "occlusionTexture", "emissiveTexture")


@dataclass
class _Parts:
    """What the primitives have in common, one list entry for each."""

    vertices: list[Floats] = field(default_factory=list)
    triangles: list[Indices] = field(default_factory=list)
    normals: list[Floats | None] = field(default_factory=list)
    uv: list[Floats | None] = field(default_factory=list)
    colours: list[Floats | None] = field(default_factory=list)
    material: list[int] = field(default_factory=list)
    ignored: dict[str, None] = field(default_factory=dict)


def read_gltf(file: Path) -> PolygonMesh:
    """Read the triangles of the default scene of a glTF file, in its rest pose.

    Raises
    ------
    MeshFileError
        If an accessor, a node or an extension cannot be read without doubt.
    """
    document = GltfDocument(file)
    parts, materials = _Parts(), list[FileMaterial]()
    numbers: dict[Any, int] = {}
    for name in document.unread_extensions:
        parts.ignored[f"extension {name}"] = None
    nodes = dict(document.shown_nodes)
    for index, matrix in nodes.items():
        node = document.entry("nodes", index)
        if "mesh" not in node:
            continue
        mesh = document.entry("meshes", node["mesh"])
        primitives = mesh.get("primitives")
        if not isinstance(primitives, list) or not all(isinstance(each, dict) for each in primitives):
            msg = f"has mesh {node['mesh']} without primitives"
            raise MeshFileError(msg)
        for primitive in primitives:
            mode = primitive.get("mode", _TRIANGLES)
            if mode in (0, 1, 2, 3):
                parts.ignored["points or lines"] = None
                continue
            weights = node.get("weights", mesh.get("weights"))
            _add_primitive(document, parts, primitive, node, matrix, nodes, weights)
            own = primitive.get("material")
            if own is not None and own not in numbers:
                numbers[own] = len(materials)
                materials.append(_material(document, own, parts.ignored))
            number = -1 if own is None else numbers[own]
            parts.material.append(number)
            parts.uv.append(_texture_coordinates(document, primitive, own, len(parts.vertices[-1])))
    return _assemble(document, parts, tuple(materials))


def _assemble(document: GltfDocument, parts: _Parts, materials: tuple[FileMaterial, ...]) -> PolygonMesh:
    """Return the mesh of all primitives."""
    if not parts.triangles:
        msg = "has no faces"
        raise MeshFileError(msg)
    first = np.cumsum([0, *(len(each) for each in parts.vertices[:-1])])
    triangles = np.concatenate([own + n for own, n in zip(parts.triangles, first, strict=True)])
    corners = triangles.reshape(-1)
    vertices = np.concatenate(parts.vertices)
    if max(len(vertices), len(triangles)) > MAX_ELEMENTS:
        msg = f"has {len(vertices):,} vertices and {len(triangles):,} faces; the maximum is {MAX_ELEMENTS:,}"
        raise MeshFileError(msg)
    if document.tree.get("animations"):
        parts.ignored["animations (see vertex_animation for those of morph targets)"] = None

    def of_corners(lists: list[Floats | None], width: int) -> Floats | None:
        if all(each is None for each in lists):
            return None
        made = [
            np.full((len(own), width), np.nan) if each is None else each
            for own, each in zip(parts.vertices, lists, strict=True)
        ]
        return np.asarray(np.concatenate(made)[corners])

    colours = of_corners(parts.colours, 3)
    return PolygonMesh(
        vertices,
        corners,
        np.arange(0, len(corners) + 1, 3),
        of_corners(parts.uv, 2),
        of_corners(parts.normals, 3),
        # Without colours, the factor is 1.
        None if colours is None else np.where(np.isnan(colours), 1.0, colours),
        materials,
        np.repeat(parts.material, [len(each) for each in parts.triangles]),
        tuple(parts.ignored),
    )


def _add_primitive(
    document: GltfDocument,
    parts: _Parts,
    primitive: Plain,
    node: Plain,
    matrix: Floats,
    nodes: dict[int, Floats],
    weights: Any,
) -> None:
    """Add vertices, triangles, normals and colours of a primitive in the frame of the file."""
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        msg = "has a primitive without POSITION"
        raise MeshFileError(msg)
    quantised = "KHR_mesh_quantization" in document.tree.get("extensionsUsed", [])
    allowed = _ANY_SIZE if quantised else (_FLOAT,)
    position = document.accessor(attributes["POSITION"], ("VEC3",), allowed, "POSITION").astype(np.float64)
    count = len(position)
    finite = np.isfinite(position).all(axis=1)
    if not finite.all():
        msg = f"has {np.count_nonzero(~finite)} vertices that are not finite"
        raise MeshFileError(msg)
    normal = None
    if "NORMAL" in attributes:
        normal = document.accessor(attributes["NORMAL"], ("VEC3",), allowed, "NORMAL").astype(np.float64)
        _check_count(normal, count, "NORMAL")
    position, normal = _morphed(document, primitive, position, normal, weights, allowed)
    linear = matrix[:3, :3]
    if "skin" in node:
        position, normal = _skinned(document, attributes, node["skin"], nodes, position, normal)
    else:
        position = position @ linear.T + matrix[:3, 3]
        # Normals transform by the cofactor matrix of the point transform.
        normal = None if normal is None else normal @ np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]]).T
    triangles = _triangles(document, primitive, count)
    if "skin" not in node and np.linalg.det(linear) < 0:
        # A mirrored node keeps its outside.
        triangles = triangles[:, ::-1]
    parts.vertices.append(position)
    parts.triangles.append(triangles)
    parts.normals.append(normal)
    colour = None
    if "COLOR_0" in attributes:
        # Integers are always normalised; some exporters omit to say so.
        kinds = ("VEC3", "VEC4")
        colour = document.accessor(attributes["COLOR_0"], kinds, _UNIT, "COLOR_0", normalized=True).astype(np.float64)
        _check_count(colour, count, "COLOR_0")
        if colour.shape[1] == 4 and (colour[:, 3] < 1).any() and _mode_of(document, primitive) == "MASK":
            msg = "has opacities of vertices (COLOR_0) in a material of alphaMode MASK; put them into its picture"
            raise MeshFileError(msg)
        colour = colour[:, :3]
        if not ((colour >= 0) & (colour <= 1)).all():
            msg = "has COLOR_0 outside 0 to 1"
            raise MeshFileError(msg)
    parts.colours.append(colour)
    for name in attributes:
        if name.startswith(("COLOR_", "TEXCOORD_")) and name not in ("COLOR_0", "TEXCOORD_0"):
            parts.ignored.setdefault(f"attribute {name}, unless a texture uses it", None)


def _mode_of(document: GltfDocument, primitive: Plain) -> str:
    """Return the alphaMode of the material of a primitive."""
    own = primitive.get("material")
    return "OPAQUE" if own is None else str(document.entry("materials", own).get("alphaMode", "OPAQUE"))


def _check_count(values: NDArray[Any], count: int, what: str) -> None:
    if len(values) != count:
        msg = f"has {what} for {len(values):,} of {count:,} vertices"
        raise MeshFileError(msg)


def _triangles(document: GltfDocument, primitive: Plain, vertices: int) -> Indices:
    """Return the triangles of a list, strip or fan, shape (m, 3)."""
    mode = primitive.get("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        msg = f"has a primitive of mode {mode!r}"
        raise MeshFileError(msg)
    if "indices" in primitive:
        kinds = (_UNSIGNED_BYTE, _UNSIGNED_SHORT, _UNSIGNED_INT)
        index = document.accessor(primitive["indices"], ("SCALAR",), kinds, "indices")[:, 0].astype(np.int64)
    else:
        index = np.arange(vertices)
    if len(index) and index.max() >= vertices:
        face = int(np.argmax(index >= vertices)) // 3 + 1
        msg = f"has face {face} that refers to vertex {index.max()} of its primitive, from 0: there are {vertices:,}"
        raise MeshFileError(msg)
    if mode == _TRIANGLES:
        if len(index) % 3:
            msg = f"has {len(index):,} indices of triangles, which is no multiple of 3"
            raise MeshFileError(msg)
        return index.reshape(-1, 3)
    if len(index) < 3:
        msg = f"has a strip or fan of {len(index)} vertices"
        raise MeshFileError(msg)
    if mode == _FAN:
        return np.column_stack([np.broadcast_to(index[0], len(index) - 2), index[1:-1], index[2:]])
    strip = np.column_stack([index[:-2], index[1:-1], index[2:]])
    # Every other triangle of a strip has the opposite orientation.
    strip[1::2] = strip[1::2][:, [1, 0, 2]]
    return strip


def _morphed(
    document: GltfDocument,
    primitive: Plain,
    position: Floats,
    normal: Floats | None,
    weights: Any,
    allowed: tuple[int, ...],
) -> tuple[Floats, Floats | None]:
    """Return positions and normals with the morph targets at their default weights."""
    targets = primitive.get("targets", [])
    if not weights or not targets:
        return position, normal
    if not isinstance(weights, list) or len(weights) != len(targets):
        msg = f"has {len(targets)} morph targets and weights {weights!r}"
        raise MeshFileError(msg)
    position = position.copy()
    for weight, target in zip(weights, targets, strict=True):
        for name, values in (("POSITION", position), ("NORMAL", normal)):
            if weight and values is not None and name in target:
                moves = document.accessor(target[name], ("VEC3",), allowed, f"morph target {name}").astype(np.float64)
                _check_count(moves, len(position), f"morph target {name}")
                values += weight * moves
    return position, normal


def _skinned(
    document: GltfDocument,
    attributes: Plain,
    index: Any,
    nodes: dict[int, Floats],
    position: Floats,
    normal: Floats | None,
) -> tuple[Floats, Floats | None]:
    """Return positions and normals that follow the joints of a skin in their rest pose."""
    skin = document.entry("skins", index)
    joints = skin.get("joints", [])
    if not isinstance(joints, list) or not all(joint in nodes for joint in joints):
        msg = f"has skin {index} whose joints are not in its scene"
        raise MeshFileError(msg)
    inverse = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    if "inverseBindMatrices" in skin:
        values = document.accessor(skin["inverseBindMatrices"], ("MAT4",), (_FLOAT,), "inverseBindMatrices")
        _check_count(values, len(joints), "inverseBindMatrices")
        inverse = values.reshape(-1, 4, 4).transpose(0, 2, 1)
    world = np.stack([nodes[joint] for joint in joints]) @ inverse
    total = np.zeros((len(position), 4, 4))
    share = np.zeros(len(position))
    for place in range(8):
        if f"JOINTS_{place}" not in attributes:
            break
        name = f"WEIGHTS_{place}"
        own = document.accessor(attributes[f"JOINTS_{place}"], ("VEC4",), (_UNSIGNED_BYTE, _UNSIGNED_SHORT), "JOINTS")
        weight = document.accessor(attributes.get(name), ("VEC4",), _UNIT, name).astype(np.float64)
        _check_count(own, len(position), f"JOINTS_{place}")
        _check_count(weight, len(position), name)
        if own.max() >= len(joints):
            msg = f"has JOINTS_{place} of a joint {own.max()}: skin {index} has {len(joints)}"
            raise MeshFileError(msg)
        total += np.einsum("nk,nkij->nij", weight, world[own.astype(np.int64)])
        share += weight.sum(axis=1)
    if not (share > 0).all():
        msg = f"has vertices without a joint of skin {index}"
        raise MeshFileError(msg)
    total /= share[:, None, None]
    position = np.einsum("nij,nj->ni", total[:, :3, :3], position) + total[:, :3, 3]
    if normal is not None:
        linear = total[:, :3, :3]
        cofactor = np.cross(linear[:, [1, 2, 0]], linear[:, [2, 0, 1]])
        normal = np.einsum("nij,nj->ni", cofactor, normal)
    return position, normal


def _texture_coordinates(document: GltfDocument, primitive: Plain, material: Any, count: int) -> Floats | None:
    """Return the texture coordinates of the vertices of a primitive with v upwards, shape (n, 2), or None."""
    number = 0
    if material is not None:
        _, number = _base_texture(document.entry("materials", material))
    name = f"TEXCOORD_{number}"
    if name not in primitive["attributes"]:
        return None
    quantised = "KHR_mesh_quantization" in document.tree.get("extensionsUsed", [])
    allowed = _ANY_SIZE if quantised else _UNIT
    index = primitive["attributes"][name]
    values = document.accessor(index, ("VEC2",), allowed, name)
    if values.dtype.kind != "f" and not quantised:
        msg = f"has {name} of integers that are not normalized, which requires KHR_mesh_quantization (accessor {index})"
        raise MeshFileError(msg)
    values = values.astype(np.float64)
    _check_count(values, count, name)
    # v increases downwards in glTF.
    return values * (1, -1) + (0, 1)


def _base_texture(material: Plain) -> tuple[Plain | None, int]:
    """Return the texture of the diffuse colour of a material, and the number of its texture coordinates."""
    glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    texture = glossy.get("diffuseTexture", material.get("pbrMetallicRoughness", {}).get("baseColorTexture"))
    if not isinstance(texture, dict):
        return None, 0
    moved = texture.get("extensions", {}).get("KHR_texture_transform", {})
    return texture, int(moved.get("texCoord", texture.get("texCoord", 0)))


_ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")


def _material(document: GltfDocument, index: Any, ignored: dict[str, None]) -> FileMaterial:
    """Return a material; what cannot be shown is its problem."""
    entry = document.entry("materials", index)
    name = str(entry.get("name", index))
    where = f'material "{name}"'
    for key in _UNUSED_MAPS:
        if key in entry:
            ignored[key] = None
    ignored.update({f"material extension {key}": None for key in entry.get("extensions", {})
                    if key not in _READ_MATERIALS})  # fmt: skip
    metallic = entry.get("pbrMetallicRoughness", {})
    if metallic.get("metallicFactor", 0) != 0 or "metallicRoughnessTexture" in metallic:
        ignored["metallic reflection, unless the object has `material: {from_file: true}`"] = None
    mode = entry.get("alphaMode", "OPAQUE")
    try:
        glossy = entry.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        factor = glossy.get("diffuseFactor", entry.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1]))
        colour = np.array(factor, dtype=np.float64)
        if colour.shape != (4,) or not ((colour >= 0) & (colour <= 1)).all():
            msg = f"has {where} whose colour factor is {factor!r}"
            raise MeshFileError(msg)
        texture, _ = _base_texture(entry)
        picture = None if texture is None else _texture_map(document, texture, ignored)
    except ValueError as error:
        return FileMaterial(name, problem=f"{where}: {error}")
    cutoff = None
    if mode not in _ALPHA_MODES:
        message = f"{where} has the alphaMode {mode!r}, which is none of {', '.join(_ALPHA_MODES)}"
        return FileMaterial(
            name, picture=picture, problem=message, outline_problem=None if picture is None else message
        )
    if mode == "BLEND":
        remedy = "use alphaMode MASK, which cuts the surface out, or OPAQUE"
        message = f"{where} is translucent (alphaMode BLEND), which is not shown: {remedy}"
        # A transparent picture also hides parts of the surface, whose outline is not defined.
        return FileMaterial(
            name, picture=picture, problem=message, outline_problem=None if picture is None else message
        )
    if mode == "MASK":
        cutoff = float(entry.get("alphaCutoff", _OPAQUE_ALPHA))
        cutoff = cutoff / colour[3] if colour[3] > 0 else math.inf
    gloss = gloss_problem = None
    try:
        gloss = _gloss(entry)
    except (TypeError, ValueError) as error:
        gloss_problem = f"{where}: {error}"
    return FileMaterial(
        name, (colour[0], colour[1], colour[2]), picture, cutoff, gloss=gloss, gloss_problem=gloss_problem
    )


def _gloss(entry: Plain) -> FileGloss | None:
    """Return the gloss and transmission of a material; None if it is unlit.

    Raises ValueError if they vary over the surface, or cannot be shown.
    """
    extensions = entry.get("extensions", {})
    if "KHR_materials_unlit" in extensions or "KHR_materials_pbrSpecularGlossiness" in extensions:
        return None
    base = entry.get("pbrMetallicRoughness", {})
    parts = {name: extensions.get(f"KHR_materials_{name}", {}) for name in _GLOSS}
    maps = [name for part in (base, *parts.values()) for name in part if name.endswith("Texture")]
    varying = sorted(set(maps) - {"baseColorTexture"})
    if varying:
        msg = f"gloss that varies over the surface is not read ({', '.join(varying)}); bake it into one value"
        raise ValueError(msg)
    numbers = {
        "metallicFactor": base.get("metallicFactor", 1),
        "roughnessFactor": base.get("roughnessFactor", 1),
        "clearcoatFactor": parts["clearcoat"].get("clearcoatFactor", 0),
        "clearcoatRoughnessFactor": parts["clearcoat"].get("clearcoatRoughnessFactor", 0),
        "diffuseTransmissionFactor": parts["diffuse_transmission"].get("diffuseTransmissionFactor", 0),
        "ior": parts["ior"].get("ior", 1.5),
        "specularFactor": parts["specular"].get("specularFactor", 1),
        "specularColorFactor": parts["specular"].get("specularColorFactor", (1, 1, 1)),
    }
    problems = [problem for name, value in numbers.items() if (problem := _number_problem(name, value))]
    if problems:
        raise ValueError("; ".join(problems))
    metallic, rough, coat, coat_rough, passed, index, specular = (
        float(value) for name, value in numbers.items() if name != "specularColorFactor"
    )
    specular *= float(np.mean(numbers["specularColorFactor"]))
    if coat > 0:
        if coat < 1 or metallic > 0:
            msg = "a clear coat of a part of the surface, or on metal, is not simulated"
            raise ValueError(msg)
        # The coat has the index 1.5; between it and a base of that index, nothing is reflected.
        index, specular, rough = 1.5, 1.0, coat_rough
    amplitude = min(math.sqrt(specular) * (index - 1) / (index + 1), _MOST_AMPLITUDE)
    roughness = max(rough**2, _LEAST_ROUGHNESS)
    return FileGloss((1 + amplitude) / (1 - amplitude), roughness, metallic, 1 - passed, passed)


def _number_problem(name: str, value: Any) -> str:
    """Return why a value of a material is out of its range; empty if it is not."""
    try:
        given = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.array(math.nan)
    size = (3,) if name == "specularColorFactor" else ()
    low, high = (1.0, math.inf) if name == "ior" else (0.0, math.inf if name == "specularColorFactor" else 1.0)
    if given.shape == size and np.isfinite(given).all() and ((given >= low) & (given <= high)).all():
        return ""
    allowed = f"at least {low:g}" if high == math.inf else f"from {low:g} to {high:g}"
    what = "must be three numbers" if size else "must be a number"
    return f"{name} {what} {allowed}, and is {value!s:.60}"


def _texture_map(document: GltfDocument, texture: Plain, ignored: dict[str, None]) -> TextureMap:
    """Return the picture of a texture with its transform and sampler."""
    entry = document.entry("textures", texture.get("index"))
    own = entry.get("extensions", {})
    source = own.get("EXT_texture_webp", {}).get("source", entry.get("source"))
    if source is None:
        msg = f"its texture {texture.get('index')} has no picture that is read ({', '.join(own) or 'no source'})"
        raise MeshFileError(msg)
    image = document.entry("images", source)
    if "uri" in image:
        content = document.named_bytes(str(image["uri"]), f"picture {source}")
    else:
        content = document.view_bytes(image.get("bufferView"))
    sampler = document.entry("samplers", entry["sampler"]) if "sampler" in entry else {}
    wraps = [sampler.get(key, 10497) for key in ("wrapS", "wrapT")]
    if not all(wrap in _WRAPS for wrap in wraps):
        msg = f"its sampler has the wrap modes {wraps}"
        raise MeshFileError(msg)
    if sampler.get("magFilter") == _NEAREST:
        ignored["sampler without interpolation (nearest): texels are interpolated"] = None
    moved = texture.get("extensions", {}).get("KHR_texture_transform", {})
    try:
        (right, down), (wide, high) = moved.get("offset", (0.0, 0.0)), moved.get("scale", (1.0, 1.0))
        turn = float(moved.get("rotation", 0.0))
        # Counter-clockwise as seen in the picture, where v increases downwards: as the examples of the specification
        # and its test model have it, and opposite to its formula.
        cosine, sine = math.cos(turn), math.sin(turn)
        transform = (
            cosine * wide,
            -sine * high,
            right + sine * high,
            sine * wide,
            cosine * high,
            1 - down - cosine * high,
        )
    except (TypeError, ValueError) as error:
        msg = "its texture has a transform that is not offset, rotation and scale"
        raise MeshFileError(msg) from error
    return TextureMap(content=content, transform=transform, wrap=(_WRAPS[wraps[0]], _WRAPS[wraps[1]]))
