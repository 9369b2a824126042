"""Lamps on surfaces that turn and move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.scene import Scene


class Shading(Cause):
    """A surface that turns, or moves past a lamp, is brighter in one frame than in another; off, nothing is lit.

    Without lamps, radiance is the texture's own. No model predicts it: it is always simulated.
    """

    kind = "shading"
    title = "light on surfaces that move"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"lighting.lights": [], "lighting.ambient": None}
    takes_contrast = True
    coarse = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether there are lamps: ambient light is the same everywhere."""
        return bool(scene.lighting.lights)

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the number of lamps."""
        count = len(scene.lighting.lights)
        return f"{count} lamp{'s' if count > 1 else ''}"

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Take the lamps away; ambient light alone stays as it is."""
        if plain["lighting"]["lights"]:
            super().switch_off(plain)

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return a method that lets the light of each image be unknown."""
        if scene.estimate.method == "refined":
            return Remedy("even light from all sides (lighting: {ambient: 1})", {self.kind: 0.1})
        words = "a method that allows for changing light (estimate: {method: refined})"
        return Remedy(words, {self.kind: 0.05, "brightness": 0.05, "slope": 0.01})
