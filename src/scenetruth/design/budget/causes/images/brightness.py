"""Light that changes from frame to frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Change, Disturbance, Sight
from scenetruth.scene import Scene


class Brightness(Cause):
    """All that is seen is brighter in one frame than in another."""

    kind = "brightness"
    title = "light that changes"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"lighting.drift_per_frame": 0.0, "lighting.flicker": None}
    takes_contrast = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return drift and flicker."""
        light = scene.lighting
        told = [f"{100 * light.drift_per_frame:g} % per frame"] if light.drift_per_frame else []
        return ", ".join(told + ([f"± {100 * light.flicker.amplitude:g} %"] if light.flicker else []))

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the change of all grey values."""
        light = sight.scene.lighting

        def change(s: int, t: int) -> Change:
            return Change(grey=(light.brightness(t) / light.brightness(0) - 1) * sight.texture)

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return steady light."""
        drift = scene.lighting.drift_per_frame / 10
        words = f"light that is steady to a tenth of this (lighting.drift_per_frame: {drift:g})"
        return Remedy(f"{words}, or images that are divided by a grey reference in the picture", {self.kind: 0.1})
