"""Vertex animation from files: arrays of finite-element solvers, mesh sequences, and morph targets."""

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
    """Vertex positions of a mesh at several times."""

    times_frames: Floats
    """Increasing times, shape (k,)."""
    positions_mm: Floats
    """Positions at each, in the own frame, shape (k, n, 3)."""
    field: str
    """Field of the model that defines the states, for messages."""
    source: Path
    """Source file."""


class VertexModel(OwnFrameModel):
    """Base class of vertex animations of mesh files, applied before all other deformations."""

    @final
    def start(self, mesh: TriangleMesh, folder: Path, frames: Frames) -> AnimatedConfiguration:
        """Read the vertex positions of a mesh."""
        source = mesh.source
        assert isinstance(source, FileMesh)
        # Arrays and files include nodes not used by any face.
        states = self.states(mesh.with_all_nodes, folder / source.file, source.unit_mm, folder, frames)
        if mesh.vertex_nodes is not None:
            states = states._replace(positions_mm=states.positions_mm[:, mesh.vertex_nodes])
        _check(states, mesh.faces, frames)
        return AnimatedConfiguration(
            states.times_frames, states.positions_mm, mesh.faces, mesh.vertices_mm, mesh.crease_deg
        )

    @abstractmethod
    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Return the positions as read from the files; the unit of the mesh file is ``unit_mm``."""


class TimedModel(VertexModel):
    """Base class of vertex animations with one state per time."""

    times_frames: tuple[Finite, ...] | None = None
    """Time of each state in frames, increasing; null: one state per frame, the middle one at t = 0 as in `frames`."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return value if value is None else check_increasing(value)

    def times(self, count: int) -> Floats:
        """Return the times of a number of states."""
        given = self.times_frames
        if given is None:
            return centred_indices(count).astype(np.float64)
        if len(given) != count:
            raise SceneError([Problem("times_frames", f"requires one time for each of the {count} states", len(given))])
        return np.asarray(given)


@dataclass(frozen=True, eq=False)
class AnimatedConfiguration:
    """Mesh whose vertices follow cubic splines through given positions, twice continuously differentiable.

    The first and last polynomial pieces are extrapolated.

    ``times_frames``: Increasing times, shape (k,), k >= 2. Two give linear, three quadratic interpolation, more a
      not-a-knot spline.
    ``states_mm``: Positions at each time, in the object frame, shape (k, n, 3).
    ``rest_mm``: Positions for the fit of the surface derivatives, shape (n, 3).
    ``crease_deg``: Angle between faces at rest above which their edge is sharp, see `TriangleMesh`.
    """

    times_frames: Floats
    states_mm: Floats
    faces: NDArray[np.int32]
    rest_mm: Floats
    crease_deg: float | Floats

    @cached_property
    def osculation(self) -> QuadricFit:
        """Derivative operators along the surface."""
        return fit_quadrics(self.rest_mm, self.faces, self.crease_deg)

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices on sharp edges have several surface points."""
        return self.osculation.corners

    def at(self, t: JetField) -> Points:
        """Return the vertices with time derivatives."""
        orders = self._orders(strip_derivatives(t))
        if isinstance(t, Jet):
            count = self.states_mm.shape[1]
            t = Jet(np.ascontiguousarray(np.broadcast_to(t.coefficients, (len(t.coefficients), count))))
        x, y, z = (compose(t, *orders[:, :, axis]) for axis in range(3))
        return x, y, z

    def surface(self, t: Jet) -> Points:
        """Return the mesh with surface derivatives from fits to the position and velocity fields."""
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
        raise SceneError([Problem(path, "requires states at two or more times", len(states))])
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise SceneError([Problem(path, "has times that are not finite or not increasing", str(source))])
    wrong = np.argwhere(~np.isfinite(states).all(axis=2))
    if len(wrong):
        message = f"has {len(wrong)} positions that are not finite, the first at state {wrong[0][0]}, "
        raise SceneError([Problem(path, f"{message}vertex {wrong[0][1]}", str(source))])
    for index, state in enumerate(states):
        corners = state[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if area.min() <= 1e-14 * area.max():
            raise SceneError([Problem(path, f"face {area.argmin()} has zero area at state {index}", str(source))])
    first, last = float(frames.t[0]), float(frames.t[-1])
    if times[0] > first + 1e-9 or times[-1] < last - 1e-9:
        message = f"must cover the frames of the recording, t = {first:g} to {last:g}"
        field = "times_frames" if path != "kind" else "start_frame"
        raise SceneError([Problem(field, message, f"t = {times[0]:g} to {times[-1]:g}")])


_MOST_NUMBERS = 20_000_000
"""Maximum size of an array: as splines in time, each number takes forty bytes."""


class VertexAnimation(TimedModel):
    """Array of nodal displacements or positions, as written by finite-element solvers."""

    kind: Literal["nodal"]
    """``nodal``."""
    file: InputFile
    """NumPy file (.npy, .npz) or Zarr store with shape (frames, nodes, 3), nodes as in the mesh file; relative paths
    refer to the directory of the scene file.
    """
    key: str | None = None
    """Name of the array in an .npz file or Zarr group; null for a single array."""
    quantity: Literal["displacements", "positions"] = "displacements"
    """Quantity in the array: displacements from the positions of the mesh file, or positions; in the object frame."""
    unit_mm: Positive = 1.0
    """Length of one unit of the array in mm."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the array, see `VertexModel`."""
        source = folder / self.file
        states = _read_array(source, self.key)
        _refuse_cut(mesh, mesh_file)
        nodes = len(mesh.vertices_mm)
        if states.ndim != 3 or states.shape[1:] != (nodes, 3) or states.dtype.kind not in "fiu":
            message = f"must hold numbers of shape (frames, {nodes}, 3), for the {nodes} nodes of {mesh_file.name}"
            raise SceneError([Problem("file", message, f"{states.dtype} of shape {states.shape}")])
        states = np.asarray(states, dtype=np.float64) * self.unit_mm
        if self.quantity == "displacements":
            states = states + mesh.vertices_mm
        return States(self.times(len(states)), states, "file", source)


