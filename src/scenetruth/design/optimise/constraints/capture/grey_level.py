"""How bright images are."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["GreyLevel"]


class GreyLevel(Limit):
    """Brightest grey values of the texture, as a share of full scale: over 1 is saturated.

    The mean and three standard deviations, and no more than white has; medians over the first objective's region.
    """

    unit: ClassVar[str] = "1"

    kind: Literal["grey_level"] = "grey_level"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "brightest grey values, share of full scale"

    def value(self, facts: Facts) -> float:
        """Return the share."""
        return facts.causes.brightest_level
