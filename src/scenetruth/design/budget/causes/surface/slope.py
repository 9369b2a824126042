"""Slanted surfaces."""

from __future__ import annotations

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.surface_cause import SurfaceCause
from scenetruth.scene import Scene


class Slope(SurfaceCause):
    """Disparity and motion differ over a window, and the method takes them to be the same.

    Of the window's pixels, those with the strongest texture count most: the estimate is theirs, not the middle's.
    """

    kind = "slope"
    title = "slanted surfaces"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return a method that knows slopes."""
        if scene.estimate.method == "refined":
            return None
        return Remedy("a method that fits slopes (estimate: {method: refined})", {self.kind: 0.01})
