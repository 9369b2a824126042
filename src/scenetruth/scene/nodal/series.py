"""Series of mesh files with the same faces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera import Frames
from scenetruth.errors import Problem, SceneError
from scenetruth.files import InputFile
from scenetruth.model import Positive
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.file import load
from scenetruth.scene.nodal.base import States, TimedModel

__all__ = ["MeshSeries"]

Floats = NDArray[np.float64]


class MeshSeries(TimedModel):
    """A series of mesh files with the same faces, one for each state; the texture stays where the first mesh has it."""

    kind: Literal["meshes"]
    """``meshes``."""
    files: Annotated[tuple[InputFile, ...], Field(min_length=2)]
    """Paths of the files (OBJ, PLY, GLB), first state first; relative paths count from the scene file."""
    unit_mm: Positive = 1.0
    """Length of one unit of the files in mm."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the files; see `NodalModel`."""
        states = _series(self, mesh, folder)
        return States(self.times(len(states)), states, "files", Path(self.files[0]))


def _series(entry: MeshSeries, mesh: TriangleMesh, folder: Path) -> Floats:
    states = []
    for index, name in enumerate(entry.files):
        try:
            state = load(folder / name, entry.unit_mm).with_all_nodes
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
