"""Files of a calibration: fields, covariance, and all problems of both."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.capture.calibration.rig_model import INTRINSICS, MOTION, STAGE, CalibrationError
from scenetruth.errors import Problem
from scenetruth.number_format import format_two_digits
from scenetruth.plain_data import plain_problems
from scenetruth.scene.yaml_reader import read_text, read_yaml
from scenetruth.valid_remainder import FieldRepair, read_model
from scenetruth.validated_model import Finite, FrozenModel, NonNegative

__all__ = ["CalibrationFile", "covariance_problem", "parameter_names", "read_calibration_file", "visits_problem"]

Array = NDArray[np.float64]

_ROUNDING = 1e-9
"""Relative rounding of a covariance in float64 with parameters of different units."""
_STD_DIGITS = 1e-4
"""Relative difference of a standard deviation in the YAML file from that of the covariance; it has six digits."""


class _Parameter(FrozenModel):
    value: Finite
    std: NonNegative
    prior_std: NonNegative | None


class _Image(FrozenModel):
    name: str
    points: Annotated[int, Field(ge=0)]
    excluded: Annotated[int, Field(ge=0)]
    mean_square: NonNegative
    rms_px: NonNegative
    consistent: bool


class _Combination(FrozenModel):
    ratio: NonNegative
    words: str


class _Size(FrozenModel):
    width: Annotated[int, Field(ge=1, le=32768)]
    height: Annotated[int, Field(ge=1, le=32768)]
    bit_depth: Annotated[int, Field(ge=1, le=32)] | None = None


class _Positions(FrozenModel):
    positions_mm: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=1001)]
    reference: Annotated[int, Field(ge=0)]


class _Covariance(FrozenModel):
    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class CalibrationFile(FrozenModel):
    """Fields of a calibration file."""

    format: Literal[1]
    camera: _Size
    stage: _Positions
    visits: tuple[Annotated[int, Field(ge=0)], ...]
    targets: tuple[str, ...]
    parameters: dict[str, _Parameter]
    chi2: NonNegative
    dof: Annotated[int, Field(ge=0)]
    images: tuple[_Image, ...]
    warnings: tuple[str, ...]
    combinations: tuple[_Combination, ...]
    measured_visits: tuple[tuple[Annotated[int, Field(ge=0)], ...], ...] = ()
    measured_images: str = ""
    covariance: _Covariance


class _CalibrationRepair(FieldRepair):
    """Values of a calibration file, in which fields with errors are removed or replaced."""

    required: ClassVar[Mapping[str, Any]] = {
        "format": 1,
        "camera": {"width": 64, "height": 48},
        "camera.width": 64,
        "camera.height": 48,
        "stage": {"positions_mm": [0.0], "reference": 0},
        "stage.positions_mm": [0.0],
        "stage.reference": 0,
        "visits": [],
        "targets": [],
        "parameters": {},
        "chi2": 0.0,
        "dof": 0,
        "images": [],
        "warnings": [],
        "combinations": [],
        "covariance": {"file": "calibration.npz", "sha256": "0" * 64},
        "covariance.file": "calibration.npz",
        "covariance.sha256": "0" * 64,
    }


def read_calibration_file(file: Path) -> tuple[CalibrationFile, Array]:
    """Return the content of a calibration file, and the covariance of the file next to it.

    Raises a `CalibrationError` with all problems of both.
    """
    try:
        plain, problems = read_yaml(read_text(file, "a calibration file"))
    except OSError as error:
        raise CalibrationError([Problem("", f"cannot be read: {error.strerror or error}")], file) from error
    except ValueError as error:
        raise CalibrationError([Problem("", str(error))], file) from error
    if not problems and not isinstance(plain, Mapping):
        problems = [Problem("", "must be a mapping of camera, stage, parameters and covariance", plain)]
    problems = problems or plain_problems(plain)
    if problems:
        raise CalibrationError(problems, file)
    repair = _CalibrationRepair(plain)
    given, problems = read_model(CalibrationFile, plain, repair)
    covariance = None
    if given is not None:
        problems += _contradictions(given, repair)
        covariance, more = _read_covariance(file, given, repair)
        problems += more
    if problems or given is None or covariance is None:
        raise CalibrationError(problems, file)
    return given, covariance


def _contradictions(given: CalibrationFile, repair: FieldRepair) -> Iterator[Problem]:
    """Yield the problems of fields that contradict others."""
    names, count = _names_of(given, repair), len(given.stage.positions_mm)
    for name in given.parameters if names else ():
        if name not in names:
            yield Problem(f"parameters.{name}", "is no parameter of this rig; remove it")
    focal = given.parameters.get("f")
    if focal is not None and focal.value <= 0:
        yield Problem("parameters.f.value", "must be positive", focal.value)
    elif focal is None and not repair.is_wrong("parameters", "f"):
        yield Problem("parameters.f", "is missing; it is the focal length in px")
    if repair.is_wrong("stage", "positions_mm"):
        return
    if given.stage.reference >= count:
        yield Problem("stage.reference", f"must be an index below {count}", given.stage.reference)
    if not repair.is_wrong("measured_visits") and not repair.is_wrong("visits"):
        message = visits_problem(given.measured_visits, given.visits, count)
        if message:
            yield Problem("measured_visits", message)


def _names_of(given: CalibrationFile, repair: FieldRepair) -> tuple[str, ...]:
    """Return the names of the parameters; empty if errors hide them."""
    if any(repair.is_wrong(*each.split(".")) for each in ("stage.positions_mm", "visits", "targets")):
        return ()
    return parameter_names(len(given.stage.positions_mm), given.visits, given.targets)


def parameter_names(positions: int, visits: Sequence[int], targets: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the parameters of a rig, in their order."""
    names = [*INTRINSICS, *STAGE]
    names += [f"position[{index}].{name}" for index in range(positions) for name in MOTION]
    names += [f"visit[{visit}].{name}" for visit in visits for name in MOTION]
    names += [f"{target}.{name}" for target in targets for name in ("scale", "warp_uu", "warp_uv", "warp_vv")]
    return tuple(names)


