"""Motion of vertices from files: arrays of finite-element solvers, sequences of meshes, and morph targets."""

from __future__ import annotations

import math
import os
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from scenetruth.camera import Frames
from scenetruth.errors import Problem, SceneError
from scenetruth.indexing import centred_indices
from scenetruth.input_files import InputFile
from scenetruth.scene.deformation import OwnFrameModel
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.file_preflight import MAX_FILE_BYTES, check_file_size
from scenetruth.scene.mesh.mesh_file import FileMesh, load_mesh_file
from scenetruth.scene.mesh.morph_targets import read_morph_states
from scenetruth.scene.motion import Points
from scenetruth.scene.motion.time_curve import check_increasing
from scenetruth.scene.reference_configuration import QuadricFit, fit_quadrics, make_surface_jet
from scenetruth.scene.taylor import Jet, JetField, compose, strip_derivatives
from scenetruth.validated_model import Finite, Positive

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["AnimatedConfiguration", "MeshSeries", "Morph", "States", "TimedModel", "VertexAnimation", "VertexModel"]


Floats = NDArray[np.float64]


class States(NamedTuple):
    """Where the vertices of a mesh are at some times."""

    times_frames: Floats
    """Increasing times, shape (k,)."""
    positions_mm: Floats
    """Positions at each, in the own frame, shape (k, n, 3)."""
    field: str
    """Field of the model that they come from, for what is wrong with them,"""
    source: Path
    """and the file."""


class VertexModel(OwnFrameModel):
    """What says where the vertices of a mesh file are, before anything else moves them."""

    @final
    def start(self, mesh: TriangleMesh, folder: Path, frames: Frames) -> AnimatedConfiguration:
        """Read where the vertices of a mesh are."""
        source = mesh.source
        assert isinstance(source, FileMesh)
        # Arrays and files hold the nodes that no face uses too.
        states = self.states(mesh.with_all_nodes, folder / source.file, source.unit_mm, folder, frames)
        if mesh.vertex_nodes is not None:
            states = states._replace(positions_mm=states.positions_mm[:, mesh.vertex_nodes])
        _check(states, mesh.faces, frames)
        return AnimatedConfiguration(
            states.times_frames, states.positions_mm, mesh.faces, mesh.vertices_mm, mesh.crease_deg
        )

    @abstractmethod
    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Return positions as they were read.

        ``unit_mm``: Length of that file's unit in mm.
        """


class TimedModel(VertexModel):
    """What has one state for each of some times."""

    times_frames: tuple[Finite, ...] | None = None
    """Time of each state in frames, increasing; null: one state per frame, the middle one at t = 0 as of `frames`."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return value if value is None else check_increasing(value)

    def times(self, count: int) -> Floats:
        """Return the times of so many states."""
        given = self.times_frames
        if given is None:
            return centred_indices(count).astype(np.float64)
        if len(given) != count:
            raise SceneError([Problem("times_frames", f"needs one time for each of the {count} states", len(given))])
        return np.asarray(given)


