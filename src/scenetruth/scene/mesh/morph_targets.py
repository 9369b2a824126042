"""Morph targets of glTF files and keyframes of their weights."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.scene.mesh.file_preflight import MAX_ELEMENTS, read_checked_bytes

__all__ = ["read_morph_states"]

Floats = NDArray[np.float64]

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_GLB_JSON, _GLB_BINARY = 0x4E4F534A, 0x004E4942


def read_morph_states(file: Path, vertices: Floats) -> tuple[Floats, Floats]:
    """Read the morph-target animation of a glTF file: keyframe times in s, shape (k,), and positions, shape (k, n, 3).

    Positions and ``vertices`` are in the unit of the file; tangents of CUBICSPLINE weights are ignored.
    """
    if file.suffix.lower() not in (".glb", ".gltf"):
        raise _problem("requires a mesh file with morph targets: .glb or .gltf", file)
    try:
        return _Gltf(file).states(vertices)
    except SceneError:
        raise
    except Exception as error:  # arbitrary JSON raises various exceptions
        text = " ".join(str(error).split())[:200]
        raise _problem(f"cannot be read as glTF with morph targets: {type(error).__name__} {text}", file) from error


def _problem(message: str, file: Path) -> SceneError:
    return SceneError([Problem("kind", message, str(file))])


class _Gltf:
    """glTF 2.0 file: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html."""

    def __init__(self, file: Path) -> None:
        self.file, self.binary = file, b""
        content = read_checked_bytes(file)
        if content[:4] == b"glTF":
            at = 12
            while at < len(content):
                length, kind = np.frombuffer(content, "<u4", 2, at)
                chunk = content[at + 8 : at + 8 + int(length)]
                if kind == _GLB_JSON:
                    content_json = chunk
                elif kind == _GLB_BINARY:
                    self.binary = chunk
                at += 8 + int(length)
            content = content_json
        self.tree: dict[str, Any] = json.loads(content)

    def buffer(self, index: int) -> bytes:
        """Return the bytes of a buffer: embedded, in a data URI, or in a separate file."""
        uri = self.tree["buffers"][index].get("uri")
        if uri is None:
            return self.binary
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return read_checked_bytes(self.file.parent / unquote(uri))

    def view(self, entry: dict[str, Any], dtype: np.dtype[Any], count: int, size: int) -> NDArray[Any]:
        """Return count x size numbers of a buffer view."""
        view = self.tree["bufferViews"][entry["bufferView"]]
        stride = view.get("byteStride", dtype.itemsize * size)
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        # Other strides would exceed the buffer or read it repeatedly.
        if not 1 <= count <= MAX_ELEMENTS or stride < dtype.itemsize * size or start < 0:
            msg = f"a view of {count} x {size} numbers from {start} with a stride of {stride} bytes"
            raise ValueError(msg)
        raw = np.frombuffer(self.buffer(view["buffer"]), np.uint8, (count - 1) * stride + dtype.itemsize * size, start)
        rows = np.lib.stride_tricks.as_strided(raw, (count, dtype.itemsize * size), (stride, 1))
        return np.ascontiguousarray(rows).view(dtype)

    def accessor(self, index: int) -> Floats:
        """Return the values of an accessor, shape (count, size)."""
        entry = self.tree["accessors"][index]
        dtype, size, count = np.dtype(_TYPES[entry["componentType"]]), _SIZES[entry["type"]], entry["count"]
        if not 1 <= count <= MAX_ELEMENTS:
            msg = f"an accessor of {count} elements"
            raise ValueError(msg)
        values = np.zeros((count, size), dtype) if "bufferView" not in entry else self.view(entry, dtype, count, size)
        if "sparse" in entry:
            sparse = entry["sparse"]
            kind = np.dtype(_TYPES[sparse["indices"]["componentType"]])
            at = self.view(sparse["indices"], kind, sparse["count"], 1)[:, 0]
            values[at] = self.view(sparse["values"], dtype, sparse["count"], size)
        numbers = values.astype(np.float64)
        return np.maximum(numbers / np.iinfo(dtype).max, -1) if entry.get("normalized") else numbers

    def states(self, vertices: Floats) -> tuple[Floats, Floats]:
        """Return times and positions of all keyframes."""
        nodes = self.tree["nodes"]
        carriers = [index for index, node in enumerate(nodes) if "mesh" in node]
        if len(carriers) != 1:
            raise _problem(f"requires a file with exactly one mesh; it has {len(carriers)}", self.file)
        primitives = self.tree["meshes"][nodes[carriers[0]]["mesh"]]["primitives"]
        base = np.concatenate([self.accessor(item["attributes"]["POSITION"]) for item in primitives])
        count = len(primitives[0].get("targets", ()))
        if count == 0 or any(len(item.get("targets", ())) != count for item in primitives):
            raise _problem("the mesh has no morph targets, or different numbers for its parts", self.file)
        if count * len(base) > MAX_ELEMENTS:
            raise _problem(f"has too many values: {len(base):,} vertices and {count:,} morph targets", self.file)
        moves = np.stack([np.concatenate([self.target(item, k) for item in primitives]) for k in range(count)])
        times, weights = self.weights(carriers[0], count)
        matrix = self.matrix(carriers[0])
        rest = base @ matrix[:3, :3].T + matrix[:3, 3]
        if rest.shape != vertices.shape or not np.allclose(rest, vertices, rtol=0, atol=1e-5 * np.ptp(vertices)):
            message = (
                f"its {len(rest)} vertices differ from the {len(vertices)} of the mesh, or are in a different order"
            )
            raise _problem(message, self.file)
        return times, vertices + np.tensordot(weights, moves @ matrix[:3, :3].T, axes=1)

    def target(self, primitive: dict[str, Any], index: int) -> Floats:
        """Return the displacements of one morph target on one part of the mesh."""
        count = self.tree["accessors"][primitive["attributes"]["POSITION"]]["count"]
        accessor = primitive["targets"][index].get("POSITION")
        moves = np.zeros((count, 3)) if accessor is None else self.accessor(accessor)
        if len(moves) != count:
            raise _problem(f"morph target {index} has {len(moves)} displacements for {count} vertices", self.file)
        return moves

    def weights(self, node: int, count: int) -> tuple[Floats, Floats]:
        """Return times in s and weights of the first weight animation, shapes (k,) and (k, count)."""
        for animation in self.tree.get("animations", ()):
            kinds = {channel["target"]["path"] for channel in animation["channels"]}
            if "weights" not in kinds:
                continue
            if kinds != {"weights"}:
                others = ", ".join(sorted(kinds - {"weights"}))
                raise _problem(f"also animates {others}; only weights of morph targets are supported", self.file)
            channel = next(item for item in animation["channels"] if item["target"].get("node") == node)
            sampler = animation["samplers"][channel["sampler"]]
            times, values = self.accessor(sampler["input"])[:, 0], self.accessor(sampler["output"])[:, 0]
            kind = sampler.get("interpolation", "LINEAR")
            if kind == "STEP":
                raise _problem("its weights are discontinuous (STEP): velocity is undefined", self.file)
            per_key = 3 * count if kind == "CUBICSPLINE" else count
            if len(values) != len(times) * per_key:
                raise _problem(f"has {len(values)} weights for {len(times)} keyframes of {count} targets", self.file)
            if (np.diff(times) <= 0).any():
                raise _problem("its keyframes are not increasing", self.file)
            rows = values.reshape(len(times), -1, count)
            return times, rows[:, rows.shape[1] // 2]
        raise _problem("no animation of morph-target weights", self.file)

    def matrix(self, node: int) -> Floats:
        """Return the transform from a node to the file frame, shape (4, 4)."""
        nodes = self.tree["nodes"]
        total = np.eye(4)
        here: int | None = node
        for _ in nodes:
            if here is None:
                break
            total = _local(nodes[here]) @ total
            here = next((index for index, item in enumerate(nodes) if here in item.get("children", ())), None)
        return total


def _local(node: dict[str, Any]) -> Floats:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * node.get("scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
