"""Linear stage: camera positions, frame times and positioning errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from scenetruth.indexing import centred_indices
from scenetruth.validated_model import Finite, FrozenModel, NonNegative, Positive

__all__ = ["STAGE_PRESETS", "Frames", "PoseOffset", "Stage", "StageErrors", "StagePose"]


_LARGEST_ANGLE_URAD = 1e5
_LARGEST_OFFSET_UM = 1e4

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


class PoseOffset(FrozenModel):
    """Difference of an actual pose from the nominal pose: displacement in world coordinates, and rotation vector."""

    x_um: Finite = 0.0
    """Displacement along X (to the right) in µm."""
    y_um: Finite = 0.0
    """Displacement along Y (down) in µm."""
    z_um: Finite = 0.0
    """Displacement along Z (forward) in µm."""
    pitch_urad: Finite = 0.0
    """X component of the rotation vector in µrad (right-hand rule)."""
    yaw_urad: Finite = 0.0
    """Y component of the rotation vector in µrad."""
    roll_urad: Finite = 0.0
    """Z component of the rotation vector in µrad."""

    @field_validator("x_um", "y_um", "z_um")
    @classmethod
    def _near(cls, value: float) -> float:
        if abs(value) > _LARGEST_OFFSET_UM:
            msg = f"must be at most {_LARGEST_OFFSET_UM:g} µm (10 mm) in magnitude: specify the offset in µm"
            raise ValueError(msg)
        return value

    @field_validator("pitch_urad", "yaw_urad", "roll_urad")
    @classmethod
    def _small(cls, value: float) -> float:
        if abs(value) > _LARGEST_ANGLE_URAD:
            msg = f"must be at most {_LARGEST_ANGLE_URAD:g} µrad (0.1 rad) in magnitude: specify the angle in µrad"
            raise ValueError(msg)
        return value

    @property
    def offset_um(self) -> NDArray[np.float64]:
        """Displacement (x, y, z) in µm."""
        return np.array([self.x_um, self.y_um, self.z_um])

    @property
    def rotation_rad(self) -> NDArray[np.float64]:
        """Rotation vector (pitch, yaw, roll) in rad."""
        return 1e-6 * np.array([self.pitch_urad, self.yaw_urad, self.roll_urad])


class StagePose(PoseOffset):
    """Actual pose of a position, for example from a calibration.

    It replaces the guide errors (straightness, pitch, yaw, roll) that would be drawn.
    """

    visits: tuple[PoseOffset, ...] | None = None
    """Further difference of every visit, one per frame: displacements and rotation vectors are added to those of the
    position. They replace the errors of repeatability and backlash that would be drawn.
    """


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
    axis_tilt_urad: tuple[Finite, Finite] | None = None
    """(a_y, a_z) in µrad: the positions lie along (1, a_y, a_z) instead of X; null for 0."""
    poses: tuple[StagePose, ...] | None = None
    """Actual poses of all positions, row by row, as differences from the nominal poses; null to draw them from
    ``errors``. With ``poses``, only visits that are not listed are drawn from ``errors``.
    """

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
                    f"step of {step:g} mm: positions would change their order; check mm and m of the baseline"
                )
                raise ValueError(msg)
        return value

    @field_validator("axis_tilt_urad")
    @classmethod
    def _nearly_along_x(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and max(map(abs, value)) > _LARGEST_ANGLE_URAD:
            msg = f"must be at most {_LARGEST_ANGLE_URAD:g} µrad (0.1 rad) in magnitude"
            raise ValueError(msg)
        return value

    @field_validator("poses")
    @classmethod
    def _one_per_position(
        cls, value: tuple[StagePose, ...] | None, info: ValidationInfo
    ) -> tuple[StagePose, ...] | None:
        known = {"positions", "baseline_mm", "positions_mm", "rows"} <= info.data.keys()
        if value is None or not known:
            return value
        positions, rows = info.data["positions"], info.data["rows"]
        if len(value) != positions * rows:
            grid = f"{rows} rows of {positions} positions" if rows > 1 else f"{positions} positions"
            msg = f"must be one pose per position: {len(value)} poses are listed for {grid}"
            raise ValueError(msg)
        listed, baseline = info.data["positions_mm"], info.data["baseline_mm"]
        planned = np.asarray(baseline * centred_indices(positions) if listed is None else listed, dtype=np.float64)
        actual = planned + 1e-3 * np.array([pose.x_um for pose in value]).reshape(rows, positions)
        steps = np.diff(actual, axis=1) * np.sign(np.diff(planned))
        if (steps < _COINCIDE_MM).any():
            row, place = (int(index) for index in np.argwhere(steps < _COINCIDE_MM)[0])
            first = row * positions + place
            msg = (
                f"x_um of poses {first} and {first + 1} change the order of their positions: "
                f"they are at {actual[row, place]:g} and {actual[row, place + 1]:g} mm"
            )
            raise ValueError(msg)
        return value

    @model_serializer(mode="wrap")
    def _without_unused(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the fields of listed poses where they are null, so that hashes of scenes without them remain."""
        plain: dict[str, Any] = write(self)
        return {key: value for key, value in plain.items() if value is not None or key not in _OMITTED}

    def visit_problem(self, frames: int) -> str:
        """Return a message if the number of visits of a listed pose differs from the number of frames, else ''."""
        wrong = [
            f"stage.poses.{number}.visits ({len(pose.visits)})"
            for number, pose in enumerate(self.poses or ())
            if pose.visits is not None and len(pose.visits) != frames
        ]
        shown = ", ".join(wrong[:5]) + (f" and {len(wrong) - 5} more" if len(wrong) > 5 else "")
        return f"visits are listed per frame, so their number must be {frames}: {shown}" if wrong else ""

    def stated_tolerances(self) -> dict[str, float]:
        """Return the standard deviations that a laboratory states for this stage, by the names of the tolerances.

        They are ``errors``, or without ``errors`` the RMS values of the listed poses and of the tilt of the axis.
        """
        if self.errors is not None:
            stated = self.errors.model_dump(exclude={"preset"})
            if self.scan == "unidirectional":
                # All positions are approached from the same side.
                del stated["backlash_um"]
        else:
            poses = self.poses or (StagePose(),) * (self.positions * self.rows)
            off = np.array([pose.offset_um for pose in poses]) + self._tilt_um()
            turns = np.array([pose.rotation_rad for pose in poses])
            visits = [visit for pose in poses for visit in pose.visits or ()]
            along = np.array([visit.x_um for visit in visits] or [0.0])
            stated = {
                "repeatability_um": _rms(along),
                "straightness_um": _rms(off[:, 1:]),
                "accuracy_um": _rms(off[:, 0]),
                **{f"{name}_urad": 1e6 * _rms(turns[:, k]) for k, name in enumerate(("pitch", "yaw", "roll"))},
            }
        return {name: value for name, value in stated.items() if value > 0}

    def _tilt_um(self) -> NDArray[np.float64]:
        """Return the displacements of all positions, row by row, by the tilt of the axis, shape (n, 3)."""
        along = np.tile(self.x_mm, self.rows)[:, None]
        return 1e-3 * along * (0.0, *(self.axis_tilt_urad or (0.0, 0.0)))

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


_OMITTED = ("axis_tilt_urad", "poses")
"""Fields that are not written where they are null."""


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
