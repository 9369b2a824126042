"""What they share: positions of vertices at some times; splines in time between them, fits along the surface."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from scenetruth.camera import Frames
from scenetruth.errors import Problem, SceneError
from scenetruth.indexing import centred_indices
from scenetruth.model import Finite
from scenetruth.scene.deformation import OwnFrameModel
from scenetruth.scene.jets import Field, Jet, compose, values_of
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.file import FileMesh
from scenetruth.scene.motion import Points
from scenetruth.scene.motion.time_curve import increasing
from scenetruth.scene.surface.osculation import Osculation, osculate
from scenetruth.scene.surface.start import osculating_jet

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["NodalModel", "NodalStart", "States", "TimedModel"]

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


class NodalModel(OwnFrameModel):
    """What says where the vertices of a mesh file are, before anything else moves them."""

    @final
    def start(self, mesh: TriangleMesh, folder: Path, frames: Frames) -> NodalStart:
        """Read where the vertices of a mesh are.

        Parameters
        ----------
        mesh
            The mesh at rest, made from a file.
        folder
            Where relative paths count from.
        frames
            The frames of the recording.

        Raises
        ------
        SceneError
            If a file is missing or unreadable, its arrays or meshes do not fit the mesh, hold numbers that are not
            finite or let a triangle vanish, or the times do not cover the frames; paths count from the deformation.
        """
        source = mesh.source
        assert isinstance(source, FileMesh)
        # Arrays and files hold the nodes that no face uses too.
        states = self.states(mesh.with_all_nodes, folder / source.file, source.unit_mm, folder, frames)
        if mesh.vertex_nodes is not None:
            states = states._replace(positions_mm=states.positions_mm[:, mesh.vertex_nodes])
        _check(states, mesh.faces, frames)
        return NodalStart(states.times_frames, states.positions_mm, mesh.faces, mesh.vertices_mm, mesh.crease_deg)

    @abstractmethod
    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Return positions as they were read.

        Parameters
        ----------
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
        """


class TimedModel(NodalModel):
    """What has one state for each of some times."""

    times_frames: tuple[Finite, ...] | None = None
    """Time of each state in frames, increasing; null: one state per frame, the middle one at t = 0 as of `frames`."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return value if value is None else increasing(value)

    def times(self, count: int) -> Floats:
        """Return the times of so many states.

        Raises
        ------
        SceneError
            If there are more or fewer times.
        """
        given = self.times_frames
        if given is None:
            return centred_indices(count).astype(np.float64)
        if len(given) != count:
            raise SceneError([Problem("times_frames", f"needs one time for each of the {count} states", len(given))])
        return np.asarray(given)


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
        Faces that meet there at a larger angle belong to different pieces of the surface; see `TriangleMesh`.
    """

    times_frames: Floats
    states_mm: Floats
    faces: NDArray[np.int32]
    rest_mm: Floats
    crease_deg: float | Floats

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
