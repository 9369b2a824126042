"""Arguments and options of several commands."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from scenetruth.cli.bundled_files import (
    DESIGNS,
    RECIPES,
    SCENES,
    BundledFiles,
    file_completer,
    method_names,
    resolve_file,
)

if TYPE_CHECKING:
    from scenetruth.errors import Problem
    from scenetruth.estimators.method_specs import MethodSpec
    from scenetruth.scene import Scene

__all__ = [
    "AllowMismatch", "Band", "BenchmarkMethods", "CardDate", "CardUrl", "CardVersion", "Command", "CommandImages",
    "CommandKeep", "CommandMemoryMb", "CommandName", "CommandTimeoutS", "CommandUsesMask", "ConfirmationSeeds",
    "DatasetPath", "DesignFile", "EstimatedMethods", "ExchangeFormat", "ExportSource", "ExportedMethod", "Extend",
    "FigureFormat", "FigureFormats", "Figures", "Flow", "Format", "FormatOptions", "ImageFormat", "Json",
    "LabelledCommands", "LabelledMethods", "Left", "Limits", "ListKind", "Listed", "MaxTasksPerWorker", "Mesh",
    "MeshDistanceMm", "Method", "Methods", "OptionalOutput", "OptionalSceneFile", "OptionalSeeds", "Output",
    "Overrides", "Overwrite", "PartOf", "RecipeFile", "Regenerate", "Region", "Report", "ResultPath", "Retries", "Row",
    "RunPath", "SampleNumber", "Samples", "SamplesPerShard", "SaveImages", "SaveRadiance", "SceneFile", "SceneFiles",
    "SceneSeed",
    "Scheduler", "SchemaFile", "SchemaKind", "SchemaOf", "Seed", "Seeds", "Settings", "SinceFrame", "StrainChoice",
    "StrainMeasure", "StrainMethod", "StrainOrder", "StrainStep", "StrainWeight", "StrainWeights", "StrainWindow",
    "SubsetPx", "TemplateFile", "TemplateType", "Texture", "Threads", "TruthContent", "TruthContentChoice",
    "TruthMaps", "TruthPoses", "TruthPosesChoice", "TruthViews", "TruthViewsChoice", "Type", "UnitMm", "Workers",
    "add_command", "choose_band", "flag", "helpers", "option", "parse_assignments", "read_settings", "repeatable",
    "with_settings",
]  # fmt: skip


def helpers() -> int:
    """Return the number of additional processes of a command: one, if a processor is available."""
    return int(len(os.sched_getaffinity(0)) > 1) if hasattr(os, "sched_getaffinity") else int((os.cpu_count() or 1) > 1)


class FigureFormat(StrEnum):
    """File formats of the figures of a report."""

    png = "png"
    pdf = "pdf"


class ImageFormat(StrEnum):
    """File formats of images."""

    png = "png"
    tiff = "tiff"


class ExchangeFormat(StrEnum):
    """File formats of the images for an external command."""

    png = "png"
    tiff = "tiff"
    npy = "npy"


class TruthViewsChoice(StrEnum):
    """Cameras of a ground truth."""

    reference = "reference"
    all = "all"


class TruthPosesChoice(StrEnum):
    """Poses and times of a ground truth."""

    actual = "actual"
    nominal = "nominal"


class TruthContentChoice(StrEnum):
    """Maps of a ground truth."""

    standard = "standard"
    complete = "complete"
    complete_with_light = "complete_with_light"


class TemplateType(StrEnum):
    """Scene templates."""

    cube = "cube"
    leaf = "leaf"
    mesh = "mesh"


class ListKind(StrEnum):
    """Categories of `scenetruth list`."""

    scenes = "scenes"
    recipes = "recipes"
    designs = "designs"
    methods = "methods"
    formats = "formats"
    cases = "cases"


class StrainChoice(StrEnum):
    """Strain tensors."""

    green_lagrange = "green_lagrange"
    hencky = "hencky"
    engineering = "engineering"
    rate = "rate"


class StrainWeight(StrEnum):
    """Weights of strain windows."""

    uniform = "uniform"
    gaussian = "gaussian"


class SchemaKind(StrEnum):
    """File types with a JSON Schema."""

    scene = "scene"
    recipe = "recipe"
    design = "design"
    capture = "capture"


def _check_output(context: typer.Context, path: Path | None) -> Path | None:
    """Return the output directory of a command; reject, before any work, a directory that cannot be created."""
    if path is None or context.resilient_parsing:
        return path
    if path.name in ("", ".."):
        msg = "must name a directory to create; '.', '..' and '/' exist already"
        raise typer.BadParameter(msg)
    from scenetruth.output import check_writable

    check_writable(path)
    return path


def flag(*names: str, help: str) -> Any:
    """Return an option that takes no value."""
    return typer.Option(*names, help=help, show_default=False)


def option(*names: str, help: str, **more: Any) -> Any:
    """Return an option without a default that could be shown."""
    return typer.Option(*names, help=help, show_default=False, **more)


def repeatable(name: str, metavar: str, help: str, **more: Any) -> Any:
    """Return an option that can be given several times."""
    return typer.Option(name, metavar=metavar, help=f"{help} Repeatable.", show_default=False, **more)


def _file(category: BundledFiles, help: str) -> Any:
    return typer.Argument(
        metavar=category.metavar,
        help=help,
        show_default=False,
        callback=lambda given: None if given is None else resolve_file(category, given),
        autocompletion=file_completer(category),
    )


# Arguments.
SceneFile = Annotated[Path, _file(SCENES, "Scene file (YAML), or a bundled scene (`scenetruth list scenes`).")]

OptionalSceneFile = Annotated[
    Path | None, _file(SCENES, "Scene file (YAML) that defines the rig, or a bundled scene (`scenetruth list scenes`).")
]

SceneFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCENE...",
        help="Scene files (YAML), or bundled scenes (`scenetruth list scenes`).",
        show_default=False,
        callback=lambda given: [resolve_file(SCENES, path) for path in given],
        autocompletion=file_completer(SCENES),
    ),
]

RecipeFile = Annotated[
    Path, _file(RECIPES, "Recipe (YAML), a bundled recipe (`scenetruth list recipes`), or a data-set directory.")
]

DesignFile = Annotated[
    Path, _file(DESIGNS, "Design specification (YAML), or a bundled design (`scenetruth list designs`).")
]

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Run directory.", show_default=False)]

ResultPath = Annotated[
    Path, typer.Argument(metavar="PATH", help="Run directory, store, or data-set directory.", show_default=False)
]

ExportSource = Annotated[
    Path, typer.Argument(metavar="PATH", help="Run directory, or data-set directory.", show_default=False)
]

DatasetPath = Annotated[Path, typer.Argument(metavar="DATASET", help="Data-set directory.", show_default=False)]

SampleNumber = Annotated[
    int, typer.Argument(metavar="NUMBER", min=0, help="Number of the sample, from 0.", show_default=False)
]

BenchmarkMethods = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="METHOD...",
        help="Methods: NAME, MODULE:FUNCTION, NAME\\[setting: value, ...], LABEL=NAME\\[...].",
        show_default=False,
    ),
]

TemplateFile = Annotated[Path, typer.Argument(metavar="FILE", help="Scene file (YAML) to write.")]

Listed = Annotated[ListKind, typer.Argument(metavar="KIND", help=f"One of {', '.join(ListKind)}.", show_default=False)]

SchemaOf = Annotated[SchemaKind, typer.Argument(metavar="[KIND]", help=f"One of {', '.join(SchemaKind)}.")]

# Options of several commands.
Output = Annotated[Path, option("--output", "-o", metavar="DIR", help="Output directory.", callback=_check_output)]

OptionalOutput = Annotated[
    Path | None,
    option(
        "--output",
        "-o",
        metavar="DIR",
        help="Output directory; nothing is written without it.",
        callback=_check_output,
    ),
]

Overwrite = Annotated[bool, flag("--overwrite", help="Replacement of existing results.")]

AllowMismatch = Annotated[bool, flag("--allow-mismatch", help="Acceptance of parts of different runs.")]

Overrides = Annotated[
    list[str] | None,
    repeatable("--set", "PATH=VALUE", "Field of the scene, recipe or specification, with a value in YAML."),
]

Band = Annotated[
    str | None, option("--band", metavar="NAME", help="Render or predict one band, as a grey camera records it.")
]

Settings = Annotated[
    list[str] | None, repeatable("--setting", "NAME=VALUE", "Setting of the method, with a value in YAML.")
]

FormatOptions = Annotated[
    list[str] | None,
    repeatable("--option", "NAME=VALUE", "Option of the format (`scenetruth list formats`), with a value in YAML."),
]

Limits = Annotated[
    list[str] | None,
    repeatable(
        "--limit",
        "NAME=VALUE",
        "Resource limit instead of its default: frames, images, pixels, samples, vertices, objects, leaves, texels, "
        "image_pixels, memory_gb, disk_gb, hours.",
    ),
]

Methods = Annotated[
    list[str] | None,
    repeatable(
        "--method",
        "NAME",
        "Method (`scenetruth list methods`), or MODULE:FUNCTION; the method of the scene if not given.",
        autocompletion=method_names,
    ),
]

EstimatedMethods = Annotated[
    list[str] | None,
    repeatable("--method", "NAME", "Method with an estimate; all if not given.", autocompletion=method_names),
]

LabelledMethods = Annotated[
    list[str] | None,
    repeatable(
        "--method",
        "NAME",
        "Method: NAME, MODULE:FUNCTION, NAME\\[setting: value, ...], LABEL=NAME\\[...]; the method of each scene if "
        "not given.",
        autocompletion=method_names,
    ),
]

Method = Annotated[
    str | None,
    option(
        "--method",
        metavar="NAME",
        help="Method (`scenetruth list methods`); the method of the scene if not given.",
        autocompletion=method_names,
    ),
]

ExportedMethod = Annotated[
    str | None,
    option(
        "--method",
        metavar="NAME",
        help="Method whose estimate is exported; the ground truth if not given.",
        autocompletion=method_names,
    ),
]


def _check_workers(given: int) -> int:
    if given == 0:
        raise typer.BadParameter("must be 1 or more, or -1 for all processors (got 0)")
    return given


Workers = Annotated[
    int,
    typer.Option(
        "--workers",
        metavar="N",
        min=-1,
        max=1024,
        callback=_check_workers,
        help="Number of worker processes; 1 starts none, -1 uses all processors.",
    ),
]

Threads = Annotated[int, typer.Option("--threads", metavar="N", min=1, max=1024, help="Threads of a worker process.")]

Scheduler = Annotated[
    str | None,
    option("--scheduler", metavar="ADDRESS", help="Dask scheduler, for example tcp://HOST:8786, or its file."),
]

Fresh = Annotated[bool, flag("--fresh", help="New measurement of all scenes; existing results are not reused.")]

Retries = Annotated[
    int, typer.Option("--retries", metavar="N", min=0, max=100, help="Number of repetitions of a failed sample.")
]

SceneSeed = Annotated[
    int | None,
    option("--seed", metavar="N", min=0, help="Seed of the scene or recipe; the value of the file if not given."),
]

Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the random numbers.")]

Seeds = Annotated[
    str, typer.Option("--seeds", metavar="N|LIST", help="Number of seeds, or a list of seeds, for example 1,2,3.")
]

OptionalSeeds = Annotated[
    str | None, option("--seeds", metavar="N|LIST", help="Number of seeds at each level, or a list of seeds.")
]
ConfirmationSeeds = Annotated[
    int | None,
    option("--seeds", metavar="N", min=1, max=1000, help="Number of simulated recordings of each confirmed rig."),
]

Region = Annotated[
    str, typer.Option("--region", metavar="NAME", help="Region: interior, all, object_NAME, or another of the result.")
]

Json = Annotated[bool, flag("--json", help="Machine-readable output (JSON).")]

Quiet = Annotated[bool, flag("--quiet", "-q", help="Results, warnings and errors only.")]

Verbose = Annotated[bool, flag("--verbose", "-v", help="Additional messages, with run times in s.")]

# Options of run, render, estimate and report.
SaveImages = Annotated[
    ImageFormat | None, option("--save-images", help="Additional image files: 16-bit PNG, or TIFF of floats.")
]

SaveRadiance = Annotated[bool, flag("--save-radiance", help="Additional linear images before the sensor.")]

TruthViews = Annotated[TruthViewsChoice, typer.Option("--truth-views", help="Cameras of the ground truth.")]

TruthPoses = Annotated[
    TruthPosesChoice, typer.Option("--truth-poses", help="Camera poses and times of the ground truth.")
]

TruthContent = Annotated[
    TruthContentChoice,
    typer.Option(
        "--truth-content",
        help="Maps of the ground truth: for scores, all, or all with light.",
    ),
]

Report = Annotated[bool, typer.Option("--report/--no-report", help="Figures and report.")]

Figures = Annotated[
    list[str] | None,
    repeatable("--figure", "NAME", "Figure of the report, for example depth or velocity_z; all if not given."),
]

FigureFormats = Annotated[
    FigureFormat, typer.Option("--figure-format", help="File format of figures; pdf is written in addition to png.")
]

Command = Annotated[
    str | None,
    option(
        "--command",
        metavar="WORDS",
        help="External program as a method: 'python mine.py {recording} {output}'.",
    ),
]

LabelledCommands = Annotated[
    list[str] | None,
    repeatable("--command", "LABEL=WORDS", "External program as a method: 'mine=python mine.py {recording} {output}'."),
]

CommandName = Annotated[
    str, typer.Option("--command-name", metavar="NAME", help="Method name of the external program.")
]

CommandImages = Annotated[
    ExchangeFormat, typer.Option("--command-images", help="Image format for the external program.")
]

CommandTimeoutS = Annotated[
    float, typer.Option("--command-timeout-s", metavar="S", help="Time limit of the external program, in s.")
]

CommandMemoryMb = Annotated[
    float | None,
    option("--command-memory-mb", metavar="MB", help="Limit of the resident memory of the external program, in MB."),
]

CommandUsesMask = Annotated[
    bool, flag("--command-uses-mask", help="Declaration that the external program uses exclusion masks.")
]

CommandKeep = Annotated[
    Path | None,
    option("--command-keep", metavar="DIR", help="Directory for the input and output files of the external program."),
]

# Options of export and verify.
Format = Annotated[str, option("--format", metavar="NAME", help="Export format (`scenetruth list formats`).")]

Left = Annotated[int | None, option("--left", metavar="S", help="Left camera of a stereo pair, by its index s.")]

Flow = Annotated[
    str | None,
    option(
        "--flow",
        metavar="TYPE",
        help="Motion: finite is the displacement to the next image, instantaneous the image velocity.",
    ),
]

Row = Annotated[int | None, option("--row", metavar="N", help="Row of a camera grid, by its index s_y.")]

# Options of strain.
StrainMethod = Annotated[
    str | None,
    option(
        "--method",
        metavar="NAME",
        help="Method with an estimate; the first one, or without estimates the ground truth, if not given.",
        autocompletion=method_names,
    ),
]

StrainMeasure = Annotated[StrainChoice, typer.Option("--measure", help="Strain tensor; rate is per frame.")]

StrainWindow = Annotated[
    int, typer.Option("--window", metavar="N", help="Points along each side of the strain window, an odd number.")
]

StrainStep = Annotated[int, typer.Option("--step", metavar="N", help="Distance of the points, in pixels of the maps.")]

StrainOrder = Annotated[int, typer.Option("--order", metavar="N", help="Order of the polynomial, 1 or 2.")]

StrainWeights = Annotated[StrainWeight, typer.Option("--weights", help="Weights of the strain window.")]

SubsetPx = Annotated[
    float | None,
    option("--subset-px", metavar="PX", help="Subset of the displacements, in px; from the estimate if not given."),
]

SinceFrame = Annotated[
    int | None,
    option(
        "--since", metavar="T", help="Frame of the reference configuration of all frames; each its own if not given."
    ),
]

Regenerate = Annotated[
    int,
    typer.Option(
        "--regenerate", metavar="N", min=0, help="Number of data-set samples that are generated again and compared."
    ),
]

# Options of init.
Type = Annotated[
    TemplateType | None, option("--type", help="Scene template; mesh with --mesh, otherwise cube if not given.")
]

Mesh = Annotated[Path | None, option("--mesh", metavar="FILE", help="Mesh file: OBJ, PLY, GLB, STL, OFF.")]

Texture = Annotated[
    Path | None, option("--texture", metavar="FILE", help="Image file on the cube, or on a mesh with UV coordinates.")
]

UnitMm = Annotated[
    float | None, typer.Option("--unit-mm", metavar="MM", help="Length unit of the mesh, in mm.", show_default="1.0")
]

MeshDistanceMm = Annotated[
    float | None,
    option(
        "--distance-mm",
        metavar="MM",
        help="Distance of the nearest mesh point, in mm; ten times the size of the mesh if not given.",
    ),
]

SchemaFile = Annotated[
    Path | None,
    option(
        "--schema",
        metavar="FILE",
        help="JSON Schema for editors, from `scenetruth schema > FILE`; scene.schema.json in the same directory if not "
        "given.",
    ),
]

# Options of data sets.
Samples = Annotated[
    int | None,
    option(
        "--samples",
        metavar="N",
        min=1,
        max=100_000,
        help="Number of samples; 500 if not given, or 48 if the geometry of each is evaluated.",
    ),
]

PartOf = Annotated[
    str,
    typer.Option("--partition", metavar="N/PARTS", help="Partition, where several machines share the directory."),
]

MaxTasksPerWorker = Annotated[
    int,
    typer.Option(
        "--max-tasks-per-worker", metavar="N", min=1, help="Number of samples after which a worker process restarts."
    ),
]

Extend = Annotated[bool, flag("--extend", help="Permission for more samples than an existing data set has.")]

CardDate = Annotated[
    str,
    option("--date", metavar="DATE", help="Date of publication, for example 2026-11-23; default: that of the recipe."),
]

CardVersion = Annotated[str, typer.Option("--version", metavar="VERSION", help="Version of the data set.")]

CardUrl = Annotated[
    str, option("--url", metavar="URL", help="Address of the published data set; default: that of the recipe.")
]

TruthMaps = Annotated[
    list[str] | None, repeatable("--map", "NAME", "Map of the ground truth; default: depth and velocity.")
]

SamplesPerShard = Annotated[
    int, option("--samples-per-shard", metavar="N", min=1, help="Number of samples in a tar file.")
]


def add_command(app: typer.Typer, function: Callable[..., None], name: str | None = None) -> None:
    """Add a command with the common options --quiet and --verbose."""
    hints = get_type_hints(function, include_extras=True)
    given = inspect.signature(function)
    parameters = [each.replace(annotation=hints[each.name]) for each in given.parameters.values()]
    added = {"quiet": Quiet, "verbose": Verbose}
    parameters += [
        inspect.Parameter(each, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=annotation)
        for each, annotation in added.items()
    ]

    @functools.wraps(function)
    def command(*args: Any, quiet: bool, verbose: bool, **kwargs: Any) -> None:
        from scenetruth.cli.messages import set_verbosity

        set_verbosity(quiet=quiet, verbose=verbose)
        function(*args, **kwargs)

    command.__signature__ = given.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {**hints, **added}
    app.command(name)(command)


def parse_assignments(option: str, given: Iterable[str] | None) -> tuple[dict[str, Any], list[Problem]]:
    """Return the values of an option NAME=VALUE, parsed as YAML, and the problems of invalid assignments."""
    import yaml

    from scenetruth.errors import Problem

    values: dict[str, Any] = {}
    problems = []
    for text in given or ():
        name, sign, value = text.partition("=")
        if not sign or not name.isidentifier():
            problems.append(Problem(option, "must be NAME=VALUE", text))
        elif name in values:
            problems.append(Problem(option, f"{name} is given twice", text))
        else:
            try:
                values[name] = yaml.safe_load(value)
            except yaml.YAMLError:
                problems.append(Problem(option, "must have a value in YAML", text))
    return values, problems


def read_settings(given: Iterable[str] | None) -> dict[str, Any]:
    """Return the settings of the option --setting."""
    from scenetruth.errors import EstimateError

    settings, problems = parse_assignments("--setting", given)
    if problems:
        raise EstimateError(problems)
    return settings


def with_settings(methods: Iterable[str], settings: Iterable[str] | None) -> list[MethodSpec]:
    """Return methods of the form NAME or LABEL=NAME[...], each with further settings NAME=VALUE."""
    from scenetruth.estimators.method_specs import MethodSpec, parse_methods

    given, added = list(methods), read_settings(settings)
    specs = parse_methods(given) if given else []
    if not added:
        return specs
    return [
        # A label that consists of name and settings is rebuilt.
        MethodSpec(spec.method, {**spec.settings, **added}, "" if spec.label == spec.spelled else spec.label)
        for spec in specs
    ]


def choose_band(scene: Scene, band: str | None) -> Scene:
    """Return a scene in the band of ``--band``, or as it is; raise an error that lists the bands of the camera."""
    from scenetruth.errors import ArgumentError, Problem

    if band is None:
        return scene
    if band not in scene.camera.bands:
        names = ", ".join(scene.camera.bands) or "none: it is grey"
        raise ArgumentError([Problem("--band", f"is not one of the bands of the camera ({names})", band)])
    return scene.in_band(band)
