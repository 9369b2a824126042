"""Positions along the stage that are missed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np

from scenetruth.camera import Schedule
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Change, Disturbance, Sight, posed, poses_of
from scenetruth.design.budget.stage_cause import air_bearing, schedule_of_stage
from scenetruth.randomness import generator_for
from scenetruth.scene import Scene


class StagePosition(Cause):
    """Errors along X that are new at every visit, and the backlash, which depends on where the stage comes from."""

    kind = "stage_position"
    title = "position of the stage"
    group = "stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.repeatability_um": 0.0, "stage.errors.backlash_um": 0.0}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return repeatability and backlash."""
        errors = scene.stage.errors
        if errors is None:
            return ""
        backlash = f", backlash {errors.backlash_um:g} µm" if errors.backlash_um else ""
        return f"{errors.repeatability_um:g} µm{backlash}"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the error of every visit, and what the backlash does in all of them."""
        errors = sight.scene.stage.errors
        if errors is None:
            return
        for place in [(s, t) for s in sight.s for t in sight.t] if errors.repeatability_um else []:
            yield partial(_of_one_image, sight, place, 1e-3 * errors.repeatability_um)
        if errors.backlash_um:
            only = errors.model_copy(update=dict.fromkeys(_OTHERS, 0.0))
            stage = sight.scene.stage.model_copy(update={"errors": only, "time_per_position_s": 0.0})
            yield poses_of(Schedule(stage, sight.scene.frames, partial(generator_for, 0, "stage")), sight)

    def drawn(self, sight: Sight, scene: Scene) -> Iterable[Disturbance]:
        """Return what the stage of a scene does in fact."""
        return [poses_of(schedule_of_stage(scene), sight)]

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return a better stage."""
        errors = scene.stage.errors
        backlash = errors is not None and errors.backlash_um > errors.repeatability_um
        return air_bearing(scene, "backlash_um" if backlash else "repeatability_um", self.kind)


_OTHERS = ("repeatability_um", "straightness_um", "pitch_urad", "yaw_urad", "roll_urad")


def _of_one_image(sight: Sight, place: tuple[int, int], size_mm: float, s: int, t: int) -> Change | None:
    return posed(sight, s, t, np.array([size_mm, 0.0, 0.0]), np.zeros(3)) if (s, t) == place else None
