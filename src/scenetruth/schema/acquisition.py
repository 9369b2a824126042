"""Acquisition of a recording: planned time of every image, tolerances of the stage, and lens with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem
from scenetruth.schema.attributes import read_intrinsics
from scenetruth.schema.outline import DatasetOutline

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "DISTORTION_ORDER",
    "LENS_TOLERANCES",
    "TOLERANCE_ATTRIBUTES",
    "TOLERANCE_NAMES",
    "Acquisition",
    "StageTolerances",
    "acquisition_problems",
    "is_finite_number",
    "read_acquisition",
    "tolerance_attributes",
]

Array = NDArray[np.float64]

DISTORTION_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Coefficients of the lens distortion in the order of the attribute ``distortion``, that of OpenCV."""
_COEFFICIENT_COUNTS = (4, 5, 8)


@dataclass(frozen=True)
class StageTolerances:
    """Standard deviations of the errors of a stage, as stated by its data sheet or calibration; 0 where not stated."""

    pitch_urad: float = 0.0
    """Rotation of a position about X."""
    yaw_urad: float = 0.0
    """Rotation of a position about Y."""
    roll_urad: float = 0.0
    """Rotation of a position about Z."""
    straightness_um: float = 0.0
    """Displacement of a position along Y and along Z."""
    accuracy_um: float = 0.0
    """Displacement of a position along X that repeats at every visit."""
    repeatability_um: float = 0.0
    """Displacement along X of every single visit of a position."""
    backlash_um: float = 0.0
    """Distance along X between approaches from below and from above."""
    scale_ppm: float = 0.0
    """Relative error of all distances along X."""

    @property
    def stated(self) -> bool:
        """Whether any error is stated."""
        return any(getattr(self, name) > 0 for name in TOLERANCE_NAMES)

    @property
    def corrects(self) -> bool:
        """Whether an error is stated that displaces images against each other."""
        return any(getattr(self, name) > 0 for name in TOLERANCE_NAMES if name != "scale_ppm")


TOLERANCE_NAMES: tuple[str, ...] = tuple(StageTolerances.__dataclass_fields__)
"""Names of the tolerances; the attributes of a recording have the prefix ``stage_tolerance_``."""
_PREFIX = "stage_tolerance_"
# Largest plausible values: 0.1 rad as in scenes, 10 mm, and 10 %.
_LARGEST = {"urad": 1e5, "um": 1e4, "ppm": 1e5}
LENS_TOLERANCES = ("focal_length_std_px", "principal_point_std_px", "distortion_std")
"""Attributes of a recording with the standard deviations of the calibration of the lens."""

TOLERANCE_ATTRIBUTES: tuple[str, ...] = (*(f"{_PREFIX}{name}" for name in TOLERANCE_NAMES), *LENS_TOLERANCES)
"""Optional attributes of a recording that state standard deviations of stage and lens."""


def tolerance_attributes(tolerances: Mapping[str, float]) -> dict[str, float]:
    """Return tolerances as attributes of a recording.

    >>> tolerance_attributes({"yaw_urad": 100.0})
    {'stage_tolerance_yaw_urad': 100.0}
    """
    return {f"{_PREFIX}{name}": value for name, value in tolerances.items()}


@dataclass(frozen=True, eq=False)
class Acquisition:
    """Times, tolerances and lens of a recording.

    ``time_s``: Planned time of every image, shape (s_y, s, t).
    ``line_time_s``: Time between the exposures of consecutive camera rows; 0 for a global shutter.
    ``stage_speed_mm_per_s``: Speed of the camera along X during the exposures.
    ``stage``: Tolerances of the stage.
    ``distortion``: Coefficients (k1, k2, p1, p2, k3, k4, k5, k6); empty for a pinhole camera.
    ``distortion_std``: Their standard deviations; empty if not stated.
    ``focal_length_std_px``, ``principal_point_std_px``: Standard deviations of the intrinsics; 0 if not stated.
    """

    time_s: Array
    line_time_s: float = 0.0
    stage_speed_mm_per_s: float = 0.0
    stage: StageTolerances = StageTolerances()
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    distortion_std: Array = field(default_factory=lambda: np.zeros(0))
    focal_length_std_px: float = 0.0
    principal_point_std_px: tuple[float, float] = (0.0, 0.0)

    @property
    def tolerances_stated(self) -> bool:
        """Whether the errors of stage or lens are stated."""
        lens = (self.focal_length_std_px, *self.principal_point_std_px, *self.distortion_std)
        return self.stage.stated or any(value > 0 for value in lens)


