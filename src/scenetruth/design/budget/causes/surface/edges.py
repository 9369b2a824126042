"""Windows that hold more than one surface."""

from __future__ import annotations

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.surface_cause import SurfaceCause
from scenetruth.scene import Scene


class Edges(SurfaceCause):
    """What pixels near silhouettes and sharp edges add to the mean square of all pixels."""

    kind = "edges"
    title = "edges"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return a method that keeps to one surface."""
        if scene.estimate.method == "refined":
            return None
        return Remedy("a method that keeps to one surface (estimate: {method: refined})", {self.kind: 0.1})
