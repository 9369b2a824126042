"""Arguments and options that several commands share."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from scenetruth.cli.completion import files_on, method_names
from scenetruth.cli.shipped import SCENES, find

__all__ = [
    "AllowMismatch",
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
    "SharedForm",
    "TimeoutS",
    "Truth",
    "TruthContent",
    "TruthPoses",
    "TruthViews",
    "helpers",
]


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
        callback=lambda given: find(SCENES, given),
        autocompletion=files_on(SCENES),
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
