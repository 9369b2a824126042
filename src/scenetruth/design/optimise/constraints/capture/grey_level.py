"""How bright images are."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["GreyLevel"]


class GreyLevel(Limit):
    """Mean grey value and three standard deviations of the texture, as a share of full scale: over 1 is saturated."""

    unit: ClassVar[str] = "1"

    kind: Literal["grey_level"] = "grey_level"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "brightest grey values, share of full scale"

    def value(self, facts: Facts) -> float:
        """Return the share."""
        return facts.causes.grey_level + 3 * facts.causes.contrast
