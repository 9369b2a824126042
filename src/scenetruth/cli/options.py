"""Arguments and options that commands share, names of bundled files, and shell completion."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

if TYPE_CHECKING:
    from scenetruth.errors import Problem
    from scenetruth.estimators.method_specs import MethodSpec

__all__ = [
    "DESIGNS",
    "RECIPES",
    "SCENES",
    "AllowMismatch",
    "BaselinePercent",
    "BenchmarkMethods",
    "BundledFiles",
    "Calibration",
    "CalibrationPreset",
    "CardDate",
    "CardUrl",
    "CardVersion",
    "Cases",
    "Command",
    "CommandImages",
    "CommandKeep",
    "CommandMemoryMb",
    "CommandName",
    "CommandTimeoutS",
    "CommandUsesMask",
    "Contrast",
    "Coverage",
    "DatasetPath",
    "DesignFile",
    "Divergence",
    "DivergenceOption",
    "DotMm",
    "DotPx",
    "Encoding",
    "EstimatedMethods",
    "ExchangeFormat",
    "ExportSource",
    "ExportedMethod",
    "Extend",
    "ExternalResults",
    "FigureFormat",
    "FigureFormats",
    "Figures",
    "Flow",
    "FocalLengthPercent",
    "FocalLengthPx",
    "Format",
    "FormatOptions",
    "ImageFormat",
    "Json",
    "LabelledCommands",
    "LabelledMethods",
    "Left",
    "Levels",
    "Light",
    "Limits",
    "ListKind",
    "Listed",
    "MarginMm",
    "MaxTasksPerWorker",
    "Mesh",
    "MeshDistanceMm",
    "Method",
    "Methods",
    "MmPerPx",
    "Model",
    "OpenGLPlatform",
    "OptionalOutput",
    "OptionalSceneFile",
    "Output",
    "Overrides",
    "Overwrite",
    "Page",
    "PartOf",
    "PatternType",
    "PatternTypeOption",
    "PhotographEncoding",
    "Platform",
    "PredictionModel",
    "PrincipalPointPx",
    "Quiet",
    "RecipeFile",
    "ReferenceImages",
    "Regenerate",
    "Region",
    "Report",
    "ResultPath",
    "Retries",
    "Row",
    "RunPath",
    "Runs",
    "SampleNumber",
    "Samples",
    "SaveImages",
    "SaveRadiance",
    "SceneFile",
    "SceneFiles",
    "SceneSeed",
    "Scheduler",
    "SchemaFile",
    "SchemaKind",
    "SchemaOf",
    "Seed",
    "SeedCount",
    "Seeds",
    "SensorPresets",
    "Settings",
    "SimulatedShare",
    "SizeMm",
    "SobolPoints",
    "Spacing",
    "Suite",
    "SuiteName",
    "SurfaceDistanceMm",
    "TemplateFile",
    "TemplateType",
    "Texture",
    "Threads",
    "TruthContent",
    "TruthContentChoice",
    "TruthPoses",
    "TruthPosesChoice",
    "TruthViews",
    "TruthViewsChoice",
    "Type",
    "UnitMm",
    "Vary",
    "Verbose",
    "WavelengthMm",
    "WavelengthPx",
    "WindowSigmaPx",
    "Workers",
    "WriteRecordings",
    "add_command",
    "file_completer",
    "helpers",
    "method_names",
    "parse_assignments",
    "parse_seeds",
    "read_settings",
    "resolve_file",
    "with_settings",
]


_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class BundledFiles:
    """One sort of files that are shipped.

    Parameters
    ----------
    noun
        What each of them is.
    metavar
        What the command line calls one.
    command
        What is done with one most often.
    folder
        Where they are, inside the folder of all.
    takes_folders
        Whether a folder is a path of its own, and not merely the results of an earlier run that has a file's name.
    """

    noun: str
    metavar: str
    command: str
    folder: str = "."
    takes_folders: bool = False

    def files(self) -> dict[str, Path]:
        """Return the files by their names, in order; none where nothing is shipped."""
        from scenetruth.input_files import bundled_files

        return bundled_files(self.folder)

    def call(self, name: str) -> str:
        """Return the command for one of them."""
        return f"scenetruth {self.command} {name} -o DIR"


SCENES = BundledFiles("scene", "SCENE", "run")
"""Scenes."""
RECIPES = BundledFiles("recipe", "RECIPE", "dataset run", "datasets", takes_folders=True)
"""Recipes of data sets; a command that takes one takes the folder of a data set too."""
DESIGNS = BundledFiles("design", "SPEC", "design optimise", "designs")
"""Design specifications."""


def resolve_file(shelf: BundledFiles, given: Path) -> Path:
    """Return the file that is meant on the command line: a path if there is such a file, else what is shipped.

    Parameters
    ----------
    shelf
        What is looked for.
    given
        A path, or the name of a file that is shipped.

    Returns
    -------
    pathlib.Path
        The file. A path to nothing is returned as it is: whoever reads it says so.

    Raises
    ------
    SceneError, RecipeError, DesignSpecError
        If a plain name is neither a file nor shipped; with the names that are near it.
    """
    exists = os.path.exists(given) if shelf.takes_folders else os.path.exists(given) and not os.path.isdir(given)
    if exists or not given.name:
        return given
    bundled = shelf.files()
    if given.suffix not in _SUFFIXES and str(given) == given.name:
        if given.name in bundled:
            return bundled[given.name]
        if not os.path.isdir(given):
            raise _refused(shelf, _unknown(shelf, given.name, list(bundled)), given)
    elif given.suffix in _SUFFIXES and given.stem in bundled:
        raise _refused(shelf, f"no such file; use the bundled {shelf.noun} by name: {given.stem}", given)
    elif given.suffix in _SUFFIXES and (other := _other_category(shelf, given.stem)) is not None:
        message = f"no such file; '{given.stem}' is a bundled {other.noun}: {other.call(given.stem)}"
        raise _refused(shelf, message, given)
    return given


def _unknown(shelf: BundledFiles, name: str, bundled: list[str]) -> str:
    from difflib import get_close_matches

    message = f"no such file, and no bundled {shelf.noun} of this name"
    if (other := _other_category(shelf, name)) is not None:
        message += f"; '{name}' is a bundled {other.noun}: `{other.call(name)}`"
    near = [f"'{match}'" for match in get_close_matches(name.lower(), bundled, n=3)]
    question = f"; did you mean the {shelf.noun} {' or '.join(near)}?" if near else ";"
    return f"{message}{question} `scenetruth list {shelf.noun}s` lists all"


def _other_category(shelf: BundledFiles, name: str) -> BundledFiles | None:
    """Return where else a name is shipped, if not on a shelf itself."""
    return next((other for other in (SCENES, RECIPES, DESIGNS) if other is not shelf and name in other.files()), None)


def _refused(shelf: BundledFiles, message: str, given: Path) -> Exception:
    from scenetruth.errors import Problem, RecipeError, SceneError

    kind: type[SceneError | RecipeError] = SceneError if shelf is SCENES else RecipeError
    if shelf is DESIGNS:
        from scenetruth.design.optimisation.design_records import DesignSpecError

        kind = DesignSpecError
    return kind([Problem(shelf.metavar, message, str(given))])


_METHODS = Path(__file__).resolve().parents[1] / "estimators" / "methods"
_ENTRY_POINTS = "scenetruth.estimators"


def method_names(incomplete: str) -> list[str]:
    """Return the installed methods whose names begin so, as `scenetruth list methods` lists them; none is loaded."""
    import pkgutil
    from importlib import metadata

    own = [module.name for module in pkgutil.iter_modules([str(_METHODS)])]
    offered = [point.name for point in metadata.entry_points(group=_ENTRY_POINTS)]
    return _beginning(incomplete, [*own, *offered])


def file_completer(shelf: BundledFiles) -> Callable[[str], list[str]]:
    """Return what completes the argument that takes a file, or the name of a shipped one.

    Where nothing is found, shells complete paths themselves, folders among them.
    """

    def complete(incomplete: str) -> list[str]:
        folder = Path(incomplete).parent if "/" in incomplete else Path()
        start = incomplete.rpartition("/")[0] + "/" if "/" in incomplete else ""
        try:
            here = [start + file.name for file in folder.iterdir() if file.suffix in (".yaml", ".yml")]
        except OSError:
            here = []
        return _beginning(incomplete, [*shelf.files(), *here])

    return complete


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(incomplete)})


def helpers() -> int:
    """Return how many further processes a command may take: one, if there is a processor for it."""
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
    """Types of printed patterns."""

    speckle = "speckle"
    noise = "noise"
    grey_noise = "grey_noise"


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


class TemplateType(StrEnum):
    """Scene templates."""

    cube = "cube"
    leaf = "leaf"
    mesh = "mesh"


class ListKind(StrEnum):
    """What `scenetruth list` lists."""

    scenes = "scenes"
    recipes = "recipes"
    designs = "designs"
    methods = "methods"
    formats = "formats"
    cases = "cases"


class SchemaKind(StrEnum):
    """File types with a JSON Schema."""

    scene = "scene"
    recipe = "recipe"
    design = "design"


def _name_required(path: Path | None) -> Path | None:
    if path is not None and path.name in ("", ".."):
        msg = "must name a directory to create; '.', '..' and '/' exist already"
        raise typer.BadParameter(msg)
    return path


def _flag(*names: str, help: str) -> Any:
    return typer.Option(*names, help=help, show_default=False)


def _option(*names: str, help: str, **more: Any) -> Any:
    """Return an option without a default that could be shown."""
    return typer.Option(*names, help=help, show_default=False, **more)


def _repeatable(name: str, metavar: str, help: str, **more: Any) -> Any:
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
Output = Annotated[Path, _option("--output", "-o", metavar="DIR", help="Output directory.", callback=_name_required)]
OptionalOutput = Annotated[
    Path | None,
    _option(
        "--output",
        "-o",
        metavar="DIR",
        help="Output directory; nothing is written without it.",
        callback=_name_required,
    ),
]
Overwrite = Annotated[bool, _flag("--overwrite", help="Replacement of existing results.")]
AllowMismatch = Annotated[bool, _flag("--allow-mismatch", help="Acceptance of parts of different runs.")]
Overrides = Annotated[
    list[str] | None,
    _repeatable("--set", "PATH=VALUE", "Field of the scene, recipe or specification, with a value in YAML."),
]
Settings = Annotated[
    list[str] | None, _repeatable("--setting", "NAME=VALUE", "Setting of the method, with a value in YAML.")
]
FormatOptions = Annotated[
    list[str] | None,
    _repeatable("--option", "NAME=VALUE", "Option of the format (`scenetruth list formats`), with a value in YAML."),
]
Limits = Annotated[
    list[str] | None,
    _repeatable(
        "--limit",
        "NAME=VALUE",
        "Resource limit instead of its default: frames, images, pixels, samples, vertices, objects, leaves, texels, "
        "image_pixels, memory_gb, disk_gb, hours.",
    ),
]
Methods = Annotated[
    list[str] | None,
    _repeatable(
        "--method",
        "NAME",
        "Method (`scenetruth list methods`), or MODULE:FUNCTION; the method of the scene if not given.",
        autocompletion=method_names,
    ),
]
EstimatedMethods = Annotated[
    list[str] | None,
    _repeatable("--method", "NAME", "Method with an estimate; all if not given.", autocompletion=method_names),
]
LabelledMethods = Annotated[
    list[str] | None,
    _repeatable(
        "--method",
        "NAME",
        "Method: NAME, MODULE:FUNCTION, NAME\\[setting: value, ...], LABEL=NAME\\[...]; the method of each scene if "
        "not given.",
        autocompletion=method_names,
    ),
]
Method = Annotated[
    str | None,
    _option(
        "--method",
        metavar="NAME",
        help="Method (`scenetruth list methods`); the method of the scene if not given.",
        autocompletion=method_names,
    ),
]
ExportedMethod = Annotated[
    str | None,
    _option(
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
    _option("--scheduler", metavar="ADDRESS", help="Dask scheduler, for example tcp://HOST:8786, or its file."),
]
Retries = Annotated[
    int, typer.Option("--retries", metavar="N", min=0, max=100, help="Number of repetitions of a failed sample.")
]
SceneSeed = Annotated[
    int | None,
    _option("--seed", metavar="N", min=0, help="Seed of the scene or recipe; the value of the file if not given."),
]
Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the random numbers.")]
Seeds = Annotated[
    str, typer.Option("--seeds", metavar="N|LIST", help="Number of seeds, or a list of seeds, for example 1,2,3.")
]
SeedCount = Annotated[int, typer.Option("--seeds", metavar="N", min=1, max=1000, help="Number of simulated seeds.")]
Region = Annotated[
    str, typer.Option("--region", metavar="NAME", help="Region: interior, all, object_NAME, or another of the result.")
]
Json = Annotated[bool, _flag("--json", help="Machine-readable output (JSON).")]
Quiet = Annotated[bool, _flag("--quiet", "-q", help="Results, warnings and errors only.")]
Verbose = Annotated[bool, _flag("--verbose", "-v", help="Additional messages, with run times in s.")]

# Options of run, render, estimate and report.
SaveImages = Annotated[
    ImageFormat | None, _option("--save-images", help="Additional image files: 16-bit PNG, or TIFF of floats.")
]
SaveRadiance = Annotated[bool, _flag("--save-radiance", help="Additional linear images before the sensor.")]
TruthViews = Annotated[TruthViewsChoice, typer.Option("--truth-views", help="Cameras of the ground truth.")]
TruthPoses = Annotated[
    TruthPosesChoice, typer.Option("--truth-poses", help="Camera poses and times of the ground truth.")
]
TruthContent = Annotated[
    TruthContentChoice, typer.Option("--truth-content", help="Maps of the ground truth: those that are scored, or all.")
]
Report = Annotated[bool, typer.Option("--report/--no-report", help="Figures and report.")]
Figures = Annotated[
    list[str] | None,
    _repeatable("--figure", "NAME", "Figure of the report, for example depth or velocity_z; all if not given."),
]
FigureFormats = Annotated[
    FigureFormat, typer.Option("--figure-format", help="File format of figures; pdf is written in addition to png.")
]
Command = Annotated[
    str | None,
    _option(
        "--command",
        metavar="WORDS",
        help="External program as a method: 'python mine.py {recording} {output}'.",
    ),
]
LabelledCommands = Annotated[
    list[str] | None,
    _repeatable(
        "--command", "LABEL=WORDS", "External program as a method: 'mine=python mine.py {recording} {output}'."
    ),
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
    _option("--command-memory-mb", metavar="MB", help="Limit of the resident memory of the external program, in MB."),
]
CommandUsesMask = Annotated[
    bool, _flag("--command-uses-mask", help="Declaration that the external program uses exclusion masks.")
]
CommandKeep = Annotated[
    Path | None,
    _option("--command-keep", metavar="DIR", help="Directory for the input and output files of the external program."),
]

# Options of export and verify.
Format = Annotated[str, _option("--format", metavar="NAME", help="Export format (`scenetruth list formats`).")]
Left = Annotated[int | None, _option("--left", metavar="S", help="Left camera of a stereo pair, by its index s.")]
Flow = Annotated[
    str | None,
    _option(
        "--flow",
        metavar="TYPE",
        help="Motion: finite is the displacement to the next image, instantaneous the image velocity.",
    ),
]
Row = Annotated[int | None, _option("--row", metavar="N", help="Row of a camera grid, by its index s_y.")]
Regenerate = Annotated[
    int,
    typer.Option(
        "--regenerate", metavar="N", min=0, help="Number of data-set samples that are generated again and compared."
    ),
]

# Options of init.
Type = Annotated[
    TemplateType | None, _option("--type", help="Scene template; mesh with --mesh, otherwise cube if not given.")
]
Mesh = Annotated[Path | None, _option("--mesh", metavar="FILE", help="Mesh file: OBJ, PLY, GLB, STL, OFF.")]
Texture = Annotated[
    Path | None, _option("--texture", metavar="FILE", help="Image file on the cube, or on a mesh with UV coordinates.")
]
UnitMm = Annotated[
    float | None, typer.Option("--unit-mm", metavar="MM", help="Length unit of the mesh, in mm.", show_default="1.0")
]
MeshDistanceMm = Annotated[
    float | None,
    _option(
        "--distance-mm",
        metavar="MM",
        help="Distance of the nearest mesh point, in mm; ten times the size of the mesh if not given.",
    ),
]
SchemaFile = Annotated[
    Path | None,
    _option(
        "--schema",
        metavar="FILE",
        help="JSON Schema for editors, from `scenetruth schema > FILE`; scene.schema.json in the same directory if not "
        "given.",
    ),
]

# Options of data sets.
Samples = Annotated[
    int | None,
    _option(
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
Extend = Annotated[bool, _flag("--extend", help="Permission for more samples than an existing data set has.")]
CardDate = Annotated[str, _option("--date", metavar="DATE", help="Date of publication, for example 2026-11-23.")]
CardVersion = Annotated[str, typer.Option("--version", metavar="VERSION", help="Version of the data set.")]
CardUrl = Annotated[str, _option("--url", metavar="URL", help="Address of the published data set.")]

# Options of compare.
Suite = Annotated[SuiteName, typer.Option("--suite", help="Suite: core is short, full has all levels.")]
Cases = Annotated[list[str] | None, _repeatable("--case", "NAME", "Benchmark case; all of the suite if not given.")]
Levels = Annotated[
    list[str] | None,
    _repeatable("--level", "VALUE", "Level of a single case, a number or a label; all if not given."),
]
ExternalResults = Annotated[
    list[str] | None,
    _repeatable("--results", "LABEL=DIR", "Directory of external results for the recordings of --write-recordings."),
]
WriteRecordings = Annotated[
    bool, _flag("--write-recordings", help="Recordings of the suite in the output directory, without any estimation.")
]

# Options of design.
Calibration = Annotated[CalibrationPreset, typer.Option("--calibration", help="Preset of the calibration uncertainty.")]
FocalLengthPercent = Annotated[
    float | None,
    _option("--focal-length-percent", metavar="PERCENT", help="Standard uncertainty of the focal length, in %."),
]
PrincipalPointPx = Annotated[
    float | None,
    _option("--principal-point-px", metavar="PX", help="Standard uncertainty of the principal point per axis, in px."),
]
BaselinePercent = Annotated[
    float | None,
    _option("--baseline-percent", metavar="PERCENT", help="Standard uncertainty of the stage scale, in %."),
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
    _repeatable(
        "--vary",
        "PATH=VALUES",
        "Factor and its levels: 1,2,5; 1..10:4 for four levels; 1..10:4log; 1..10 or 1..10:log with --sobol-points.",
    ),
]
SobolPoints = Annotated[
    int, typer.Option("--sobol-points", metavar="N", min=0, help="Number of design points of a Sobol sequence.")
]
FocalLengthPx = Annotated[
    float | None, _option("--focal-length-px", metavar="PX", help="Focal length of a rig without a scene, in px.")
]
SurfaceDistanceMm = Annotated[
    float | None,
    _option(
        "--distance-mm",
        metavar="MM",
        help="Distance of the surface, in mm; the median depth of the scene if not given.",
    ),
]
Light = Annotated[float, typer.Option("--light", metavar="VALUE", help="Radiance of a white surface, 1 is full scale.")]
PatternTypeOption = Annotated[PatternType, typer.Option("--type", help="Type of the pattern.")]
SizeMm = Annotated[
    str | None, _option("--size-mm", metavar="WxH", help="Size of the sheet, in mm; 1.1 fields of view if not given.")
]
DotPx = Annotated[
    float | None, _option("--dot-px", metavar="PX", help="Dot diameter on the sensor, in px; 4 if not given.")
]
DotMm = Annotated[float | None, _option("--dot-mm", metavar="MM", help="Dot diameter on the surface, in mm.")]
Coverage = Annotated[
    float | None, _option("--coverage", metavar="SHARE", help="Fraction of the area with ink; 0.5 if not given.")
]
Spacing = Annotated[
    float | None,
    _option(
        "--spacing",
        metavar="VALUE",
        help="Minimum distance of dot centres, in diameters; 1 (no overlap) if not given.",
    ),
]
WavelengthPx = Annotated[
    str | None,
    _option("--wavelength-px", metavar="MIN,MAX", help="Wavelength band on the sensor, in px; 5,20 if not given."),
]
WavelengthMm = Annotated[
    str | None, _option("--wavelength-mm", metavar="MIN,MAX", help="Wavelength band on the surface, in mm.")
]
Contrast = Annotated[
    float | None,
    _option("--contrast", metavar="VALUE", help="Contrast of grey noise: standard deviation over range."),
]
Page = Annotated[str, typer.Option("--page", metavar="SIZE", help="Page: A5 to A0, letter, or WIDTHxHEIGHT in mm.")]
MarginMm = Annotated[float, typer.Option("--margin-mm", metavar="MM", help="Unprinted margin of the page, in mm.")]
ReferenceImages = Annotated[
    list[Path] | None, _repeatable("--reference-image", "IMAGE", "Photograph of a pattern for comparison.")
]
MmPerPx = Annotated[
    float | None,
    _option(
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
    _option("--runs", metavar="N", min=1, help="Simulations per point; 8 without and 60 with noise if not given."),
]
SensorPresets = Annotated[list[str] | None, _repeatable("--preset", "NAME", "Sensor preset; all if not given.")]
Platform = Annotated[OpenGLPlatform, typer.Option("--platform", help="OpenGL platform of pyrender.")]


def add_command(app: typer.Typer, function: Callable[..., None], name: str | None = None) -> None:
    """Add a command with the options that every command has: --quiet and --verbose.

    Parameters
    ----------
    app
        The command line, or a group of commands.
    function
        The command.
    name
        Its name; that of the function if not given.
    """
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
    """Return the values of an option NAME=VALUE, each read as YAML, and every assignment that is spelled wrongly."""
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
    """Return the settings of a method that the option --setting gives.

    Raises
    ------
    EstimateError
        With every setting that is spelled wrongly.
    """
    from scenetruth.errors import EstimateError

    settings, problems = parse_assignments("--setting", given)
    if problems:
        raise EstimateError(problems)
    return settings


def with_settings(methods: Iterable[str], settings: Iterable[str] | None) -> list[MethodSpec]:
    """Return methods of the form NAME or LABEL=NAME[...], each with further settings NAME=VALUE.

    Raises
    ------
    EstimateError
        With every setting or method that is spelled wrongly.
    """
    from scenetruth.estimators.method_specs import MethodSpec, parse_methods

    given, added = list(methods), read_settings(settings)
    specs = parse_methods(given) if given else []
    if not added:
        return specs
    return [
        # A label that consists of the name and the settings is made anew.
        MethodSpec(spec.method, {**spec.settings, **added}, "" if spec.label == spec.spelled else spec.label)
        for spec in specs
    ]


def parse_seeds(given: str, problems: list[Problem]) -> int | list[int]:
    """Return a number of seeds, or a list of seeds that are separated by commas; add a problem if it is neither."""
    from scenetruth.errors import Problem

    try:
        numbers = [int(text) for text in given.split(",")]
    except ValueError:
        problems.append(Problem("--seeds", "must be a number of seeds, or a list of them as 1,2,3", given))
        return 0
    return numbers if "," in given else numbers[0]
