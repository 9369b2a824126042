"""Random rotations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from scenetruth.dataset.distributions.base import Random

__all__ = ["RandomRotation"]


class RandomRotation(Random):
    """Any rotation, all equally likely, as a pose's list of ``rotations``.

    From three uniform numbers as K. Shoemake, Uniform random rotations, Graphics Gems III (1992), makes a quaternion.

    Examples
    --------
    >>> RandomRotation().value([0.5, 0.125, 0.25])
    [{'axis': [0.57735026919, 0.816496580928, 0.0], 'angle_deg': 120.0}]
    """

    uniforms: ClassVar[int] = 3

    kind: Literal["rotation"] = "rotation"

    def value(self, uniforms: Sequence[float]) -> list[dict[str, Any]]:
        """Return the rotation as one turn about one axis."""
        share, one, other = uniforms
        sine, cosine = np.sqrt([1 - share, share])
        x, y = sine * np.sin(2 * np.pi * other), sine * np.cos(2 * np.pi * other)
        z, w = cosine * np.sin(2 * np.pi * one), cosine * np.cos(2 * np.pi * one)
        vector = np.array([z, x, y])
        length = float(np.linalg.norm(vector))
        if length < _NONE:
            return [{"axis": [0.0, 0.0, 1.0], "angle_deg": 0.0}]
        angle = float(np.rad2deg(2 * np.arctan2(length, w)))
        return [{"axis": [round(float(part), 12) + 0.0 for part in vector / length], "angle_deg": round(angle, 12)}]

    def trials(self) -> list[tuple[str, Any]]:
        """Return one rotation: where one is allowed, all are."""
        return [("kind", self.value([0.3, 0.4, 0.5]))]


_NONE = 1e-12
