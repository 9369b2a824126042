"""The stage's guide: yaw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.stage_cause import GuideCause


class StageYaw(GuideCause):
    """Rotations about Y, which shift images along x, as depth does."""

    kind = "stage_yaw"
    title = "yaw of the stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.yaw_urad": 0.0}
    field = "yaw_urad"
    axes = (4,)
    unit = 1e-6
