"""How much is out of focus."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts
from scenetruth.model import Positive

__all__ = ["DefocusBlur"]


class DefocusBlur(Limit):
    """Largest diameter of the blur disc over some depths: f A |1/Z - 1/Z_f|."""

    unit: ClassVar[str] = "px"

    kind: Literal["defocus_blur"] = "defocus_blur"

    depths_mm: tuple[Positive, Positive] | None = None
    """Nearest and farthest depth; the median depth of the first objective's region if not given."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "blur out of focus"

    def value(self, facts: Facts) -> float:
        """Return the largest diameter."""
        defocus = facts.scene.optics.defocus
        if defocus is None:
            return 0.0
        depths = np.array(self.depths_mm or (facts.depth_mm,), dtype=np.float64)
        return float(defocus.blur_diameter_px(depths, facts.scene.camera.focal_px).max())
