"""Darkening towards the corners."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Change, Disturbance, Sight
from scenetruth.scene import Scene


class VignettingOfLens(Cause):
    """A point is darker where it is nearer to a corner: its grey value changes from image to image."""

    kind = "vignetting"
    title = "darkening towards the corners"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"optics.vignetting": None}
    takes_contrast = True
    coarse = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return what is left in a corner."""
        vignetting = scene.optics.vignetting
        return "" if vignetting is None else f"{100 * float(vignetting.factor(scene.camera)[0, 0]):.0f} % in a corner"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the change of brightness from image to image."""
        vignetting = sight.scene.optics.vignetting
        if vignetting is None:
            return
        factor = vignetting.factor(sight.scene.camera)
        gradient = np.gradient(factor)

        def change(s: int, t: int) -> Change:
            place = sight.place(s, t)
            apart = gradient[1] * (place.x - sight.points.x) + gradient[0] * (place.y - sight.points.y)
            # The texture is darkened already as the reference shows it.
            return Change(grey=sight.texture * apart / np.maximum(factor, 1e-6))

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return a division by a bright image."""
        return Remedy("images divided by that of an even light field", {self.kind: 0.1})
