"""Sources of uncertainty in the surface and the method: the errors that remain with ideal images."""

from __future__ import annotations

from collections.abc import Iterator

from scenetruth.design.uncertainty.observation_model import ObservationModel
from scenetruth.design.uncertainty.propagation import Errors, Propagation
from scenetruth.design.uncertainty.source import Calibration, Mitigation, UncertaintySource
from scenetruth.scene import Scene

__all__ = ["SurfaceSource"]


class SurfaceSource(UncertaintySource):
    """A part of the errors with ideal images; the same in all draws, and there with every other cause."""

    group = "surface"
    of_surface = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return True: no field of a scene switches its surfaces."""
        return True

    def responses(
        self, sight: ObservationModel, propagation: Propagation, calibration: Calibration
    ) -> Iterator[Errors]:
        """Give the errors, if the model of the method knows them."""
        own = propagation.own()
        if self.kind in own:
            yield own[self.kind]


class CurvatureSource(SurfaceSource):
    """What disparity and motion do in a window beyond the first order."""

    kind = "curvature"
    title = "curved surfaces"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a smaller window."""
        sigma = getattr(scene.estimate.settings, "window_sigma_px", None)
        if sigma is None:
            return None
        # The deviation grows with the window's area.
        return Mitigation(f"a smaller window (estimate.window_sigma_px: {0.7 * sigma:.2g})", {self.kind: 0.5})


class DepthDiscontinuitySource(SurfaceSource):
    """What pixels near silhouettes and sharp edges add to the mean square of all pixels."""

    kind = "edges"
    title = "edges"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a method that keeps to one surface."""
        if scene.estimate.method == "refined":
            return None
        return Mitigation("a method that keeps to one surface (estimate: {method: refined})", {self.kind: 0.1})


class MethodBiasSource(SurfaceSource):
    """The method's own bias: filters that are not exact, interpolation, texture finer than the pixels."""

    kind = "rest"
    title = "the method's own bias"


class SlopeSource(SurfaceSource):
    """Disparity and motion differ over a window, and the method takes them to be the same.

    Of the window's pixels, those with the strongest texture count most: the estimate is theirs, not the middle's.
    """

    kind = "slope"
    title = "slanted surfaces"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a method that knows slopes."""
        if scene.estimate.method == "refined":
            return None
        return Mitigation("a method that fits slopes (estimate: {method: refined})", {self.kind: 0.01})
