"""The stage's guide: straightness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.stage_cause import GuideCause


class StageStraightness(GuideCause):
    """Errors of position along Y and along Z."""

    kind = "stage_straightness"
    title = "straightness of the stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.straightness_um": 0.0}
    field = "straightness_um"
    axes = (1, 2)
    unit = 1e-3