def visits_problem(measured: Sequence[Sequence[int]], visits: Sequence[int], positions: int) -> str:
    """Return why visits of a measurement are not those of a calibration; empty if they are."""
    listed, shape = [visit for each in measured for visit in each], {len(each) for each in measured}
    if listed and (len(measured) != positions or len(shape) != 1 or 0 in shape):
        return "must list as many visits for every position"
    if not set(listed) <= set(visits) or len(set(listed)) < len(listed):
        return "must be different visits of the calibration"
    return ""


def covariance_problem(matrix: Array, names: Sequence[str]) -> str:
    """Return why a matrix is no covariance of parameters; empty if it is one."""
    count = len(names)
    if matrix.shape != (count, count):
        return f"must be a matrix of {count} x {count} values, and has the shape {matrix.shape}"
    if not np.isfinite(matrix).all():
        return "must be finite"
    diagonal = np.diag(matrix)
    if (diagonal < 0).any():
        return f"has a negative variance of {names[int(np.argmin(diagonal))]}"
    deviations = np.sqrt(diagonal)
    scale = np.where(deviations > 0, deviations, 1.0)
    correlations = matrix / scale[:, None] / scale
    asymmetry = np.abs(correlations - correlations.T)
    if asymmetry.max(initial=0.0) > _ROUNDING:
        i, j = divmod(int(np.argmax(asymmetry)), count)
        return f"is not symmetric for {names[i]} and {names[j]}"
    fixed = deviations == 0
    if np.abs(correlations[fixed]).max(initial=0.0) > 0:
        return "has covariances of a parameter without a variance"
    least = float(np.linalg.eigvalsh(correlations[~fixed][:, ~fixed]).min(initial=1.0))
    if least < -_ROUNDING * max(count, 1):
        return f"is not positive semidefinite: its correlations have the eigenvalue {format_two_digits(least)}"
    return ""


def _read_covariance(file: Path, given: CalibrationFile, repair: FieldRepair) -> tuple[Array | None, list[Problem]]:
    """Return the covariance of a calibration file, None if there is none, and its problems."""
    if repair.is_wrong("covariance"):
        return None, []
    names, matrix, message = _stored_covariance(file.with_name(Path(given.covariance.file).name), given)
    expected = _names_of(given, repair)
    if matrix is not None and expected and names != expected:
        matrix, message = None, f"{given.covariance.file} has other parameters than the calibration file"
    if matrix is not None:
        message = covariance_problem(matrix, names)
    if matrix is None or message:
        return None, [Problem("covariance", message)]
    problems = []
    for name, std in zip(names, np.sqrt(np.diag(matrix)), strict=True):
        stated = given.parameters[name].std if name in given.parameters else 0.0
        hidden = repair.is_wrong("parameters", name)
        if not hidden and abs(stated - std) > _STD_DIGITS * std:
            message = f"is {std:.6g} in the covariance; calibrate again instead of editing the file"
            problems.append(Problem(f"parameters.{name}.std", message, stated))
    return matrix, problems


def _stored_covariance(file: Path, given: CalibrationFile) -> tuple[tuple[str, ...], Array | None, str]:
    """Return names and values of the matrix of a file; None for the latter, and the problem."""
    try:
        content = file.read_bytes()
    except OSError as error:
        return (), None, f"{file.name} cannot be read: {error.strerror}; keep it next to the calibration file"
    if hashlib.sha256(content).hexdigest() != given.covariance.sha256:
        return (), None, f"{file.name} has changed or belongs to another calibration; copy both files together"
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            names, matrix = tuple(map(str, arrays["names"].tolist())), arrays["covariance"]
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile) as error:
        return (), None, f"{file.name} is no file of a covariance: {error}"
    if matrix.dtype.kind != "f":
        return (), None, f"{file.name} must have a covariance of real numbers, and has {matrix.dtype}"
    return names, np.asarray(matrix, dtype=np.float64), ""
