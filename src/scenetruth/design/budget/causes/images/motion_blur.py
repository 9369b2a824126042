"""Motion during the exposure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.scene import Scene


class MotionBlur(Cause):
    """The object, or the camera, moves while an image is taken.

    All images are blurred in the same way as long as the motion is steady: that takes contrast, and shifts nothing.
    """

    kind = "motion_blur"
    title = "motion during the exposure"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"shutter.exposure_time_s": 0.0, "shutter.stage_speed_mm_per_s": 0.0}
    takes_contrast = True
    coarse = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether anything may move while the shutter is open."""
        return scene.shutter.exposure_time_s > 0

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the exposure time."""
        return f"{scene.shutter.exposure_time_s:g} s"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return half the exposure."""
        half = scene.shutter.exposure_time_s / 2
        return Remedy(f"half the exposure (shutter.exposure_time_s: {half:g})", {self.kind: 0.25})
