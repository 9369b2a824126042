"""The command that tells which error comes from where: design budget."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli import options

if TYPE_CHECKING:
    from scenetruth.design.budget import Budget

__all__ = ["budget"]


class Known(StrEnum):
    """How well the calibration is known."""

    typical = "typical"
    perfect = "perfect"


def budget(
    scene: options.SceneFile,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the budget; goes on where it was.", show_default=False),
    ] = None,
    *,
    overrides: options.Overrides = None,
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="Method of estimation; the scene's if not given."),
    ] = None,
    calibration: Annotated[
        Known, typer.Option("--calibration", help="How well focal length, principal point and baseline are known.")
    ] = Known.typical,
    focal_length_percent: Annotated[
        float | None, typer.Option("--focal-length-percent", help="Standard deviation of the focal length, in %.")
    ] = None,
    principal_point_px: Annotated[
        float | None, typer.Option("--principal-point-px", help="Of the principal point, along x and y, in px.")
    ] = None,
    baseline_percent: Annotated[
        float | None, typer.Option("--baseline-percent", help="Of the scale of the stage's positions, in %.")
    ] = None,
    draws: Annotated[int, typer.Option("--draws", min=1, max=1000, help="Seeds that are simulated.")] = 4,
    confirm: Annotated[
        float,
        typer.Option("--confirm", min=0, max=1, help="Share of the sum of squares that is simulated; 1 for all."),
    ] = 0.9,
    region: Annotated[
        str, typer.Option("--region", help="Where figures are told for: interior, all, object_NAME.")
    ] = "interior",
    workers: Annotated[int, typer.Option("--workers", min=0, max=1024, help="Processes; 0 for this one.")] = 2,
) -> None:
    """Tell which error of depth, motion and growth comes from where, and what helps most."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.budget import budget as make_budget
    from scenetruth.design.budget.calibration import calibration_of
    from scenetruth.errors import Problem, RecipeError
    from scenetruth.scene import load_scene

    told = {
        "focal_length_percent": focal_length_percent,
        "principal_point_px": principal_point_px,
        "baseline_percent": baseline_percent,
    }
    given = {name: value for name, value in told.items() if value is not None}
    known = calibration_of({**calibration_of(calibration.value).model_dump(), **given})
    loaded = load_scene(scene, overrides or ())
    with reporting() as reporter:
        found = make_budget(
            loaded,
            output,
            method=method,
            calibration=known,
            draws=draws,
            confirm=confirm,
            region=region,
            workers=workers,
            progress=reporter,
            notice=lambda line: print(line, file=sys.stderr),
        )
    if region not in found.regions:
        problem = Problem("--region", f"must be one of {', '.join(found.regions)}", region)
        raise RecipeError([problem], source="an error budget")
    _print(found, region)
    if output is not None:
        names = ("index.html", "waterfall.png", "budget.csv")
        typer.echo(f"written: {', '.join(str(output / name) for name in names)}")
    if found.failures:
        raise typer.Exit(1)


def _print(found: Budget, region: str) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console
    from scenetruth.design.budget.answer.waterfall import DRAWN
    from scenetruth.design.budget.answer.words import number, unit_words
    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import title_of

    for quantity in (one for one in DRAWN if found.of(one, region)):
        total = found.total(quantity, region)
        heading = f"{title_of(quantity)}, {unit_words(total.unit)}, {region}"
        table = Table(title=visible(heading, lines=False), title_justify="left")
        table.add_column("cause")
        table.add_column("size", overflow="fold")
        for name in ("part", "predicted", "simulated"):
            table.add_column(name, justify="right")
        for one in found.of(quantity, region):
            cells = (one.title, one.size, number(one.figure), number(one.predicted), number(one.simulated))
            table.add_row(*(visible(cell, lines=False) for cell in cells))
        table.add_row("root of the sum of squares", "", number(total.parts), "", "")
        table.add_row("everything on", "", "", "", number(total.simulated))
        console().print(table)
    for line in (*found.words(region), *found.failures):
        typer.echo(visible(line))
