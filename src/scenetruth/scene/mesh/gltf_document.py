"""glTF 2.0 documents: buffers, accessors and nodes (https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html)."""

from __future__ import annotations

import base64
import binascii
import json
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.file_preflight import MAX_ELEMENTS, read_checked_bytes
from scenetruth.scene.mesh.polygon_mesh import MeshFileError

__all__ = ["GltfDocument"]

Floats = NDArray[np.float64]
Plain = dict[str, Any]

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_NAMES = {
    5120: "BYTE",
    5121: "UNSIGNED_BYTE",
    5122: "SHORT",
    5123: "UNSIGNED_SHORT",
    5125: "UNSIGNED_INT",
    5126: "FLOAT",
}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_GLB_JSON, _GLB_BINARY = 0x4E4F534A, 0x004E4942

READ_EXTENSIONS = frozenset(
    {
        "KHR_mesh_quantization",
        "KHR_texture_transform",
        "KHR_materials_unlit",
        "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_ior",
        "KHR_materials_specular",
        "KHR_materials_clearcoat",
        "KHR_materials_diffuse_transmission",
        "EXT_texture_webp",
        "KHR_lights_punctual",
        "KHR_node_visibility",
        "KHR_xmp_json_ld",
    }
)
"""Extensions that are read, or that have no effect on the shape and the diffuse reflectance of a surface."""
_REMEDIES = {
    "KHR_draco_mesh_compression": "its meshes are compressed by Draco; export it without compression",
    "EXT_meshopt_compression": "its buffers are compressed by meshopt; export it without compression",
    "KHR_meshopt_compression": "its buffers are compressed by meshopt; export it without compression",
    "EXT_mesh_gpu_instancing": "it repeats meshes (instancing); export it with real copies",
    "KHR_texture_basisu": "its pictures are KTX2 files; export them as PNG",
}
_CHANGES_SHAPE = ("EXT_mesh_gpu_instancing", "EXT_meshopt_compression", "KHR_meshopt_compression")


