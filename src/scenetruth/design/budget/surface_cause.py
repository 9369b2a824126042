"""What causes in the surface have in common: they are parts of what a method leaves with ideal images."""

from __future__ import annotations

from collections.abc import Iterator

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause
from scenetruth.design.budget.propagation.base import Errors, Propagation
from scenetruth.design.budget.sight import Sight
from scenetruth.scene import Scene

__all__ = ["SurfaceCause"]


class SurfaceCause(Cause):
    """A part of the errors with ideal images; the same in all draws, and there with every other cause."""

    group = "surface"
    of_surface = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return True: no field of a scene switches its surfaces."""
        return True

    def responses(self, sight: Sight, propagation: Propagation, calibration: Calibration) -> Iterator[Errors]:
        """Give the errors, if the model of the method knows them."""
        own = propagation.own()
        if self.kind in own:
            yield own[self.kind]
