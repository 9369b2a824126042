"""Meshes whose vertices are given at some times: splines in time between them, fits along the surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from scenetruth.camera import Frames
from scenetruth.errors import Problem, SceneError
from scenetruth.indexing import centred_indices
from scenetruth.scene import mesh as meshes
from scenetruth.scene.jets import Field, Jet, compose, values_of
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.motion import Points
from scenetruth.scene.nodal_spec import MeshSeries, Morph, Nodal, NodalModel
from scenetruth.scene.osculation import Osculation, osculate
from scenetruth.scene.start import osculating_jet

__all__ = ["NodalStart", "nodal_start"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NodalStart:
    """A mesh whose vertices run along cubic splines through given positions, twice continuously differentiable.

    Before the first and after the last time the last piece goes on.

    Parameters
    ----------
    times_frames
        Increasing times, shape (k,), k >= 2. Two give straight lines, three parabolas, more the spline without knots
        at the second and the last but one time.
    states_mm
        Positions at each, in the own frame, shape (k, n, 3).
    faces
        Vertex indices, shape (m, 3).
    rest_mm
        Positions by whose neighbourhood derivatives along the surface are fitted, shape (n, 3).
    crease_deg
        Faces that meet there at a larger angle belong to different pieces of the surface.
    """

    times_frames: Floats
    states_mm: Floats
    faces: NDArray[np.int32]
    rest_mm: Floats
    crease_deg: float

    @cached_property
    def osculation(self) -> Osculation:
        """The derivatives along the surface."""
        return osculate(self.rest_mm, self.faces, self.crease_deg)

    @property
    def corners(self) -> NDArray[np.int32]:
        """Vertices on sharp edges are several surface points."""
        return self.osculation.corners

    def at(self, t: Field) -> Points:
        """Return the vertices with their derivatives in time."""
        orders = self._orders(values_of(t))
        if isinstance(t, Jet):
            count = self.states_mm.shape[1]
            t = Jet(np.ascontiguousarray(np.broadcast_to(t.coefficients, (len(t.coefficients), count))))
        x, y, z = (compose(t, *orders[:, :, axis]) for axis in range(3))
        return x, y, z

    def surface(self, t: Jet) -> Points:
        """Return the mesh with the derivatives of fits to the field of positions, and to the field of velocities."""
        orders = np.moveaxis(self._orders(t.value), 2, 0)
        x, y, z = (osculating_jet(self.osculation, item) for item in orders)
        return x, y, z

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.times_frames, self.states_mm, axis=0)

    def _orders(self, t: NDArray[np.floating[Any]]) -> Any:
        """Return positions, velocities and accelerations in the precision of t, shape (3, n, 3)."""
        knots = self._spline.x
        piece = int(np.clip(np.searchsorted(knots, t[0], side="right") - 1, 0, len(knots) - 2))
        c3, c2, c1, c0 = self._spline.c[:, piece]
        h = t[0] - knots[piece]
        return np.stack([((c3 * h + c2) * h + c1) * h + c0, (3 * c3 * h + 2 * c2) * h + c1, 6 * c3 * h + 2 * c2])


def nodal_start(
    entry: NodalModel, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames
) -> NodalStart:
    """Read where the vertices of a mesh are.

    Parameters
    ----------
    entry
        The deformation.
    mesh
        The mesh at rest.
    mesh_file
        The file that it comes from.
    unit_mm
        Length of that file's unit in mm.
    folder
        Where relative paths count from.
    frames
        The frames of the recording.

    Raises
    ------
    SceneError
        If a file is missing or unreadable, its arrays or meshes do not fit the mesh, hold numbers that are not finite
        or let a triangle vanish, or the times do not cover the frames; paths count from the deformation.
    """
    if isinstance(entry, Morph):
        from scenetruth.scene.morph import morph_states

        seconds, states = morph_states(mesh_file, mesh.vertices_mm / unit_mm)
        first = float(frames.t[0]) if entry.start_frame is None else entry.start_frame
        times, states, path, source = first + seconds / frames.frame_interval_s, states * unit_mm, "kind", mesh_file
    elif isinstance(entry, MeshSeries):
        states, path, source = _series(entry, mesh, folder), "files", Path(entry.files[0])
        times = _times(entry.times_frames, len(states))
    else:
        assert isinstance(entry, Nodal)
        path, source = "file", folder / entry.file
        states = _read_array(source, entry.key)
        order = _node_order(mesh_file, mesh.vertices_mm / unit_mm)
        nodes = len(mesh.vertices_mm) if order is None else order[1]
        if states.ndim != 3 or states.shape[1:] != (nodes, 3) or states.dtype.kind not in "fiu":
            message = f"must hold numbers of shape (frames, {nodes}, 3), for the {nodes} nodes of {mesh_file.name}"
            raise SceneError([Problem(path, message, f"{states.dtype} of shape {states.shape}")])
        states = np.asarray(states if order is None else states[:, order[0]], dtype=np.float64) * entry.unit_mm
        if entry.what == "displacements":
            states = states + mesh.vertices_mm
        times = _times(entry.times_frames, len(states))
    _check(times, states, mesh.faces, frames, path, source)
    return NodalStart(times, states, mesh.faces, mesh.vertices_mm, mesh.crease_deg)


def _times(given: tuple[float, ...] | None, count: int) -> Floats:
    if given is None:
        return centred_indices(count).astype(np.float64)
    if len(given) != count:
        raise SceneError([Problem("times_frames", f"needs one time for each of the {count} states", len(given))])
    return np.asarray(given)


def _check(times: Floats, states: Floats, faces: NDArray[np.int32], frames: Frames, path: str, source: Path) -> None:
    if len(states) < 2:
        raise SceneError([Problem(path, "needs states at two times at least, for a velocity", len(states))])
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


def _read_array(file: Path, key: str | None) -> NDArray[Any]:
    if not file.exists():
        raise SceneError([Problem("file", "no such file", str(file))])
    try:
        if file.is_dir() or file.suffix == ".zarr":
            import zarr

            loaded: Any = zarr.open(str(file), mode="r")
            names = None if isinstance(loaded, zarr.Array) else sorted(loaded.array_keys())
        else:
            loaded = np.load(file, allow_pickle=False)
            names = None if isinstance(loaded, np.ndarray) else sorted(loaded.files)
        if names is not None:
            chosen = key if key is not None or len(names) != 1 else names[0]
            if chosen not in names:
                message = f"must name one of its arrays: {', '.join(names) or '(it has none)'}"
                raise SceneError([Problem("key", message, key)])
            loaded = loaded[chosen]
        return np.asarray(loaded[...])
    except SceneError:
        raise
    except Exception as error:  # numpy's and zarr's readers raise whatever their formats raise
        raise SceneError([Problem("file", f"cannot be read as an array: {error}", str(file))]) from error


def _node_order(file: Path, vertices: Floats) -> tuple[NDArray[np.int64], int] | None:
    """Return which node of an OBJ file each vertex is, and how many nodes there are; None if they are in order.

    An OBJ file may have nodes that no face uses, and its nodes are split where a texture has seams.
    """
    if file.suffix.lower() != ".obj":
        return None
    lines = (line.split() for line in file.read_text(encoding="utf-8", errors="replace").splitlines())
    nodes = np.array([[float(word) for word in line[1:4]] for line in lines if line and line[0] == "v"])
    if nodes.shape == vertices.shape and np.allclose(nodes, vertices, rtol=1e-9, atol=0):
        return None
    near = 1e-9 * float(np.abs(nodes).max())
    distance, found = cKDTree(nodes).query(vertices, k=2)
    if distance[:, 0].max() > near or distance[:, 1].min() <= near:
        message = "has several nodes at one place and seams in its texture: which node is which is not clear"
        raise SceneError([Problem("file", message, str(file))])
    return found[:, 0], len(nodes)


def _series(entry: MeshSeries, mesh: TriangleMesh, folder: Path) -> Floats:
    states = []
    for index, name in enumerate(entry.files):
        try:
            state = meshes.load(folder / name, entry.unit_mm)
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
