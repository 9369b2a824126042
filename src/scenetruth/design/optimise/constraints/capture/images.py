"""How many images are taken."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["Images"]


class Images(Limit):
    """Images of all positions and frames."""

    unit: ClassVar[str] = "images"

    kind: Literal["images"] = "images"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "images"

    def value(self, facts: Facts) -> float:
        """Return the number."""
        return float(facts.images_per_frame * facts.scene.frames.count)