def _refuse_cut(mesh: TriangleMesh, mesh_file: Path) -> None:
    """Raise a SceneError for a mesh whose vertices are no longer those of its file."""
    if mesh.cut:
        message = "has pictures that cut parts of it out, which cannot be animated by its vertices; use kind: meshes"
        raise SceneError([Problem("kind", message, str(mesh_file))])


def _read_array(file: Path, key: str | None) -> NDArray[Any]:
    folder = os.path.isdir(file)
    if not folder:
        check_file_size(file, MAX_FILE_BYTES, "no such file")
    try:
        if folder:
            import zarr

            store: Any = zarr.open(str(file), mode="r")
            names = [] if isinstance(store, zarr.Array) else sorted(store.array_keys())
            return _load_values(store if isinstance(store, zarr.Array) else store[_chosen(names, key)], file)
        with file.open("rb") as stream:
            if stream.read(2) != b"PK":
                # A .npy array is memory-mapped, so its shape is checked before it is read.
                return _load_values(np.load(file, allow_pickle=False, mmap_mode="r"), file)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                name = _chosen(sorted(archive.files), key)
                _refuse_many(_numbers_in(archive, name), file)
                return _load_values(archive[name], file)
    except SceneError:
        raise
    except Exception as error:  # numpy and zarr raise various exceptions
        message = f"cannot be read as an array: {' '.join(str(error).split())[:200] or type(error).__name__}"
        raise SceneError([Problem("file", message, str(file))]) from error


def _chosen(names: list[str], key: str | None) -> str:
    chosen = key if key is not None or len(names) != 1 else names[0]
    if chosen is None or chosen not in names:
        message = f"must be the name of an array in the file: {', '.join(names) or '(none)'}"
        raise SceneError([Problem("key", message, key)])
    return chosen


def _load_values(loaded: Any, file: Path) -> NDArray[Any]:
    _refuse_many(math.prod(int(size) for size in loaded.shape), file)
    return np.array(loaded[...])


def _numbers_in(archive: Any, name: str) -> int:
    """Return the approximate number of values of an archived array from its uncompressed size."""
    entry = archive.zip.getinfo(name if name in archive.zip.namelist() else f"{name}.npy")
    return int(entry.file_size) // 8


def _refuse_many(count: int, file: Path) -> None:
    if count > _MOST_NUMBERS:
        raise SceneError([Problem("file", f"has {count:,} values; the maximum is {_MOST_NUMBERS:,}", str(file))])


class Morph(VertexModel):
    """Morph targets of a glTF mesh (.glb, .gltf), driven by its first weight animation."""

    kind: Literal["morph"]
    """``morph``."""
    start_frame: Finite | None = None
    """Time in frames at 0 s of the file; null: the first frame of the recording."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the morph targets of the mesh file, see `VertexModel`."""
        _refuse_cut(mesh, mesh_file)
        seconds, states = read_morph_states(mesh_file, mesh.vertices_mm / unit_mm)
        first = float(frames.t[0]) if self.start_frame is None else self.start_frame
        return States(first + seconds / frames.frame_interval_s, states * unit_mm, "kind", mesh_file)


class MeshSeries(TimedModel):
    """Sequence of mesh files with identical faces, one per state, with the texture of the first mesh."""

    kind: Literal["meshes"]
    """``meshes``."""
    files: Annotated[tuple[InputFile, ...], Field(min_length=2)]
    """Paths of the files (OBJ, PLY, GLB), first state first; relative paths refer to the directory of the scene file.
    """
    unit_mm: Positive = 1.0
    """Length of one unit of the files in mm."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the files, see `VertexModel`."""
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
