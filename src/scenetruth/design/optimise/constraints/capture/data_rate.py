"""How much data there is per second."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["DataRate"]


class DataRate(Limit):
    """Bytes of all images of a frame over the time from frame to frame, 1e6 bytes a megabyte."""

    unit: ClassVar[str] = "MB/s"

    kind: Literal["data_rate"] = "data_rate"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "data rate"

    def value(self, facts: Facts) -> float:
        """Return the rate."""
        camera, bits = facts.scene.camera, getattr(facts.scene.sensor, "bit_depth", None) or 16
        size = camera.width * camera.height * math.ceil(bits / 8)
        return facts.images_per_frame * size / facts.scene.frames.frame_interval_s / 1e6
