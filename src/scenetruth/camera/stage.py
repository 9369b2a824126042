"""Linear stage: camera positions, frame times and positioning errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from scenetruth.indexing import centred_indices
from scenetruth.validated_model import Finite, FrozenModel, NonNegative, Positive

__all__ = ["STAGE_PRESETS", "Frames", "Stage", "StageErrors"]


_LARGEST_ANGLE_URAD = 1e5

STAGE_PRESETS: Mapping[str, Mapping[str, float]] = {
    # Repeatability 1 µm and accuracy 10 µm: specified for stages with a 1 mm lead screw and crossed rollers
    # (Optimal Engineering Systems, XZ stages). Backlash, straightness and angles: typical values.
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
"""Stage errors of two stage types, by preset name."""


class StageErrors(FrozenModel):
    """Position and angle errors of a stage; all except backlash are standard deviations of normal distributions.

    The guide errors (straightness, pitch, yaw, roll) depend on the position only and repeat at every visit.
    """

    preset: Literal["screw_stage", "air_bearing"] | None = None
    """Stage type that supplies the default values; null for zero errors."""
    repeatability_um: NonNegative = 0.0
    """Standard deviation along X in µm, drawn anew for every move to a position."""
    backlash_um: NonNegative = 0.0
    """Distance in µm along X between approaches from below and from above; each misses the position by half."""
    straightness_um: NonNegative = 0.0
    """Standard deviation of the position along Y and along Z, in µm."""
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
            msg = f"must be at most {_LARGEST_ANGLE_URAD:g} µrad (0.1 rad)"
            raise ValueError(msg)
        return value


_COINCIDE_MM = 1e-6


def _either_spelling(schema: dict[str, Any]) -> None:
    """Declare in the JSON Schema that positions are a count with a baseline, or a list."""
    schema.pop("required", None)
    schema["anyOf"] = [{"required": ["positions", "baseline_mm"]}, {"required": ["positions_mm"]}]


class Stage(FrozenModel):
    """Linear stage along X with the reference at position 0.

    Positions are equidistant (``positions`` and ``baseline_mm``) or a list (``positions_mm``).
    """

    model_config = ConfigDict(json_schema_extra=_either_spelling)

    positions: Annotated[int, Field(ge=1, le=1001)]
    """Number of camera positions; the reference is the middle one (the lower middle of an even number)."""
    baseline_mm: Finite
    """V_X, displacement in mm between consecutive positions, positive to the right. With ``positions_mm`` it only
    defines the unit of s for disparities; default: the mean spacing.
    """
    positions_mm: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=1001)] | None = None
    """X of every position in mm, monotonic, instead of ``positions``; the reference is the middle one (the lower middle
    of an even number) and must be 0.
    """
    rows: Annotated[int, Field(ge=1, le=1001)] = 1
    """Number of rows of a grid of positions; the reference is the middle row (the lower middle of an even number)."""
    row_spacing_mm: Annotated[Finite | None, Field(validate_default=True)] = None
    """Displacement in mm between consecutive rows, positive downwards."""
    scan: Literal["unidirectional", "bidirectional"] = "unidirectional"
    """Scan order: ``unidirectional`` visits the positions as listed, row by row; ``bidirectional`` reverses the
    direction for every row and frame.
    """
    time_per_position_s: NonNegative = 0.0
    """Time in s between consecutive images within a frame (travel, settling, exposure); 0 for simultaneous images."""
    errors: StageErrors | None = None
    """Positioning errors of the stage; null for none."""

    @model_validator(mode="before")
    @classmethod
    def _count(cls, values: Any) -> Any:
        if not isinstance(values, dict) or values.get("positions_mm") is None:
            return values
        listed, filled = values["positions_mm"], {key: value for key, value in values.items() if value is not None}
        known = isinstance(listed, list | tuple) and len(listed) > 0
        if filled.get("positions") is None:
            filled["positions"] = len(listed) if known else 1
        if filled.get("baseline_mm") is None and not (known and len(listed) == 1):
            # Without a mean the list is invalid, which its own validator reports.
            filled["baseline_mm"] = (_mean_step(listed) if known else None) or 1.0
        return filled

    @field_validator("baseline_mm")
    @classmethod
    def _not_zero(cls, value: float) -> float:
        if value == 0:
            msg = "must not be zero: all camera positions would coincide"
            raise ValueError(msg)
        return value

    @field_validator("positions_mm")
    @classmethod
    def _in_order(cls, value: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        if value is None:
            return value
        reference = (len(value) - 1) // 2
        with np.errstate(over="ignore"):
            steps, gaps = np.diff(value), np.diff(np.sort(value))
        msg = ""
        if (gaps < _COINCIDE_MM).any():
            msg = "positions coincide: list each position once"
        elif not ((steps > 0).all() or (steps < 0).all()):
            msg = "must increase or decrease monotonically: sort the positions"
        elif value[reference] != 0:
            msg = (
                f"the reference is the middle position, index {reference}, and must be 0, the world origin: "
                f"subtract {value[reference]:g} from all, or choose other positions"
            )
        elif info.data.get("positions", len(value)) != len(value):
            msg = f"has {len(value)} positions, but 'positions' is {info.data['positions']}: omit 'positions'"
        elif len(value) > 1 and steps[0] * info.data.get("baseline_mm", steps[0]) < 0:
            msg = "contradicts the sign of baseline_mm: reverse the list, or omit baseline_mm"
        if msg:
            raise ValueError(msg)
        return value

    @field_validator("row_spacing_mm")
    @classmethod
    def _rows_apart(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is None and info.data.get("rows", 1) > 1:
            msg = "is required with more than one row"
            raise ValueError(msg)
        if value is not None and abs(value) < _COINCIDE_MM:
            msg = "must not be zero: all rows would coincide"
            raise ValueError(msg)
        return value

    @field_validator("errors")
    @classmethod
    def _in_their_places(cls, value: StageErrors | None, info: ValidationInfo) -> StageErrors | None:
        if value is None or not {"positions", "baseline_mm", "positions_mm"} <= info.data.keys():
            return value
        listed = info.data["positions_mm"]
        if info.data["positions"] > 1:
            with np.errstate(over="ignore"):
                step = abs(info.data["baseline_mm"]) if listed is None else float(np.abs(np.diff(listed)).min())
            off = 1e-3 * (value.backlash_um / 2 + 4 * value.repeatability_um)
            if off > step / 2:
                msg = (
                    f"half of backlash_um and four times repeatability_um are {off:g} mm, more than half the smallest "
                    f"step of {step:g} mm: positions would change their order"
                )
                raise ValueError(msg)
        return value

    @property
    def s(self) -> NDArray[np.int64]:
        """Camera indices, 0 the reference."""
        return centred_indices(self.positions)

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """Nominal camera positions in mm: the list, or X_s = V_X s."""
        listed = self.baseline_mm * self.s if self.positions_mm is None else self.positions_mm
        return np.asarray(listed, dtype=np.float64)

    @property
    def s_y(self) -> NDArray[np.int64]:
        """Row indices, 0 the reference."""
        return centred_indices(self.rows)

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """Nominal row positions in mm, positive downwards."""
        return np.asarray((self.row_spacing_mm or 0.0) * self.s_y, dtype=np.float64)

    @property
    def scan_interval_s(self) -> float:
        """Shortest frame interval that allows a complete scan.

        With an off-centre reference it exceeds the bidirectional scan time: reference images are equally spaced.
        """
        before, after = self.number_in_scan(0, 0), self.number_in_scan(0, 1)
        # Number of images between the reference images of consecutive frames.
        most = self.positions * self.rows + abs(after - before)
        return most * self.time_per_position_s

    def number_in_scan(self, s: int, t: int, s_y: int = 0) -> int:
        """Return the index of an image in the acquisition order of its frame."""
        row, place = s_y - int(self.s_y[0]), s - int(self.s[0])
        to_and_fro = self.scan == "bidirectional"
        if to_and_fro and row % 2 == 1:
            place = self.positions - 1 - place
        number = row * self.positions + place
        return self.positions * self.rows - 1 - number if to_and_fro and t % 2 == 1 else number


def _mean_step(listed: list[Any] | tuple[Any, ...]) -> float | None:
    try:
        step = (float(listed[-1]) - float(listed[0])) / (len(listed) - 1)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return step if math.isfinite(step) else None


class Frames(FrozenModel):
    """Frame times; frame 0 is the reference."""

    count: Annotated[int, Field(ge=1, le=100_000)]
    """Number of frames; the reference is the middle one (the lower middle of an even number)."""
    frame_interval_s: Positive = 1.0
    """Time between consecutive frames in s."""

    @property
    def t(self) -> NDArray[np.int64]:
        """Frame indices, 0 the reference."""
        return centred_indices(self.count)
