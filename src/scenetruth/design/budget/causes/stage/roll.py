"""The stage's guide: roll."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.stage_cause import GuideCause


class StageRoll(GuideCause):
    """Rotations about Z, which turn images."""

    kind = "stage_roll"
    title = "roll of the stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.roll_urad": 0.0}
    field = "roll_urad"
    axes = (5,)
    unit = 1e-6
