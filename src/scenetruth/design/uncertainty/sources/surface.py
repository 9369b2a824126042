"""Sources of uncertainty in the surface and the method: errors that remain with ideal images."""

from __future__ import annotations

from collections.abc import Iterator

from scenetruth.design.uncertainty.observation_model import ObservationModel
from scenetruth.design.uncertainty.propagation import Errors, Propagation
from scenetruth.design.uncertainty.source import Calibration, Mitigation, UncertaintySource
from scenetruth.number_format import format_two_digits
from scenetruth.scene import Scene

__all__ = ["SurfaceSource"]


class SurfaceSource(UncertaintySource):
    """A part of the errors with ideal images; independent of seeds and of other sources."""

    group = "surface"
    of_surface = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return True: surfaces cannot be switched off."""
        return True

    def responses(
        self, sight: ObservationModel, propagation: Propagation, calibration: Calibration
    ) -> Iterator[Errors]:
        """Yield the errors if the propagation model includes them."""
        own = propagation.own()
        if self.kind in own:
            yield own[self.kind]


class CurvatureSource(SurfaceSource):
    """Variation of disparity and motion in a window beyond first order."""

    kind = "curvature"
    title = "curved surfaces"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a smaller window."""
        sigma = getattr(scene.estimate.settings, "window_sigma_px", None)
        if sigma is None:
            return None
        # The deviation is proportional to the area of the window.
        return Mitigation(
            f"a smaller window (estimate.window_sigma_px: {format_two_digits(0.7 * sigma)})", {self.kind: 0.5}
        )


class DepthDiscontinuitySource(SurfaceSource):
    """Errors near silhouettes and creases."""

    kind = "edges"
    title = "depth discontinuities"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a method with windows on one surface."""
        if scene.estimate.method == "refined":
            return None
        return Mitigation("a method with windows on one surface (method refined)", {self.kind: 0.1})


class MethodBiasSource(SurfaceSource):
    """Bias of the method: inexact filters, interpolation, texture finer than the pixels."""

    kind = "rest"
    title = "method bias"


class SlopeSource(SurfaceSource):
    """Variation of disparity and motion over a window, assumed constant by the method, weighted by local texture."""

    kind = "slope"
    title = "slanted surfaces"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a method that fits slopes."""
        if scene.estimate.method == "refined":
            return None
        return Mitigation("a method that fits slopes (method refined)", {self.kind: 0.01})
