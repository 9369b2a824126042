"""How far points move in the image from the first position to the last."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["TotalDisparity"]


class TotalDisparity(Limit):
    """Disparity between the outermost positions, as a share of the image's width; beyond 1, none sees the other's."""

    unit: ClassVar[str] = "1"

    kind: Literal["total_disparity"] = "total_disparity"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "disparity between the outermost positions over the image's width"

    def value(self, facts: Facts) -> float:
        """Return the share."""
        camera = facts.scene.camera
        return camera.focal_px * facts.travel_mm / facts.depth_mm / camera.width
