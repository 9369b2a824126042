"""The stage's guide: pitch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.design.budget.stage_cause import GuideCause


class StagePitch(GuideCause):
    """Rotations about X, which shift images along y."""

    kind = "stage_pitch"
    title = "pitch of the stage"
    perfect: ClassVar[Mapping[str, Any]] = {"stage.errors.pitch_urad": 0.0}
    field = "pitch_urad"
    axes = (3,)
    unit = 1e-6