def read_acquisition(recording: xr.Dataset) -> Acquisition:
    """Read times, tolerances and lens of a validated recording; without planned times, frames are simultaneous.

    >>> from scenetruth.schema import make_recording
    >>> recording = make_recording(np.zeros((2, 3, 30, 40)), 500, 5, stage_tolerances={"yaw_urad": 20})
    >>> read_acquisition(recording).stage.yaw_urad, read_acquisition(recording).time_s[0].tolist()
    (20.0, [[-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    """
    attrs = recording.attrs
    sizes = recording["image"].sizes
    shape = (sizes.get("s_y", 1), sizes["s"], sizes["t"])
    if "planned_time_s" in recording.coords:
        times = np.asarray(recording["planned_time_s"].values, dtype=np.float64).reshape(shape)
    else:
        frames = recording["t"].values.astype(np.float64) * read_intrinsics(recording).frame_interval_s
        times = np.broadcast_to(frames, shape)
    # A lens with all coefficients zero is a pinhole.
    lens, uncertain = (_eight(attrs.get(name, ())) for name in ("distortion", "distortion_std"))
    point = np.broadcast_to(np.asarray(attrs.get("principal_point_std_px", 0.0), dtype=np.float64), (2,))
    return Acquisition(
        times,
        float(attrs.get("line_time_s", 0.0)),
        float(attrs.get("stage_speed_mm_per_s", 0.0)),
        StageTolerances(**{name: float(attrs.get(f"{_PREFIX}{name}", 0.0)) for name in TOLERANCE_NAMES}),
        lens if lens.any() else np.zeros(0),
        uncertain if uncertain.any() else np.zeros(0),
        float(attrs.get("focal_length_std_px", 0.0)),
        (float(point[0]), float(point[1])),
    )


def _eight(values: ArrayLike) -> Array:
    given = np.asarray(values, dtype=np.float64)
    return np.pad(given, (0, len(DISTORTION_ORDER) - len(given))) if given.size else given


def is_finite_number(value: Any) -> bool:
    """Return whether a value is a finite real number representable as a float."""
    if not isinstance(value, int | float | np.integer | np.floating) or isinstance(value, bool):
        return False
    try:
        return bool(np.isfinite(float(value)))
    except OverflowError:
        return False


def acquisition_problems(recording: xr.Dataset | DatasetOutline) -> list[Problem]:
    """Return all problems of times, positions, tolerances and lens of a recording."""
    return [
        *_tolerance_problems(recording),
        *_lens_problems(recording.attrs),
        *_timing_problems(recording),
        *_position_problems(recording),
    ]


def _tolerance_problems(recording: xr.Dataset | DatasetOutline) -> list[Problem]:
    problems = []
    for name, value in recording.attrs.items():
        if not str(name).startswith(_PREFIX):
            continue
        path, own = f"attrs.{name}", str(name).removeprefix(_PREFIX)
        if own not in TOLERANCE_NAMES:
            problems.append(Problem(path, f"is no tolerance; these are {', '.join(TOLERANCE_NAMES)}"))
            continue
        unit = own.rpartition("_")[2]
        most = _LARGEST[unit]
        problems += _size_problems(path, value, most, f"{most:g} {unit}")
    step = _smallest_step_mm(recording)
    for own in ("repeatability_um", "accuracy_um", "backlash_um"):
        value = recording.attrs.get(f"{_PREFIX}{own}")
        if step is not None and is_finite_number(value) and value is not None and 1e-3 * float(value) > step / 2:
            message = f"exceeds half the smallest step of {step:g} mm: positions would change their order"
            problems.append(Problem(f"attrs.{_PREFIX}{own}", message, value))
    return problems


def _size_problems(path: str, value: Any, most: float, stated: str) -> list[Problem]:
    if not is_finite_number(value):
        return [Problem(path, "must be a finite number: a standard deviation", "None" if value is None else value)]
    if float(value) < 0:
        return [Problem(path, "must not be negative: it is a standard deviation", value)]
    if float(value) > most:
        return [Problem(path, f"must be at most {stated}; check the unit", value)]
    return []


_LARGEST_COEFFICIENT_STD = 1e3


