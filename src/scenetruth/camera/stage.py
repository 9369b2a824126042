"""The linear stage that carries the camera, and the frames it takes."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from scenetruth.indexing import centred_indices
from scenetruth.model import Finite, FrozenModel, Positive

__all__ = ["Frames", "Stage"]


class Stage(FrozenModel):
    """A linear stage along X with equidistant positions; position 0 is the reference."""

    positions: Annotated[int, Field(ge=1, le=1001)]
    """Number of camera positions; the reference is the middle one (the lower middle of an even number)."""
    baseline_mm: Finite
    """V_X, displacement in mm from one position to the next, positive to the right."""

    @field_validator("baseline_mm")
    @classmethod
    def _not_zero(cls, value: float) -> float:
        if value == 0:
            msg = "must not be zero: all camera positions would coincide"
            raise ValueError(msg)
        return value

    @property
    def s(self) -> NDArray[np.int64]:
        """Camera indices, 0 the reference."""
        return centred_indices(self.positions)

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """Camera positions X_s = V_X s in mm."""
        return np.asarray(self.baseline_mm * self.s, dtype=np.float64)


class Frames(FrozenModel):
    """When images are taken; frame 0 is the reference."""

    count: Annotated[int, Field(ge=1, le=100_000)]
    """Number of frames; the reference is the middle one (the lower middle of an even number)."""
    frame_interval_s: Positive = 1.0
    """Time between two frames in s."""

    @property
    def t(self) -> NDArray[np.int64]:
        """Frame indices, 0 the reference."""
        return centred_indices(self.count)
