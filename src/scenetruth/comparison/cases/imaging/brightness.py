"""Errors where the light changes from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class Brightness(Case):
    """The same sheet in light that grows."""

    kind = "brightness"
    title = "Change of brightness"
    question = "What does light that changes cost?"
    varied = "change of brightness per frame, %"
    core = (1.0, 10.0)
    full = (0.0, 0.3, 1.0, 3.0, 10.0)
    headline = ("velocity_z", "rms")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet in such light."""
        return sheet({"lighting.drift_per_frame": value / 100})
