"""Options of the commands compare, design and validation."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli.options import flag, option, repeatable

if TYPE_CHECKING:
    from scenetruth.errors import Problem

__all__ = [
    "BaselinePercent", "Calibration", "CalibrationPreset", "Cases", "Contrast", "Coverage", "Divergence",
    "DivergenceOption", "DotMm", "DotPx", "Encoding", "ExternalResults", "FocalLengthPercent", "FocalLengthPx",
    "Levels", "Light", "MarginMm", "MmPerPx", "Model", "OpenGLPlatform", "Page", "PatternType", "PatternTypeOption",
    "PhotographEncoding", "Platform", "PredictionModel", "PrincipalPointPx", "ReferenceImages", "Runs", "SensorPresets",
    "SimulatedShare", "SizeMm", "SobolPoints", "Spacing", "Suite", "SuiteName", "SurfaceDistanceMm", "Vary",
    "WavelengthMm", "WavelengthPx", "WindowSigmaPx", "WriteRecordings", "parse_seeds", "read_seeds",
]  # fmt: skip


class SuiteName(StrEnum):
    """Benchmark suites."""

    core = "core"
    full = "full"


class CalibrationPreset(StrEnum):
    """Presets of the calibration uncertainty."""

    typical = "typical"
    perfect = "perfect"


class PredictionModel(StrEnum):
    """Models of a prediction."""

    analytic = "analytic"
    maps = "maps"


class PatternType(StrEnum):
    """Types of printed patterns, and of calibration boards."""

    speckle = "speckle"
    noise = "noise"
    grey_noise = "grey_noise"
    charuco = "charuco"
    checkerboard = "checkerboard"
    dots = "dots"
    asymmetric_dots = "asymmetric_dots"


BOARD_TYPES = (PatternType.charuco, PatternType.checkerboard, PatternType.dots, PatternType.asymmetric_dots)
"""Pattern types that are calibration boards."""


class Encoding(StrEnum):
    """Grey-value encodings of a photograph."""

    srgb = "srgb"
    linear = "linear"


class OpenGLPlatform(StrEnum):
    """OpenGL platforms of pyrender."""

    auto = "auto"
    osmesa = "osmesa"
    egl = "egl"


class Divergence(StrEnum):
    """Forms of the divergence term."""

    paper = "paper"
    consistent = "consistent"


# Options of compare.
Suite = Annotated[SuiteName, typer.Option("--suite", help="Suite: core is short, full has all levels.")]

Cases = Annotated[list[str] | None, repeatable("--case", "NAME", "Benchmark case; all of the suite if not given.")]

Levels = Annotated[
    list[str] | None,
    repeatable("--level", "VALUE", "Level of a single case, a number or a label; all if not given."),
]

ExternalResults = Annotated[
    list[str] | None,
    repeatable("--results", "LABEL=DIR", "Directory of external results for the recordings of --write-recordings."),
]

WriteRecordings = Annotated[
    bool, flag("--write-recordings", help="Recordings of the suite in the output directory, without any estimation.")
]

# Options of design.
Calibration = Annotated[CalibrationPreset, typer.Option("--calibration", help="Preset of the calibration uncertainty.")]

FocalLengthPercent = Annotated[
    float | None,
    option("--focal-length-percent", metavar="PERCENT", help="Standard uncertainty of the focal length, in %."),
]

PrincipalPointPx = Annotated[
    float | None,
    option("--principal-point-px", metavar="PX", help="Standard uncertainty of the principal point per axis, in px."),
]

BaselinePercent = Annotated[
    float | None,
    option("--baseline-percent", metavar="PERCENT", help="Standard uncertainty of the stage scale, in %."),
]

SimulatedShare = Annotated[
    float,
    typer.Option(
        "--simulated-share",
        metavar="SHARE",
        min=0,
        max=1,
        help="Share of the sum of squares that is confirmed by simulation; 1 for all sources.",
    ),
]

Model = Annotated[
    PredictionModel,
    typer.Option("--model", help="Model: analytic uses the texture spectrum, maps uses a rendered image."),
]

Vary = Annotated[
    list[str] | None,
    repeatable(
        "--vary",
        "PATH=VALUES",
        "Factor and its levels: 1,2,5; 1..10:4 for four levels; 1..10:4log; 1..10 or 1..10:log with --sobol-points.",
    ),
]

SobolPoints = Annotated[
    int, typer.Option("--sobol-points", metavar="N", min=0, help="Number of design points of a Sobol sequence.")
]

FocalLengthPx = Annotated[
    float | None, option("--focal-length-px", metavar="PX", help="Focal length where no scene defines it, in px.")
]

SurfaceDistanceMm = Annotated[
    float | None,
    option(
        "--distance-mm",
        metavar="MM",
        help="Distance of the surface, in mm; the median depth of the scene if not given.",
    ),
]

Light = Annotated[float, typer.Option("--light", metavar="VALUE", help="Radiance of a white surface, 1 is full scale.")]

PatternTypeOption = Annotated[PatternType, typer.Option("--type", help="Type of the pattern or calibration board.")]

BoardLengths = Annotated[
    list[str] | None,
    repeatable(
        "--board",
        "NAME=VALUE",
        "Number or length of a calibration board, with a value in YAML: squares=[12,9], square_mm, marker_mm, "
        "dictionary, dots=[11,8], spacing_mm, diameter_mm; all that its type requires, or none.",
    ),
]

SizeMm = Annotated[
    str | None, option("--size-mm", metavar="WxH", help="Size of the sheet, in mm; 1.1 fields of view if not given.")
]

DotPx = Annotated[
    float | None, option("--dot-px", metavar="PX", help="Dot diameter on the sensor, in px; 4 if not given.")
]

DotMm = Annotated[float | None, option("--dot-mm", metavar="MM", help="Dot diameter on the surface, in mm.")]

Coverage = Annotated[
    float | None, option("--coverage", metavar="SHARE", help="Fraction of the area with ink; 0.5 if not given.")
]

Spacing = Annotated[
    float | None,
    option(
        "--spacing",
        metavar="VALUE",
        help="Minimum distance of dot centres, in diameters; 1 (no overlap) if not given.",
    ),
]

WavelengthPx = Annotated[
    str | None,
    option("--wavelength-px", metavar="MIN,MAX", help="Wavelength band on the sensor, in px; 5,20 if not given."),
]

WavelengthMm = Annotated[
    str | None, option("--wavelength-mm", metavar="MIN,MAX", help="Wavelength band on the surface, in mm.")
]

Contrast = Annotated[
    float | None,
    option("--contrast", metavar="VALUE", help="Contrast of grey noise: standard deviation over range."),
]

Page = Annotated[str, typer.Option("--page", metavar="SIZE", help="Page: A5 to A0, letter, or WIDTHxHEIGHT in mm.")]

MarginMm = Annotated[float, typer.Option("--margin-mm", metavar="MM", help="Unprinted margin of the page, in mm.")]

ReferenceImages = Annotated[
    list[Path] | None, repeatable("--reference-image", "IMAGE", "Photograph of a pattern for comparison.")
]

MmPerPx = Annotated[
    float | None,
    option(
        "--mm-per-px",
        metavar="MM",
        help="Pixel size of the photographs on the surface, in mm; that of the camera of the rig if not given.",
    ),
]

PhotographEncoding = Annotated[Encoding, typer.Option("--encoding", help="Grey-value encoding of the photographs.")]

WindowSigmaPx = Annotated[
    float,
    typer.Option("--window-sigma-px", metavar="PX", help="Standard deviation of the analysis window, in px."),
]

# Options of validation studies.
DivergenceOption = Annotated[
    Divergence, typer.Option("--divergence", help="Divergence term of the structure-tensor method.")
]

Runs = Annotated[
    int | None,
    option("--runs", metavar="N", min=1, help="Simulations per point; 8 without and 60 with noise if not given."),
]

SensorPresets = Annotated[list[str] | None, repeatable("--preset", "NAME", "Sensor preset; all if not given.")]

Platform = Annotated[OpenGLPlatform, typer.Option("--platform", help="OpenGL platform of pyrender.")]


def parse_seeds(given: str, problems: list[Problem]) -> int | list[int]:
    """Return a number of seeds, or a list of seeds separated by commas; add a problem if it is neither."""
    from scenetruth.errors import Problem

    try:
        numbers = [int(text) for text in given.split(",")]
    except ValueError:
        problems.append(Problem("--seeds", "must be a number of seeds, or a list such as 1,2,3", given))
        return 0
    return numbers if "," in given else numbers[0]


def read_seeds(given: str | None) -> int | list[int] | None:
    """Return the seeds of the option --seeds."""
    from scenetruth.errors import ArgumentError

    problems: list[Problem] = []
    seeds = None if given is None else parse_seeds(given, problems)
    if problems:
        raise ArgumentError(problems)
    return seeds
