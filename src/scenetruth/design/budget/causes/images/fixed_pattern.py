"""Differences between the sensor's pixels that stay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.sensor_cause import SensorCause
from scenetruth.scene import Scene


class FixedPattern(SensorCause):
    """Sensitivities and offsets that differ from pixel to pixel, and hot pixels."""

    kind = "fixed_pattern"
    title = "fixed pattern of the sensor"
    effects = ("photo_response_nonuniformity", "dark_signal_nonuniformity")
    # Hot pixels are a part of the dark current, which has no pattern else.
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = {"dark_current": {"hot_pixel_share": 0.0}}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the deviation of a grey value."""
        return f"{100 * self.deviation(scene):.2g} % of full scale"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return what takes most of it."""
        return Remedy(
            "a correction of the images by a dark and a bright one (`two_point_correction`)", {self.kind: 0.1}
        )

    def unlike(self, sensor: Any) -> bool:
        """Return whether the sensor has hot pixels."""
        return any(one.get("hot_pixel_share") for one in sensor["effects"])
