"""Errors of position and angle of a real stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import field_validator, model_validator

from scenetruth.model import FrozenModel, NonNegative

__all__ = ["STAGE_PRESETS", "StageErrors"]

_LARGEST_ANGLE_URAD = 1e5

STAGE_PRESETS: Mapping[str, Mapping[str, float]] = {
    # Positions: 1 µm repeatability and 10 µm accuracy is what makers state of stages with a lead screw of 1 mm and
    # crossed rollers (Optimal Engineering Systems, XZ stages). Backlash, straightness and angles: typical values.
    "screw_stage": {
        "repeatability_um": 1.0,
        "backlash_um": 5.0,
        "straightness_um": 5.0,
        "pitch_urad": 100.0,
        "yaw_urad": 100.0,
        "roll_urad": 50.0,
    },
    # Straightness and flatness 0.1 µm, pitch and yaw 0.5" (2.4 µrad) over 25 mm: Physik Instrumente, "Air bearing
    # technology". Repeatability and roll: typical values; without a screw there is no backlash.
    "air_bearing": {
        "repeatability_um": 0.1,
        "backlash_um": 0.0,
        "straightness_um": 0.1,
        "pitch_urad": 2.5,
        "yaw_urad": 2.5,
        "roll_urad": 2.5,
    },
}
"""Errors of two kinds of stage, by name."""


class StageErrors(FrozenModel):
    """Errors of position and angle; all but the backlash are standard deviations of normal distributions.

    The guide's errors (straightness, pitch, yaw, roll) belong to a position and are the same at every visit.
    """

    preset: Literal["screw_stage", "air_bearing"] | None = None
    """Kind of stage whose values hold where none is given; null for a stage without errors."""
    repeatability_um: NonNegative = 0.0
    """Standard deviation along X in µm, fresh whenever the camera is moved to a position."""
    backlash_um: NonNegative = 0.0
    """Distance in µm along X between where a position is reached from below and from above: it is missed by half."""
    straightness_um: NonNegative = 0.0
    """Standard deviation of a position along Y, and along Z, in µm."""
    pitch_urad: NonNegative = 0.0
    """Standard deviation of the camera's rotation about X (right-hand rule) in µrad."""
    yaw_urad: NonNegative = 0.0
    """Standard deviation of its rotation about Y in µrad."""
    roll_urad: NonNegative = 0.0
    """Standard deviation of its rotation about Z in µrad."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, values: Any) -> Any:
        preset = values.get("preset") if isinstance(values, dict) else None
        return {**STAGE_PRESETS[preset], **values} if isinstance(preset, str) and preset in STAGE_PRESETS else values

    @field_validator("pitch_urad", "yaw_urad", "roll_urad")
    @classmethod
    def _small(cls, value: float) -> float:
        if value > _LARGEST_ANGLE_URAD:
            msg = f"must be at most {_LARGEST_ANGLE_URAD:g} µrad (0.1 rad): a guide that turns farther is no stage"
            raise ValueError(msg)
        return value
