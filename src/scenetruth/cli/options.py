"""Arguments and options that commands share, names of bundled files, and shell completion."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "GOALS",
    "RECIPES",
    "SCENES",
    "AllowMismatch",
    "BundledFiles",
    "Command",
    "CommandImages",
    "CommandName",
    "Content",
    "FigureForm",
    "Figures",
    "FiguresFormat",
    "Folder",
    "Ideal",
    "ImageForm",
    "Images",
    "KeepIn",
    "Limits",
    "MemoryMb",
    "Methods",
    "Output",
    "Overrides",
    "Overwrite",
    "Poses",
    "ReadsMasks",
    "Report",
    "Results",
    "SceneFile",
    "Scheduler",
    "SharedForm",
    "TimeoutS",
    "Truth",
    "TruthContent",
    "TruthPoses",
    "TruthViews",
    "Workers",
    "file_completer",
    "helpers",
    "method_names",
    "resolve_file",
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
        return f"scenetruth {self.command} {name} -o FOLDER"


SCENES = BundledFiles("scene", "SCENE", "run")
"""Scenes."""
RECIPES = BundledFiles("recipe", "RECIPE", "dataset run", "datasets", takes_folders=True)
"""Recipes of data sets; a command that takes one takes the folder of a data set too."""
GOALS = BundledFiles("goal", "GOAL", "design optimise", "goals")
"""Goals of a search for a rig."""


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
    SceneError, RecipeError, GoalError
        If a plain name is neither a file nor shipped; with the names that are near it.
    """
    there = os.path.exists(given) if shelf.takes_folders else os.path.exists(given) and not os.path.isdir(given)
    if there or not given.name:
        return given
    shipped = shelf.files()
    if given.suffix not in _SUFFIXES and str(given) == given.name:
        if given.name in shipped:
            return shipped[given.name]
        if not os.path.isdir(given):
            raise _refused(shelf, _unknown(shelf, given.name, list(shipped)), given)
    elif given.suffix in _SUFFIXES and given.stem in shipped:
        message = f"no such file; a {shelf.noun} of this name is shipped, and called without folder and suffix: "
        message += given.stem
        raise _refused(shelf, message, given)
    elif given.suffix in _SUFFIXES and (other := _other_category(shelf, given.stem)) is not None:
        message = f"no such file; a {other.noun} of this name is shipped: {other.call(given.stem)}"
        raise _refused(shelf, message, given)
    return given


def _unknown(shelf: BundledFiles, name: str, shipped: list[str]) -> str:
    from difflib import get_close_matches

    near = [f"'{one}'" for one in get_close_matches(name.lower(), shipped, n=3)]
    if (other := _other_category(shelf, name)) is not None:
        question = f"; or did you mean the {shelf.noun} {' or '.join(near)}?" if near else ";"
        told = f"'{name}' is a {other.noun}, called by `{other.call(name)}`"
        return f"no such file, and no {shelf.noun} of this name: {told}{question} `scenetruth scenes` lists all"
    question = f"; did you mean {' or '.join(near)}?" if near else ";"
    return f"no such file, and no {shelf.noun} of this name is shipped{question} `scenetruth scenes` lists all"


def _other_category(shelf: BundledFiles, name: str) -> BundledFiles | None:
    """Return where else a name is shipped, if not on a shelf itself."""
    return next((other for other in (SCENES, RECIPES, GOALS) if other is not shelf and name in other.files()), None)


def _refused(shelf: BundledFiles, message: str, given: Path) -> Exception:
    from scenetruth.errors import Problem, RecipeError, SceneError

    kind: type[SceneError | RecipeError] = SceneError if shelf is SCENES else RecipeError
    if shelf is GOALS:
        from scenetruth.design.optimisation.design_records import DesignSpecError

        kind = DesignSpecError
    return kind([Problem(shelf.metavar, message, str(given))])


_METHODS = Path(__file__).resolve().parents[1] / "estimators" / "methods"
_ENTRY_POINTS = "scenetruth.estimators"


def method_names(incomplete: str) -> list[str]:
    """Return the installed methods whose names begin so, as `scenetruth methods` lists them; none is loaded."""
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


class FigureForm(StrEnum):
    """File formats of the figures of a report."""

    png = "png"
    pdf = "pdf"


class ImageForm(StrEnum):
    """File formats of images."""

    png = "png"
    tiff = "tiff"


class SharedForm(StrEnum):
    """Forms of the images that commands are given."""

    png = "png"
    tiff = "tiff"
    npy = "npy"


