"""Curved surfaces."""

from __future__ import annotations

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.surface_cause import SurfaceCause
from scenetruth.scene import Scene


class Curvature(SurfaceCause):
    """What disparity and motion do in a window beyond the first order."""

    kind = "curvature"
    title = "curved surfaces"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return a smaller window."""
        sigma = getattr(scene.estimate.settings, "window_sigma_px", None)
        if sigma is None:
            return None
        # The deviation grows with the window's area.
        return Remedy(f"a smaller window (estimate.window_sigma_px: {0.7 * sigma:.2g})", {self.kind: 0.5})
