"""Directions around an axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from scenetruth.dataset.distributions.base import Random
from scenetruth.model import Direction

__all__ = ["Cone"]


class Cone(Random):
    """A unit vector within an angle of an axis, equally likely everywhere on the cap of the sphere (Archimedes).

    Examples
    --------
    >>> Cone(axis=[0, 0, 2], half_angle_deg=90).value([0.5, 0.0])
    [0.8660254037844386, 0.0, 0.5]
    """

    uniforms: ClassVar[int] = 2

    kind: Literal["cone"] = "cone"
    axis: Direction
    """Direction in the middle, of any length."""
    half_angle_deg: Annotated[float, Field(gt=0, le=180)]
    """Largest angle between the axis and a direction; 180 for all directions."""

    def value(self, uniforms: Sequence[float]) -> list[float]:
        """Return the direction: the first number says how far from the axis, the second where around it."""
        cosine = 1 - uniforms[0] * (1 - np.cos(np.deg2rad(self.half_angle_deg)))
        return self._direction(float(cosine), 2 * np.pi * uniforms[1])

    def _direction(self, cosine: float, around: float) -> list[float]:
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        # Two directions square to the axis, from the unit vector that is least like it.
        first = np.cross(axis, np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis))
        first /= np.linalg.norm(first)
        second = np.cross(axis, first)
        sine = np.sqrt(max(1 - cosine**2, 0.0))
        found = cosine * axis + sine * (np.cos(around) * first + np.sin(around) * second)
        return [float(part) for part in found]

    def trials(self) -> list[tuple[str, Any]]:
        """Return the axis and some directions on the rim."""
        cosine = float(np.cos(np.deg2rad(self.half_angle_deg)))
        rim = [self._direction(cosine, np.pi / 2 * quarter) for quarter in range(4)]
        return [("axis", list(self.axis)), *(("half_angle_deg", one) for one in rim)]
