"""How far the errors of the stage move images."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts
from scenetruth.design.optimise.rig.systematic import shifts_px

__all__ = ["StageError"]


class StageError(Limit):
    """Shift of an image along x by the errors of its position, one standard deviation: yaw f psi, position f dX / Z."""

    unit: ClassVar[str] = "px"

    kind: Literal["stage_error"] = "stage_error"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "shift of images by stage errors"

    def value(self, facts: Facts) -> float:
        """Return the shift."""
        return shifts_px(facts.scene, facts.depth_mm).along
