"""How large a window is on the surface."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

_HALF_WIDTH = 2.3548
"""Width at half maximum of a Gaussian, in standard deviations."""

__all__ = ["Window"]


class Window(Limit):
    """Width at half maximum of the estimator's window on the surface, 2.355 σ Z / f; smaller details are lost."""

    unit: ClassVar[str] = "mm"

    kind: Literal["window"] = "window"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "window on the surface"

    def value(self, facts: Facts) -> float:
        """Return the width."""
        return _HALF_WIDTH * facts.causes.window_sigma_px * facts.depth_mm / facts.scene.camera.focal_px
