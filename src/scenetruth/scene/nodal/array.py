"""Arrays of nodal displacements or positions, as finite-element solvers write them."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Frames
from scenetruth.errors import Problem, SceneError
from scenetruth.files import InputFile
from scenetruth.model import Positive
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.input import MOST_BYTES, len_of
from scenetruth.scene.nodal.base import States, TimedModel

__all__ = ["Nodal"]

Floats = NDArray[np.float64]

_MOST_NUMBERS = 20_000_000
"""Of an array: as splines in time, each takes forty bytes."""


class Nodal(TimedModel):
    """An array of nodal displacements or positions, as a finite-element solver writes it."""

    kind: Literal["nodal"]
    """``nodal``."""
    file: InputFile
    """NumPy file (.npy, .npz) or zarr store with shape (frames, nodes, 3), nodes as in the mesh file; relative paths
    count from the scene file."""
    key: str | None = None
    """Name of the array in an .npz file or a zarr group; null if there is only one."""
    what: Literal["displacements", "positions"] = "displacements"
    """What it holds: displacements from the mesh file's positions, or positions; in the mesh's own frame."""
    unit_mm: Positive = 1.0
    """Length of one unit of the array in mm."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the array; see `NodalModel`."""
        source = folder / self.file
        states = _read_array(source, self.key)
        order = _node_order(mesh_file, mesh.vertices_mm / unit_mm)
        nodes = len(mesh.vertices_mm) if order is None else order[1]
        if states.ndim != 3 or states.shape[1:] != (nodes, 3) or states.dtype.kind not in "fiu":
            message = f"must hold numbers of shape (frames, {nodes}, 3), for the {nodes} nodes of {mesh_file.name}"
            raise SceneError([Problem("file", message, f"{states.dtype} of shape {states.shape}")])
        states = np.asarray(states if order is None else states[:, order[0]], dtype=np.float64) * self.unit_mm
        if self.what == "displacements":
            states = states + mesh.vertices_mm
        return States(self.times(len(states)), states, "file", source)


def _read_array(file: Path, key: str | None) -> NDArray[Any]:
    folder = os.path.isdir(file)
    if not folder:
        len_of(file, MOST_BYTES, "no such file")
    try:
        if folder:
            import zarr

            store: Any = zarr.open(str(file), mode="r")
            names = [] if isinstance(store, zarr.Array) else sorted(store.array_keys())
            return _values_of(store if isinstance(store, zarr.Array) else store[_chosen(names, key)], file)
        with file.open("rb") as stream:
            if stream.read(2) != b"PK":
                # An array in a file of its own is not read before its shape is known.
                return _values_of(np.load(file, allow_pickle=False, mmap_mode="r"), file)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                name = _chosen(sorted(archive.files), key)
                _refuse_many(_numbers_in(archive, name), file)
                return _values_of(archive[name], file)
    except SceneError:
        raise
    except Exception as error:  # numpy's and zarr's readers raise whatever their formats raise
        message = f"cannot be read as an array: {' '.join(str(error).split())[:200] or type(error).__name__}"
        raise SceneError([Problem("file", message, str(file))]) from error


def _chosen(names: list[str], key: str | None) -> str:
    """Return which of several arrays is meant."""
    chosen = key if key is not None or len(names) != 1 else names[0]
    if chosen is None or chosen not in names:
        message = f"must name one of its arrays: {', '.join(names) or '(it has none)'}"
        raise SceneError([Problem("key", message, key)])
    return chosen


def _values_of(loaded: Any, file: Path) -> NDArray[Any]:
    _refuse_many(math.prod(int(size) for size in loaded.shape), file)
    return np.array(loaded[...])


def _numbers_in(archive: Any, name: str) -> int:
    """Return about how many numbers an array of an archive has, by its size when unpacked."""
    entry = archive.zip.getinfo(name if name in archive.zip.namelist() else f"{name}.npy")
    return int(entry.file_size) // 8


def _refuse_many(count: int, file: Path) -> None:
    if count > _MOST_NUMBERS:
        raise SceneError([Problem("file", f"has {count:,} numbers; at most {_MOST_NUMBERS:,} are read", str(file))])


def _node_order(file: Path, vertices: Floats) -> tuple[NDArray[np.int64], int] | None:
    """Return which node of an OBJ file each vertex is, and how many nodes there are; None if they are in order.

    An OBJ file may have nodes that no face uses, and its nodes are split where a texture has seams.
    """
    if file.suffix.lower() != ".obj":
        return None
    lines = (line.split() for line in file.read_text(encoding="utf-8", errors="replace").splitlines())
    try:
        nodes = np.array([[float(word) for word in line[1:4]] for line in lines if line and line[0] == "v"])
        if nodes.ndim != 2 or nodes.shape[1:] != (3,) or not np.isfinite(nodes).all():
            msg = "not three finite numbers each"
            raise ValueError(msg)
    except ValueError as error:
        message = f"{file.name} has nodes (v) that cannot be read: {error}"
        raise SceneError([Problem("file", message, str(file))]) from error
    if nodes.shape == vertices.shape and np.allclose(nodes, vertices, rtol=1e-9, atol=0):
        return None
    from scipy.spatial import cKDTree

    near = 1e-9 * float(np.abs(nodes).max())
    distance, found = cKDTree(nodes).query(vertices, k=2)
    if distance[:, 0].max() > near or distance[:, 1].min() <= near:
        message = "has several nodes at one place and seams in its texture: which node is which is not clear"
        raise SceneError([Problem("file", message, str(file))])
    return found[:, 0], len(nodes)