class TruthViews(StrEnum):
    """Cameras that a truth is made for."""

    reference = "reference"
    all = "all"


class TruthPoses(StrEnum):
    """Poses and times that a truth is made for."""

    real = "real"
    nominal = "nominal"


class TruthContent(StrEnum):
    """Maps that a truth holds."""

    standard = "standard"
    complete = "complete"


SceneFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCENE",
        help="Scene file (YAML), or a name of `scenetruth scenes`.",
        show_default=False,
        callback=lambda given: resolve_file(SCENES, given),
        autocompletion=file_completer(SCENES),
    ),
]
Results = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder of a run, or a store in it.", show_default=False)
]
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with the stores of a run.", show_default=False)]


def _with_a_name(path: Path) -> Path:
    if path.name in ("", ".."):
        msg = "must name a folder to make; '.', '..' and '/' are there already"
        raise typer.BadParameter(msg)
    return path


Output = Annotated[
    Path, typer.Option("--output", "-o", help="Folder to make.", show_default=False, callback=_with_a_name)
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="PATH=VALUE", help="Override a field of the scene; may be repeated.", show_default=False
    ),
]
Limits = Annotated[
    list[str] | None,
    typer.Option(
        "--limits",
        metavar="NAME=VALUE",
        help="Allow a scene more, or less, than it may ask for by default: frames, images, pixels, samples, vertices, "
        "objects, leaves, texels, image_pixels; memory_gb, disk_gb, hours. May be repeated.",
        show_default=False,
    ),
]
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="A method of estimation (see `scenetruth methods`), or module:function; may be repeated. The scene's if "
        "not given.",
        show_default=False,
        autocompletion=method_names,
    ),
]
Command = Annotated[
    str | None,
    typer.Option(
        "--command",
        metavar="WORDS",
        help="A program as a method: 'python mine.py {recording} {output}'; see docs/own_programs.md.",
        show_default=False,
    ),
]
CommandName = Annotated[str, typer.Option("--name", metavar="NAME", help="What the command's method is called.")]
CommandImages = Annotated[SharedForm, typer.Option("--command-images", help="How the command is given images.")]
TimeoutS = Annotated[float, typer.Option("--timeout-s", help="How long the command may run, in s.")]
MemoryMb = Annotated[
    float | None,
    typer.Option("--memory-mb", help="How much resident memory the command may have, in MB.", show_default=False),
]
ReadsMasks = Annotated[
    bool, typer.Option("--reads-masks", help="The command leaves out the pixels that masks mark.", show_default=False)
]
KeepIn = Annotated[
    Path | None,
    typer.Option("--keep-in", metavar="FOLDER", help="Keep what the command reads and writes.", show_default=False),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results that exist.")]
AllowMismatch = Annotated[bool, typer.Option("--allow-mismatch", help="Take parts of different runs together.")]
Images = Annotated[
    ImageForm | None,
    typer.Option("--images", help="Write the images as 16-bit PNG or float TIFF too.", show_default=False),
]
Truth = Annotated[TruthViews, typer.Option("--truth", help="Truth of the reference camera or of all cameras.")]
Poses = Annotated[
    TruthPoses,
    typer.Option("--truth-poses", help="Truth from where the camera stood, or from where it should have stood."),
]
Content = Annotated[
    TruthContent,
    typer.Option("--truth-content", help="What estimates are scored against, or everything known of the surface."),
]
Report = Annotated[bool, typer.Option("--report/--no-report", help="Draw the pictures and the report.")]
FiguresFormat = Annotated[
    FigureForm, typer.Option("--figures-format", help="pdf: the figures as vectors too, beside PNG.")
]
Figures = Annotated[
    list[str] | None,
    typer.Option(
        "--figures",
        metavar="NAME",
        help="A figure of the report, such as depth or velocity_z; may be repeated; all if not given.",
        show_default=False,
    ),
]
Ideal = Annotated[bool, typer.Option("--ideal", help="Keep the linear images before the sensor too.")]


def _check_workers(given: int) -> int:
    if given == 0:
        raise typer.BadParameter("must be 1 or more, or -1 for all processors (got 0)")
    return given


Workers = Annotated[
    int,
    typer.Option(
        "--workers",
        min=-1,
        max=1024,
        metavar="N",
        callback=_check_workers,
        help="Number of processes; 1 starts none, -1 uses all processors.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose workers are used instead: tcp://HOST:8786, or the path of its file.",
        show_default=False,
    ),
]