def _lens_problems(attrs: Mapping[Any, Any]) -> list[Problem]:
    problems = []
    counts: dict[str, int] = {}
    order = ", ".join(DISTORTION_ORDER)
    for name in ("distortion", "distortion_std"):
        if name not in attrs:
            continue
        values = attrs[name]
        listed = isinstance(values, list | tuple | np.ndarray) and getattr(values, "ndim", 1) == 1
        if not (listed and all(map(is_finite_number, values))):
            problems.append(
                Problem(f"attrs.{name}", "must be a list of finite numbers", "None" if values is None else values)
            )
        elif len(values) not in _COEFFICIENT_COUNTS:
            message = f"must hold 4, 5 or 8 coefficients in the order {order}; omit it for a pinhole camera"
            problems.append(Problem(f"attrs.{name}", message, list(values)))
        else:
            counts[name] = len(values)
            if name == "distortion_std":
                for at, value in zip(DISTORTION_ORDER, values, strict=False):
                    problems += _size_problems(
                        f"attrs.{name}.{at}", value, _LARGEST_COEFFICIENT_STD, f"{_LARGEST_COEFFICIENT_STD:g}"
                    )
    if "distortion_std" in attrs and "distortion" not in attrs:
        message = "states the uncertainty of a lens without coefficients: add distortion"
        problems.append(Problem("attrs.distortion_std", message, attrs["distortion_std"]))
    if len(counts) == 2 and counts["distortion"] != counts["distortion_std"]:
        message = f"must hold one value for each of the {counts['distortion']} coefficients of distortion"
        problems.append(Problem("attrs.distortion_std", message, counts["distortion_std"]))
    focal = attrs.get("focal_length_px")
    most = 0.5 * float(focal) if is_finite_number(focal) and focal is not None else np.inf
    if "focal_length_std_px" in attrs:
        problems += _size_problems("attrs.focal_length_std_px", attrs["focal_length_std_px"], most, "half of it")
    if "principal_point_std_px" in attrs:
        value = attrs["principal_point_std_px"]
        pair = isinstance(value, list | tuple | np.ndarray) and getattr(value, "ndim", 1) == 1 and len(value) == 2
        for index, part in enumerate(value if pair else (value,)):
            path = "attrs.principal_point_std_px" + (f".{index}" if pair else "")
            problems += _size_problems(path, part, most, "half of the focal length")
    return problems


# Frame times that differ from the frame interval by more than this factor are in another unit.
_INTERVAL_FACTOR = 2.0


def _timing_problems(recording: xr.Dataset | DatasetOutline) -> list[Problem]:
    attrs = recording.attrs
    problems = [
        Problem(f"attrs.{name}", f"must be a finite number{more}", "None" if attrs[name] is None else attrs[name])
        for name, more, valid in (
            ("line_time_s", ", not negative", lambda value: is_finite_number(value) and value >= 0),
            ("stage_speed_mm_per_s", "", is_finite_number),
        )
        if name in attrs and not valid(attrs[name])
    ]
    if "planned_time_s" not in recording.coords or "image" not in recording:
        return problems
    times = recording.variables["planned_time_s"]
    expected = tuple(dim for dim in ("s_y", "s", "t") if dim in recording["image"].dims)
    if times.dims != expected:
        return [*problems, Problem("planned_time_s", f"must have the dimensions {expected}", times.dims)]
    if times.dtype.kind not in "fiu" or not np.isfinite(times.values).all():
        return [*problems, Problem("planned_time_s", "must hold finite numbers", times.values.tolist())]
    values = np.asarray(times.values, dtype=np.float64)
    steps = np.diff(values, axis=-1)
    if (steps <= 0).any():
        place = tuple(int(n) for n in np.argwhere(steps <= 0)[0])
        where = ", ".join(f"{dim}={recording[dim].values[n]}" for dim, n in zip(expected, place, strict=True))
        message = f"must increase along t, but does not after {where}; number the frames in the order of acquisition"
        return [*problems, Problem("planned_time_s", message, values[place[:-1]].tolist())]
    interval = attrs.get("frame_interval_s")
    if steps.size and is_finite_number(interval) and interval is not None and float(interval) > 0:
        ratio = float(np.median(steps)) / float(interval)
        if not 1 / _INTERVAL_FACTOR <= ratio <= _INTERVAL_FACTOR:
            message = f"has frames {np.median(steps):g} s apart, but frame_interval_s is {float(interval):g} s"
            problems.append(Problem("planned_time_s", message))
    return problems


_COINCIDE_MM = 1e-6


def _position_problems(recording: xr.Dataset | DatasetOutline) -> list[Problem]:
    problems = []
    for name in ("stage_x_mm", "stage_y_mm"):
        values = _places_of(recording, name)
        if values is not None and len(values) > 1 and (np.diff(np.sort(values)) < _COINCIDE_MM).any():
            problems.append(Problem(name, "has positions that coincide: list each position once", values.tolist()))
    return problems


def _smallest_step_mm(recording: xr.Dataset | DatasetOutline) -> float | None:
    values = _places_of(recording, "stage_x_mm")
    return None if values is None or len(values) < 2 else float(np.diff(np.sort(values)).min())


def _places_of(recording: xr.Dataset | DatasetOutline, name: str) -> Array | None:
    if name not in recording.coords:
        return None
    values = recording.variables[name].values
    if values.dtype.kind not in "fiu" or values.ndim != 1 or not np.isfinite(values).all():
        return None
    return values.astype(np.float64)
