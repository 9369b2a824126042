"""How far points move while an image is taken."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["MotionBlur"]


class MotionBlur(Limit):
    """Motion in the image during the exposure, of object and stage.

    Of the points of the first objective's region that move at all, 95 % move less.
    """

    unit: ClassVar[str] = "px"

    kind: Literal["motion_blur"] = "motion_blur"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "motion blur"

    def value(self, facts: Facts) -> float:
        """Return the length."""
        return facts.causes.blur_px
