"""The models of motions that are given vertex by vertex: arrays of solvers, series of mesh files, morph targets."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenetruth.model import Finite, FrozenModel, Positive
from scenetruth.scene.motion.time_curve import increasing

__all__ = ["MeshSeries", "Morph", "Nodal", "NodalModel"]


class NodalModel(FrozenModel):
    """What they share: they say where the vertices of a mesh file are, before anything else moves them."""


class _Timed(NodalModel):
    times_frames: tuple[Finite, ...] | None = None
    """Time of each state in frames, increasing; null: one state per frame, the middle one at t = 0 as of `frames`."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return value if value is None else increasing(value)


class Nodal(_Timed):
    """An array of nodal displacements or positions, as a finite-element solver writes it."""

    kind: Literal["nodal"]
    """``nodal``."""
    file: str
    """NumPy file (.npy, .npz) or zarr store with shape (frames, nodes, 3), nodes as in the mesh file; relative paths
    count from the scene file."""
    key: str | None = None
    """Name of the array in an .npz file or a zarr group; null if there is only one."""
    what: Literal["displacements", "positions"] = "displacements"
    """What it holds: displacements from the mesh file's positions, or positions; in the mesh's own frame."""
    unit_mm: Positive = 1.0
    """Length of one unit of the array in mm."""


class MeshSeries(_Timed):
    """A series of mesh files with the same faces, one for each state; the texture stays where the first mesh has it."""

    kind: Literal["meshes"]
    """``meshes``."""
    files: Annotated[tuple[str, ...], Field(min_length=2)]
    """Paths of the files (OBJ, PLY, GLB), first state first; relative paths count from the scene file."""
    unit_mm: Positive = 1.0
    """Length of one unit of the files in mm."""


class Morph(NodalModel):
    """The morph targets of a glTF mesh (.glb, .gltf), moved by its first animation of their weights."""

    kind: Literal["morph"]
    """``morph``."""
    start_frame: Finite | None = None
    """Time in frames at the file's 0 s; null: the first frame of the recording."""
