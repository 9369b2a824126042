"""Morph targets of a glTF mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from scenetruth.camera import Frames
from scenetruth.model import Finite
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.nodal.base import NodalModel, States
from scenetruth.scene.nodal.gltf import morph_states

__all__ = ["Morph"]


class Morph(NodalModel):
    """The morph targets of a glTF mesh (.glb, .gltf), moved by its first animation of their weights."""

    kind: Literal["morph"]
    """``morph``."""
    start_frame: Finite | None = None
    """Time in frames at the file's 0 s; null: the first frame of the recording."""

    def states(self, mesh: TriangleMesh, mesh_file: Path, unit_mm: float, folder: Path, frames: Frames) -> States:
        """Read the mesh file's morph targets; see `NodalModel`."""
        seconds, states = morph_states(mesh_file, mesh.vertices_mm / unit_mm)
        first = float(frames.t[0]) if self.start_frame is None else self.start_frame
        return States(first + seconds / frames.frame_interval_s, states * unit_mm, "kind", mesh_file)
