"""The noise floor: a sheet at rest, so that all that is found of its motion is noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class NoiseFloor(Case):
    """A sheet at rest, with more and more noise in its images."""

    kind = "noise"
    title = "Noise floor"
    question = "How much of the noise of the images reaches the estimate, and how close is that to what is possible?"
    varied = "noise of the images, standard deviation, of full scale"
    core = (0.005, 0.02)
    full = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
    logarithmic = True
    seeds: ClassVar[Mapping[str, int]] = {"core": 3, "full": 8}
    bounded = True
    quantities = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")
    headline = ("disparity", "noise")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet at rest."""
        return sheet({"objects.0.motion": []})

    def noise_std(self, value: float) -> float:
        """Return the noise itself."""
        return value
