"""A ball as a mesh file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from scenetruth.scene.mesh import make_sphere

__all__ = ["DISTANCE", "RADIUS", "Floats", "ball", "write"]


Floats = NDArray[np.float64]


RADIUS, DISTANCE = 20.0, 660.0


def write(file: Path, vertices: Floats, faces: NDArray[Any], normals: Floats | None = None) -> Path:
    """Write a mesh; normals, shape (m, 3, 3), belong to corners."""
    if normals is None:
        trimesh.Trimesh(vertices, faces, process=False).export(file)
    elif file.suffix == ".obj":
        lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices]
        lines += ["vn {:.6g} {:.6g} {:.6g}".format(*normal) for normal in normals.reshape(-1, 3)]
        for index, face in enumerate(faces):
            lines.append("f " + " ".join(f"{vertex + 1}//{3 * index + c + 1}" for c, vertex in enumerate(face)))
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    else:
        corners = np.arange(faces.size).reshape(-1, 3)
        mesh = trimesh.Trimesh(vertices[faces].reshape(-1, 3), corners, vertex_normals=normals.reshape(-1, 3),
                               process=False)  # fmt: skip
        mesh.export(file, **({"include_normals": True} if file.suffix == ".glb" else {"vertex_normal": True}))
    return file


def ball(file: Path, resolution_mm: float = 4.0, *, normals: bool) -> Path:
    mesh = make_sphere(RADIUS, resolution_mm)
    return write(file, mesh.vertices_mm, mesh.faces, mesh.vertices_mm[mesh.faces] / RADIUS if normals else None)
