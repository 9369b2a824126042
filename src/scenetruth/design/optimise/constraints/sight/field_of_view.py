"""How much is seen at the working distance."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["FieldOfView"]


class FieldOfView(Limit):
    """Width, or height, of what images show at the median depth of the first objective's region: W Z / f."""

    unit: ClassVar[str] = "mm"

    kind: Literal["field_of_view"] = "field_of_view"

    axis: Literal["x", "y"] = "x"
    """Along the image's width, or its height."""
    seen_by: Literal["reference", "all"] = "reference"
    """Seen by the reference camera, or from all positions of the stage."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return f"field of view along {self.axis}" + (", seen from all positions" if self.seen_by == "all" else "")

    def value(self, facts: Facts) -> float:
        """Return the width or height, less the stage's travel if all positions must see it."""
        camera = facts.scene.camera
        pixels = camera.width if self.axis == "x" else camera.height
        whole = pixels * facts.depth_mm / camera.focal_px
        return whole - facts.travel_mm if self.seen_by == "all" and self.axis == "x" else whole
