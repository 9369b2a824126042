"""Small mesh files, and figures of what was read from them."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.scene.mesh import TriangleMesh, load_mesh_file

__all__ = ["area_of", "data_uri", "gltf", "read", "refusal", "volume_of"]

Plain = dict[str, Any]


def read(file: Path, content: str | bytes, **changes: Any) -> TriangleMesh:
    """Write a file, and load it."""
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return load_mesh_file(file, **changes)


def refusal(file: Path, content: str | bytes) -> str:
    """Return the message with which a file is refused."""
    import pytest

    from scenetruth.errors import SceneError

    with pytest.raises(SceneError) as caught:
        read(file, content)
    return str(caught.value)


def area_of(mesh: TriangleMesh) -> float:
    """Return the area of all triangles, by Heron's formula from their sides."""
    corners = mesh.vertices_mm[mesh.faces]
    a, b, c = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).T
    s = (a + b + c) / 2
    return float(np.sqrt(np.maximum(s * (s - a) * (s - b) * (s - c), 0)).sum())


def volume_of(mesh: TriangleMesh) -> float:
    """Return the volume of a closed mesh, positive if its normals point outwards."""
    return float(np.linalg.det(mesh.vertices_mm[mesh.faces]).sum() / 6)


def data_uri(content: bytes, kind: str = "application/octet-stream") -> str:
    """Return a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def gltf(arrays: Mapping[str, Any], primitive: Plain, normalized: tuple[str, ...] = (), **more: Any) -> str:
    """Return a glTF document with an accessor for each array, by the names of which the primitive refers to them.

    ``more``: Further top-level keys; nodes and meshes too.
    """
    names = list(arrays)
    buffer, views, accessors = b"", [], []
    for name, values in arrays.items():
        rows = values.reshape(len(values), -1)
        raw = np.ascontiguousarray(rows).tobytes()
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(raw)})
        kind = _COMPONENTS[rows.dtype.str[1:]]
        accessor = {"bufferView": len(views) - 1, "componentType": kind, "count": len(rows)}
        accessors.append(accessor | {"type": _KINDS[rows.shape[1]], "normalized": name in normalized})
        buffer += raw + b"\0" * (-len(raw) % 4)

    def numbered(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: numbered(each) for key, each in value.items()}
        if isinstance(value, list):
            return [numbered(each) for each in value]
        return names.index(value[1:]) if isinstance(value, str) and value.startswith("@") else value

    document: Plain = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": len(buffer), "uri": data_uri(buffer)}],
        "bufferViews": views,
        "accessors": accessors,
        **more,
    }
    return json.dumps(numbered(document))
