"""The command that finds the best rig for a goal: design optimise."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli.completion import files_on
from scenetruth.cli.shipped import GOALS, find

if TYPE_CHECKING:
    from scenetruth.design.optimise import Design

__all__ = ["optimise"]


def optimise(
    goal: Annotated[
        Path,
        typer.Argument(
            metavar="GOAL",
            help="Goal file (YAML), or a name of `scenetruth scenes`.",
            show_default=False,
            callback=lambda given: find(GOALS, given),
            autocompletion=files_on(GOALS),
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the answer; goes on where it was.", show_default=False),
    ] = None,
    *,
    workers: Annotated[int, typer.Option("--workers", min=0, max=1024, help="Processes; 0 for this one.")] = 2,
) -> None:
    """Find the rig that measures best within constraints, by thousands of predictions; simulate the best."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.optimise import load_goal
    from scenetruth.design.optimise import optimise as find_rig
    from scenetruth.design.optimise.answer.preview import PREVIEW
    from scenetruth.design.optimise.problems import GoalError
    from scenetruth.errors import Problem

    if output is None:
        raise GoalError([Problem("--output", "is missing: the folder where the answer goes")])
    wanted = load_goal(goal)
    with reporting() as reporter:
        found = find_rig(
            wanted,
            output,
            workers=workers,
            progress=reporter,
            notice=lambda line: print(line, file=sys.stderr),
        )
    _print_front(found)
    _say(*found.words())
    names = ("index.html", "recommended.yaml", PREVIEW, "front.csv", "screened.csv", "design.json")
    _say(f"a part of what it sees, before it is rendered whole: scenetruth run {output / PREVIEW} -o preview")
    _say(f"written: {', '.join(str(output / name) for name in names)}")


def _say(*lines: str) -> None:
    from scenetruth.errors import visible

    for line in lines:
        typer.echo(visible(line, lines=False))


def _print_front(found: Design) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console
    from scenetruth.design.optimise.words import told_value
    from scenetruth.errors import visible

    table = Table(title=f"{visible(found.title, lines=False)}: the best rigs", title_justify="left")
    names = list(found.recommended.parameters)
    headings = ["rig", *names]
    for objective in found.objectives:
        headings += [f"{objective.title}, {objective.unit}", "simulated", "95 %"]
    for heading in headings:
        table.add_column(visible(heading, lines=False), overflow="fold")
    for rig in found.rigs:
        mark = " *" if rig.number == found.recommended.number else ""
        cells = [f"{rig.number}{mark}", *(told_value(rig.parameters[name]) for name in names)]
        for objective in found.objectives:
            told = rig.simulated.get(objective.title)
            cells.append(f"{rig.predicted[objective.title]:.3g}")
            cells += ["–", "–"] if told is None else [f"{told.number:.3g}", f"{told.low:.3g} to {told.high:.3g}"]
        table.add_row(*(visible(cell, lines=False) for cell in cells))
    console().print(table)
