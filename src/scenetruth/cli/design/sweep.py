"""The command that simulates scenes over whatever varies: design sweep."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli import options
from scenetruth.cli.completion import files_on
from scenetruth.cli.shipped import SCENES, find

if TYPE_CHECKING:
    from scenetruth.design.sweep import Sweep

__all__ = ["sweep"]


def sweep(
    scenes: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCENE...",
            help="Scene files (YAML), or names of `scenetruth scenes`.",
            show_default=False,
            callback=lambda given: [find(SCENES, one) for one in given],
            autocompletion=files_on(SCENES),
        ),
    ],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="PATH=VALUES",
            help="A field and its values: 1,2,5; 1..10:4, four of them; 1..10:4log; 1..10 and 1..10:log with --sobol. "
            "May be repeated: all combinations are made.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the sweep; goes on where it was.", show_default=False),
    ] = None,
    *,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="Methods: NAME, MODULE:FUNCTION, NAME\\[setting: value, ...], LABEL=NAME\\[...]; may be repeated. "
            "Each scene's own if not given.",
            show_default=False,
        ),
    ] = None,
    seeds: Annotated[
        str, typer.Option("--seeds", metavar="NUMBER", help="How many seeds each point has; or a list, as 1,2,3.")
    ] = "3",
    sobol: Annotated[
        int, typer.Option("--sobol", min=0, metavar="NUMBER", help="Points that fill the ranges without a number.")
    ] = 0,
    overrides: options.Overrides = None,
    workers: Annotated[int, typer.Option("--workers", min=0, max=1024, help="Processes; 0 for this one.")] = 2,
    limits: options.Limits = None,
) -> None:
    """Simulate, estimate and score scenes over whatever varies; with plots, error bars and the bound of noise."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.sweep import sweep as make_sweep
    from scenetruth.design.sweep.factors import split_assignments
    from scenetruth.design.sweep.problems import SweepError
    from scenetruth.errors import Problem
    from scenetruth.resources.bounds import limits_from

    varied, problems = split_assignments(vary or ())
    if output is None:
        problems.append(Problem("--output", "is missing: the folder where results go"))
    counted: int | list[int] = 0
    try:
        numbers = [int(one) for one in seeds.split(",")]
        counted = numbers if "," in seeds else numbers[0]
    except ValueError:
        problems.append(Problem("--seeds", "must be a number of seeds, or a list of them as 1,2,3", seeds))
    if problems or output is None:
        raise SweepError(problems)
    with reporting() as reporter:
        found = make_sweep(
            scenes,
            varied,
            methods or None,
            output,
            seeds=counted,
            sobol=sobol,
            overrides=overrides or (),
            workers=workers,
            limits=limits_from(limits or ()),
            progress=reporter,
            notice=lambda line: print(line, file=sys.stderr),
        )
    _print_best(found)
    typer.echo(f"written: {', '.join(str(output / name) for name in ('index.html', 'results.parquet', 'results.csv'))}")
    typer.echo(f"pictures: {output / 'plots'}")
    if found.failures:
        raise typer.Exit(1)


def _print_best(found: Sweep) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console
    from scenetruth.design.sweep.factors import label_of
    from scenetruth.design.sweep.page.panels import main_region, shown_quantities
    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import title_of

    region = main_region(found)
    table = Table(title=f"least rms error of each quantity, region {region}", title_justify="left")
    for heading in ("quantity", "rms", "95 %", "unit", "at", "method"):
        table.add_column(heading, overflow="fold")
    for quantity in shown_quantities(found):
        try:
            best = found.best(quantity, region=region)
        except KeyError:
            continue
        at = ", ".join(f"{path} = {label_of(value)}" for path, value in best.values.items())
        scene = f"{best.scene}: " if len(found.scenes) > 1 else ""
        interval = f"{best.low:.3g} to {best.high:.3g}" if best.low == best.low else "–"
        cells = (title_of(quantity), f"{best.number:.3g}", interval, best.unit, scene + at, best.method)
        table.add_row(*(visible(cell, lines=False) for cell in cells))
    console().print(table)
    for line in (*found.notes, *found.failures):
        typer.echo(visible(line, lines=False), err=True)
