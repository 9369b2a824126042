"""Stairs of depth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from scenetruth.model import Finite, Positive
from scenetruth.scene.mesh.base import MeshModel, TriangleMesh

__all__ = ["StairsMesh", "stairs"]


class StairsMesh(MeshModel):
    """Stairs of depth: treads side by side along X that face the camera (normal -Z), one behind the other.

    The origin is in the middle of their width and height, and halfway between the nearest and the farthest tread.
    """

    kind: Literal["stairs"]
    """``stairs``."""
    tread_mm: tuple[Positive, Positive]
    """Size of each tread along X and Y in mm."""
    steps_mm: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=10_000)]
    """How much farther than its left neighbour each tread stands, in mm; one number fewer than there are treads."""
    risers: bool = True
    """Whether upright faces join the treads; otherwise these hover side by side."""

    @field_validator("steps_mm")
    @classmethod
    def _real_steps(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        flat = [str(index) for index, step in enumerate(value) if step == 0]
        if flat:
            msg = f"steps must not be 0 (got one at index {', '.join(flat)}): join the treads instead"
            raise ValueError(msg)
        return value

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return stairs(self.tread_mm, self.steps_mm, self.risers)


def stairs(tread_mm: tuple[float, float], steps_mm: Sequence[float], risers: bool = True) -> TriangleMesh:
    """Return treads side by side along X that face -Z, each farther than its left neighbour by one of ``steps_mm``.

    The chart unrolls them, risers included, from left to right; an image covers all of it.
    """
    width, height = tread_mm
    depth = np.concatenate([[0.0], np.cumsum(steps_mm)])
    depth -= (depth.min() + depth.max()) / 2
    left = (np.arange(len(depth)) - len(depth) / 2) * width
    # The profile: both ends of every tread.
    ends = np.column_stack([left, depth, left + width, depth]).reshape(-1, 2)
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    if not risers:
        run = np.repeat(np.arange(len(depth)) * width, 2) + np.tile([0.0, width], len(depth))
    count = len(ends)
    pieces = np.arange(count - 1) if risers else np.arange(0, count - 1, 2)
    quads = np.column_stack([pieces, pieces + count, pieces + 1 + count, pieces + 1])
    faces = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3).astype(np.int32)
    x, z = np.tile(ends.T, 2)
    y = np.repeat([-height / 2, height / 2], count)
    chart = np.column_stack([np.tile(run, 2), y])
    uv = chart / (run[-1], height) + (0, 0.5)
    return TriangleMesh(np.column_stack([x, y, z]), faces, chart_mm=chart[faces], uv=uv[faces])
