"""Blur out of focus."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np

from scenetruth.design.budget.blur import growing_blur
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Disturbance, Map, Sight
from scenetruth.scene import Scene


class DefocusBlur(Cause):
    """Discs of blur that change as the object comes nearer; a disc of diameter D has a variance of D²/16."""

    kind = "defocus"
    title = "blur out of focus"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"optics.defocus": None}
    takes_contrast = True
    coarse = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return aperture and distance of focus."""
        defocus = scene.optics.defocus
        return "" if defocus is None else f"{defocus.aperture_mm:g} mm, focus at {defocus.focus_distance_mm:g} mm"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the change of blur with the object's distance."""
        defocus = sight.scene.optics.defocus
        if defocus is None:
            return
        focal = sight.intrinsics.focal_length_px
        now = defocus.blur_diameter_px(np.nan_to_num(sight.depth, nan=defocus.focus_distance_mm), focal) ** 2 / 16

        def grown(closer: Map, depth: Map) -> Map:
            return defocus.blur_diameter_px(depth, focal) ** 2 / 16 - now * (1 + 2 * closer)

        yield growing_blur(sight, grown)

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return half the aperture."""
        defocus = scene.optics.defocus
        if defocus is None:
            return None
        return Remedy(f"half the aperture (optics.defocus.aperture_mm: {defocus.aperture_mm / 2:g})", {self.kind: 0.25})