class GltfDocument:
    """A glTF file with its buffers.

    Raises
    ------
    MeshFileError
        If the container or the JSON cannot be read, or the file requires an extension that is not read.
    """

    def __init__(self, file: Path) -> None:
        self.file, self._binary = file, b""
        content = read_checked_bytes(file)
        if content[:4] == b"glTF":
            content = self._unpack(content)
        try:
            tree = json.loads(content.removeprefix(b"\xef\xbb\xbf"))
        except (ValueError, RecursionError) as error:
            msg = f"has no JSON that can be read: {error}"
            raise MeshFileError(msg) from error
        if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
            msg = "is no glTF file: it has no asset"
            raise MeshFileError(msg)
        version = str(tree["asset"].get("minVersion", tree["asset"].get("version", "")))
        if version.split(".")[0] != "2":
            msg = f'is glTF of version "{version}"; only version 2 is read'
            raise MeshFileError(msg)
        least = str(tree["asset"].get("minVersion", "2.0"))
        if least != "2.0":
            msg = f"requires a reader of glTF {least} (asset.minVersion); version 2.0 is read"
            raise MeshFileError(msg)
        self.tree: Plain = tree
        self._check_extensions()

    def _unpack(self, content: bytes) -> bytes:
        """Return the JSON of a binary container, and keep its buffer."""
        if len(content) < 20:
            msg = "is cut off"
            raise MeshFileError(msg)
        length = int.from_bytes(content[8:12], "little")
        if length > len(content):
            msg = f"declares {length:,} bytes and has {len(content):,}: it is cut off"
            raise MeshFileError(msg)
        at, text = 12, None
        while at + 8 <= length:
            size, kind = (int(number) for number in np.frombuffer(content, "<u4", 2, at))
            if at + 8 + size > length:
                msg = "has a part that is cut off"
                raise MeshFileError(msg)
            part = content[at + 8 : at + 8 + size]
            if kind == _GLB_JSON and text is None:
                text = part
            elif kind == _GLB_BINARY and not self._binary:
                self._binary = part
            at += 8 + size
        if text is None:
            msg = "has no JSON part"
            raise MeshFileError(msg)
        return text

    def _check_extensions(self) -> None:
        required = self._names("extensionsRequired")
        used = self._names("extensionsUsed")
        refused = [name for name in required if name not in READ_EXTENSIONS]
        refused += [name for name in used if name in _CHANGES_SHAPE and name not in refused]
        if refused:
            reasons = "; ".join(_REMEDIES.get(name, "it is not read; export the file without it") for name in refused)
            verb = "requires" if any(name in required for name in refused) else "uses"
            msg = f"{verb} the extension {', '.join(refused)}: {reasons}"
            raise MeshFileError(msg)

    def _names(self, key: str) -> list[str]:
        names = self.tree.get(key, [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            msg = f"has {key} that is no list of names"
            raise MeshFileError(msg)
        return names

    @cached_property
    def unread_extensions(self) -> list[str]:
        """Extensions that are used, but not read."""
        return [name for name in self._names("extensionsUsed") if name not in READ_EXTENSIONS]

    def entry(self, kind: str, index: Any) -> Plain:
        """Return an entry of a list of the document."""
        entries = self.tree.get(kind)
        count = len(entries) if isinstance(entries, list) else 0
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < count:
            msg = f"refers to {kind} {index!r}, of which there are {count}"
            raise MeshFileError(msg)
        assert isinstance(entries, list)
        if not isinstance(entries[index], dict):
            msg = f"has {kind} {index} that is no object"
            raise MeshFileError(msg)
        return dict(entries[index])

    def named_bytes(self, uri: str, what: str) -> bytes:
        """Return the content of a data URI, or of a file in the folder of the document."""
        if uri.startswith("data:"):
            head, _, data = uri.partition(",")
            try:
                return base64.b64decode(data, validate=True) if head.endswith(";base64") else unquote(data).encode()
            except (binascii.Error, ValueError) as error:
                msg = f"has {what} whose base64 data cannot be read"
                raise MeshFileError(msg) from error
        try:
            return read_checked_bytes(self.file.parent / unquote(uri))
        except (OSError, ValueError) as error:
            msg = f'has {what} in the file "{uri}", which cannot be read: {error}'
            raise MeshFileError(msg) from error

    def list_references(self) -> list[Path]:
        """Return the files of buffers and pictures."""
        entries = [entry for kind in ("buffers", "images") for entry in _list(self.tree, kind)]
        names = [entry.get("uri") for entry in entries if isinstance(entry, dict)]
        plain = [name for name in names if isinstance(name, str) and not name.startswith("data:")]
        return [self.file.parent / unquote(name) for name in plain]

    def _buffer(self, index: Any) -> bytes:
        if not hasattr(self, "_buffers"):
            self._buffers: dict[int, bytes] = {}
        if index not in self._buffers:
            uri = self.entry("buffers", index).get("uri")
            if uri is None and index != 0:
                msg = f"has buffer {index} without a uri; only the first may be that of the binary container"
                raise MeshFileError(msg)
            self._buffers[index] = self._binary if uri is None else self.named_bytes(str(uri), f"buffer {index}")
        return self._buffers[index]

    def view_bytes(self, index: Any) -> bytes:
        """Return the bytes of a buffer view."""
        view = self.entry("bufferViews", index)
        data = self._buffer(view.get("buffer"))
        start, length = _whole(view.get("byteOffset", 0)), _whole(view.get("byteLength", -1))
        if start < 0 or length < 0 or start + length > len(data):
            msg = f"has buffer view {index} of {length:,} bytes from {start:,} in a buffer of {len(data):,}"
            raise MeshFileError(msg)
        return data[start : start + length]

    def _rows(self, place: Plain, dtype: np.dtype[Any], count: int, size: int, what: str) -> NDArray[Any]:
        """Return count x size numbers of a buffer view."""
        data = self.view_bytes(place.get("bufferView"))
        element = dtype.itemsize * size
        stride = _whole(self.entry("bufferViews", place.get("bufferView")).get("byteStride", element))
        start = _whole(place.get("byteOffset", 0))
        if stride < element or start < 0 or start + (count - 1) * stride + element > len(data):
            msg = f"has {what} of {count:,} x {size} numbers that exceed their buffer view of {len(data):,} bytes"
            raise MeshFileError(msg)
        raw = np.frombuffer(data, np.uint8, (count - 1) * stride + element, start)
        rows = np.lib.stride_tricks.as_strided(raw, (count, element), (stride, 1))
        return np.ascontiguousarray(rows).view(dtype)

    def accessor(
        self, index: Any, kinds: tuple[str, ...], components: tuple[int, ...], what: str, *, normalized: bool = False
    ) -> NDArray[Any]:
        """Return the values of an accessor of one of the types, shape (count, size), as float64 if normalised or float.

        ``kinds``: Allowed types, such as VEC3.
        ``components``: Allowed component types; integers that are not normalised stay integers.
        ``normalized``: Whether integers are normalised by the definition of the attribute, whatever the entry says.
        """
        entry = self.entry("accessors", index)
        kind, component, count = entry.get("type"), entry.get("componentType"), entry.get("count")
        if kind not in kinds or not isinstance(kind, str):
            msg = f"has {what} of type {kind!r} instead of {' or '.join(kinds)} (accessor {index})"
            raise MeshFileError(msg)
        if component not in components or not isinstance(component, int):
            allowed = ", ".join(_NAMES[each] for each in components)
            stated = _NAMES.get(component, component) if isinstance(component, int) else component
            msg = f"has {what} of component type {stated} instead of {allowed} (accessor {index})"
            raise MeshFileError(msg)
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MAX_ELEMENTS:
            msg = f"has {what} of {count!r} elements (accessor {index})"
            raise MeshFileError(msg)
        dtype, size = np.dtype(_TYPES[component]), _SIZES[kind]
        if "bufferView" in entry:
            values = self._rows(entry, dtype, count, size, what)
        else:
            values = np.zeros((count, size), dtype)
        if "sparse" in entry:
            values = self._replaced(entry["sparse"], values, what)
        if (normalized or entry.get("normalized") is True) and dtype.kind in "iu":
            return np.maximum(values.astype(np.float64) / np.iinfo(dtype).max, -1.0)
        return values.astype(np.float64) if dtype.kind == "f" else values

    def _replaced(self, sparse: Any, values: NDArray[Any], what: str) -> NDArray[Any]:
        """Return values of which some are replaced by those of a sparse accessor."""
        try:
            places, replaced, count = sparse["indices"], sparse["values"], sparse["count"]
            kind = np.dtype(_TYPES[places["componentType"]])
        except (TypeError, KeyError) as error:
            msg = f"has {what} with sparse values that are incomplete"
            raise MeshFileError(msg) from error
        if kind.kind != "u" or isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= len(values):
            msg = f"has {what} with {count!r} sparse values of {len(values):,}"
            raise MeshFileError(msg)
        at = self._rows(places, kind, count, 1, what)[:, 0].astype(np.int64)
        if at.max() >= len(values) or (np.diff(at) <= 0).any():
            msg = f"has {what} whose sparse indices do not increase, or exceed {len(values):,} elements"
            raise MeshFileError(msg)
        values = values.copy()
        values[at] = self._rows(replaced, values.dtype, count, values.shape[1], what)
        return values

    @cached_property
    def shown_nodes(self) -> list[tuple[int, Floats]]:
        """Nodes of the default scene, parents first, with their transforms to the frame of the file, shape (4, 4)."""
        nodes = self.tree.get("nodes", [])
        count = len(nodes) if isinstance(nodes, list) else 0
        if self.tree.get("scenes"):
            roots = self.entry("scenes", self.tree.get("scene", 0)).get("nodes", [])
        else:
            children = {child for n in range(count) for child in _list(self.entry("nodes", n), "children")}
            roots = [n for n in range(count) if n not in children]
        found: list[tuple[int, Floats]] = []
        seen: set[int] = set()
        stack = [(index, np.eye(4)) for index in reversed(roots if isinstance(roots, list) else [])]
        while stack:
            index, above = stack.pop()
            node = self.entry("nodes", index)
            if index in seen:
                msg = f"has node {index} below two others, or below itself"
                raise MeshFileError(msg)
            seen.add(index)
            if node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible") is False:
                # Nodes below it are hidden, too.
                continue
            matrix = above @ _local(node, index)
            found.append((index, matrix))
            stack += [(child, matrix) for child in reversed(_list(node, "children"))]
        return found


def _list(entry: Plain, key: str) -> list[Any]:
    values = entry.get(key, [])
    return values if isinstance(values, list) else []


def _whole(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) else -1


def _vector(node: Plain, key: str, default: tuple[float, ...], index: int) -> Floats:
    try:
        values = np.array(node.get(key, default), dtype=np.float64)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.shape != (len(default),) or not np.isfinite(values).all():
        msg = f"has node {index} whose {key} is not {len(default)} numbers"
        raise MeshFileError(msg)
    return values


def _local(node: Plain, index: int) -> Floats:
    """Return the transform of a node to its parent, shape (4, 4)."""
    if "matrix" in node:
        return _vector(node, "matrix", tuple(np.eye(4).ravel()), index).reshape(4, 4).T
    rotation = _vector(node, "rotation", (0.0, 0.0, 0.0, 1.0), index)
    length = float(np.linalg.norm(rotation))
    if abs(length - 1.0) > 1e-3:
        msg = f"has node {index} whose rotation is no unit quaternion"
        raise MeshFileError(msg)
    x, y, z, w = rotation / length
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * _vector(node, "scale", (1.0, 1.0, 1.0), index)
    matrix[:3, 3] = _vector(node, "translation", (0.0, 0.0, 0.0), index)
    return matrix