@dataclass(frozen=True, eq=False)
class AnimatedConfiguration:
    """A mesh whose vertices run along cubic splines through given positions, twice continuously differentiable.

    Before the first and after the last time the last piece goes on.

    ``times_frames``: Increasing times, shape (k,), k >= 2. Two give straight lines, three parabolas, more the spline
      without knots at the second and the last but one time.
    ``states_mm``: Positions at each, in the own frame, shape (k, n, 3).
    ``faces``: Vertex indices, shape (m, 3).
    ``rest_mm``: Positions by whose neighbourhood derivatives along the surface are fitted, shape (n, 3).
    ``crease_deg``: Faces that meet there at a larger angle belong to different pieces of the surface; see
      `TriangleMesh`.
    """

    times_frames: Floats
    states_mm: Floats
    faces: NDArray[np.int32]
    rest_mm: Floats
    crease_deg: float | Floats

    @cached_property
    def osculation(self) -> QuadricFit:
        """The derivatives along the surface."""
        return fit_quadrics(self.rest_mm, self.faces, self.crease_deg)

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices on sharp edges are several surface points."""
        return self.osculation.corners

    def at(self, t: JetField) -> Points:
        """Return the vertices with their derivatives in time."""
        orders = self._orders(strip_derivatives(t))
        if isinstance(t, Jet):
            count = self.states_mm.shape[1]
            t = Jet(np.ascontiguousarray(np.broadcast_to(t.coefficients, (len(t.coefficients), count))))
        x, y, z = (compose(t, *orders[:, :, axis]) for axis in range(3))
        return x, y, z

    def surface(self, t: Jet) -> Points:
        """Return the mesh with the derivatives of fits to the field of positions, and to the field of velocities."""
        orders = np.moveaxis(self._orders(t.value), 2, 0)
        x, y, z = (make_surface_jet(self.osculation, item) for item in orders)
        return x, y, z

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.times_frames, self.states_mm, axis=0)

    def _orders(self, t: NDArray[np.floating[Any]]) -> Any:
        """Return positions, velocities and accelerations in the precision of t, shape (3, n, 3)."""
        knots = self._spline.x
        piece = int(np.clip(np.searchsorted(knots, t[0], side="right") - 1, 0, len(knots) - 2))
        c3, c2, c1, c0 = self._spline.c[:, piece]
        h = t[0] - knots[piece]
        return np.stack([((c3 * h + c2) * h + c1) * h + c0, (3 * c3 * h + 2 * c2) * h + c1, 6 * c3 * h + 2 * c2])


def _check(given: States, faces: NDArray[np.int32], frames: Frames) -> None:
    times, states, path, source = given
    if len(states) < 2:
        raise SceneError([Problem(path, "needs states at two times at least, for a velocity", len(states))])
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise SceneError([Problem(path, "has times that are not finite, or not in order", str(source))])
    wrong = np.argwhere(~np.isfinite(states).all(axis=2))
    if len(wrong):
        message = f"has {len(wrong)} positions that are not finite, the first at state {wrong[0][0]}, "
        raise SceneError([Problem(path, f"{message}vertex {wrong[0][1]}", str(source))])
    for index, state in enumerate(states):
        corners = state[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if area.min() <= 1e-14 * area.max():
            raise SceneError([Problem(path, f"lets face {area.argmin()} vanish at state {index}", str(source))])
    first, last = float(frames.t[0]), float(frames.t[-1])
    if times[0] > first + 1e-9 or times[-1] < last - 1e-9:
        message = f"must cover the frames of the recording, t = {first:g} to {last:g}"
        field = "times_frames" if path != "kind" else "start_frame"
        raise SceneError([Problem(field, message, f"t = {times[0]:g} to {times[-1]:g}")])


_MOST_NUMBERS = 20_000_000
"""Of an array: as splines in time, each takes forty bytes."""


class VertexAnimation(TimedModel):
    """An array of nodal displacements or positions, as a finite-element solver writes it."""

    kind: Literal["nodal"]
    """``nodal``."""
    file: InputFile
    """NumPy file (.npy, .npz) or zarr store with shape (frames, nodes, 3), nodes as in the mesh file; relative paths
    count from the scene file."""
    key: str | None = None
    """Name of the array in an .npz file or a zarr group; null if there is only one."""
    quantity: Literal["displacements", "positions"] = "displacements"
    """Quantity in the array: displacements from the mesh file's positions, or positions; in the mesh's own frame."""
    unit_mm: Positive = 1.0
    """Length of one unit of the array in mm."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the array; see `VertexModel`."""
        source = folder / self.file
        states = _read_array(source, self.key)
        order = _node_order(mesh_file, mesh.vertices_mm / unit_mm)
        nodes = len(mesh.vertices_mm) if order is None else order[1]
        if states.ndim != 3 or states.shape[1:] != (nodes, 3) or states.dtype.kind not in "fiu":
            message = f"must hold numbers of shape (frames, {nodes}, 3), for the {nodes} nodes of {mesh_file.name}"
            raise SceneError([Problem("file", message, f"{states.dtype} of shape {states.shape}")])
        states = np.asarray(states if order is None else states[:, order[0]], dtype=np.float64) * self.unit_mm
        if self.quantity == "displacements":
            states = states + mesh.vertices_mm
        return States(self.times(len(states)), states, "file", source)


def _read_array(file: Path, key: str | None) -> NDArray[Any]:
    folder = os.path.isdir(file)
    if not folder:
        check_file_size(file, MAX_FILE_BYTES, "no such file")
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


class Morph(VertexModel):
    """The morph targets of a glTF mesh (.glb, .gltf), moved by its first animation of their weights."""

    kind: Literal["morph"]
    """``morph``."""
    start_frame: Finite | None = None
    """Time in frames at the file's 0 s; null: the first frame of the recording."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the mesh file's morph targets; see `VertexModel`."""
        seconds, states = read_morph_states(mesh_file, mesh.vertices_mm / unit_mm)
        first = float(frames.t[0]) if self.start_frame is None else self.start_frame
        return States(first + seconds / frames.frame_interval_s, states * unit_mm, "kind", mesh_file)


class MeshSeries(TimedModel):
    """A series of mesh files with the same faces, one for each state; the texture stays where the first mesh has it."""

    kind: Literal["meshes"]
    """``meshes``."""
    files: Annotated[tuple[InputFile, ...], Field(min_length=2)]
    """Paths of the files (OBJ, PLY, GLB), first state first; relative paths count from the scene file."""
    unit_mm: Positive = 1.0
    """Length of one unit of the files in mm."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the files; see `VertexModel`."""
        states = _series(self, mesh, folder)
        return States(self.times(len(states)), states, "files", Path(self.files[0]))


def _series(entry: MeshSeries, mesh: TriangleMesh, folder: Path) -> Floats:
    states = []
    for index, name in enumerate(entry.files):
        try:
            state = load_mesh_file(folder / name, entry.unit_mm).with_all_nodes
        except SceneError as error:
            problems = [Problem(f"files.{index}", problem.message, problem.value) for problem in error.problems]
            raise SceneError(problems) from error
        if len(state.vertices_mm) != len(mesh.vertices_mm) or not np.array_equal(state.faces, mesh.faces):
            found = f"{len(state.vertices_mm)} vertices, {len(state.faces)} faces"
            message = (
                f"must have the vertices and faces of the object's mesh ({len(mesh.vertices_mm)}, {len(mesh.faces)}), "
                "in the same order: topology cannot change"
            )
            raise SceneError([Problem(f"files.{index}", message, f"{folder / name}: {found}")])
        states.append(state.vertices_mm)
    return np.stack(states)
