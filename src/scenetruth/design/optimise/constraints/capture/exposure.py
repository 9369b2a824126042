"""How long an image is exposed."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["Exposure"]


class Exposure(Limit):
    """Exposure time of the shutter; of the sensor if the shutter has none."""

    unit: ClassVar[str] = "s"

    kind: Literal["exposure"] = "exposure"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "exposure time"

    def value(self, facts: Facts) -> float:
        """Return the time."""
        return facts.scene.shutter.exposure_time_s or float(getattr(facts.scene.sensor, "exposure_time_s", 0.0))
