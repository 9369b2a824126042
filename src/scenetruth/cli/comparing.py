"""The command that compares methods over the metrology suite: compare."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scenetruth.cli import options

if TYPE_CHECKING:
    from scenetruth.comparison import Comparison

__all__ = ["register"]


class SuiteName(StrEnum):
    """Suites of the comparison."""

    core = "core"
    full = "full"


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(compare)


def compare(
    methods: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="METHOD...",
            help="Methods: NAME, MODULE:FUNCTION, NAME\\[setting: value, ...], LABEL=NAME\\[...].",
            show_default=False,
        ),
    ] = None,
    suite: Annotated[SuiteName, typer.Option("--suite", help="For every day, or all of it.")] = SuiteName.core,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the comparison; goes on where it was.", show_default=False),
    ] = None,
    *,
    case: Annotated[
        list[str] | None,
        typer.Option("--case", metavar="NAME", help="Only this case; may be repeated.", show_default=False),
    ] = None,
    value: Annotated[
        list[str] | None,
        typer.Option(
            "--value",
            metavar="VALUE",
            help="Only this value of one case, a number or a label; may be repeated.",
            show_default=False,
        ),
    ] = None,
    command: Annotated[
        list[str] | None,
        typer.Option(
            "--command",
            metavar="LABEL=WORDS",
            help="A program as a method: 'mine=python mine.py {recording} {output}'; may be repeated.",
            show_default=False,
        ),
    ] = None,
    timeout_s: options.TimeoutS = 600.0,
    memory_mb: options.MemoryMb = None,
    results: Annotated[
        list[str] | None,
        typer.Option(
            "--results",
            metavar="LABEL=FOLDER",
            help="Results that were made elsewhere, of what --recordings has written; may be repeated.",
            show_default=False,
        ),
    ] = None,
    recordings: Annotated[
        Path | None,
        typer.Option("--recordings", metavar="FOLDER", help="Write all recordings here, and end.", show_default=False),
    ] = None,
    workers: Annotated[int, typer.Option("--workers", min=0, max=1024, help="Processes; 0 for this one.")] = 2,
    listed: Annotated[bool, typer.Option("--list", help="List the cases, and end.")] = False,
) -> None:
    """Compare methods over the metrology suite: noise, bias, limits, resolution, with the bound that noise sets."""
    from scenetruth.cli.console import reporting
    from scenetruth.comparison import compare as compare_methods
    from scenetruth.errors import EstimateError, Problem
    from scenetruth.estimators.external import CommandMethod, ResultsFolder

    if listed:
        _print_cases()
        return
    if recordings is not None:
        from scenetruth.comparison.offline import write_recordings

        with reporting() as reporter:
            written = write_recordings(
                recordings, suite.value, cases=case or None, values=value or None, progress=reporter
            )
        typer.echo(f"written: {len(written)} recordings in {recordings}")
        return
    chosen: list[Any] = [*(methods or ())]
    for label, words in _labelled("--command", command):
        chosen.append(CommandMethod(words, label, timeout_s=timeout_s, memory_mb=memory_mb))
    chosen += [ResultsFolder(folder, label) for label, folder in _labelled("--results", results)]
    problems = [] if chosen else [Problem("METHOD", "is missing; `scenetruth methods` lists what is installed")]
    problems += [] if output else [Problem("--output", "is missing: the folder where results go")]
    if problems or not output:
        raise EstimateError(problems)
    with reporting() as reporter:
        found = compare_methods(
            chosen,
            suite.value,
            output,
            cases=case or None,
            values=value or None,
            workers=workers,
            progress=reporter,
            notice=lambda line: print(line, file=sys.stderr),
        )
    _print_summary(found)
    made = ("index.html", "results.parquet", "results.csv", "summary.csv")
    typer.echo(f"written: {', '.join(str(output / name) for name in made)}")
    if found.failures:
        raise typer.Exit(1)


def _labelled(option: str, given: Sequence[str] | None) -> list[tuple[str, str]]:
    """Return what options of the form LABEL=REST say."""
    from scenetruth.errors import EstimateError, Problem

    pairs = [one.partition("=") for one in given or ()]
    problems = [
        Problem(option, "must be LABEL=..., a name before it", "".join(pair))
        for pair in pairs
        if not (pair[0] and pair[2])
    ]
    if problems:
        raise EstimateError(problems)
    return [(label.strip(), rest.strip()) for label, _, rest in pairs]


def _print_cases() -> None:
    from scenetruth.comparison.case import all_cases

    for case in all_cases().values():
        suite = "core" if case.core else "full"
        values = ", ".join(map(case.label_of, case.values(suite))) or case.lacks()
        alone = "" if case.core else "; suite full alone"
        typer.echo(f"{case.kind}: {case.question} ({case.varied}: {values}{alone})")


_BESIDE = 3


def _print_summary(found: Comparison) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from scenetruth.errors import visible

    frame = found.summary()
    labels = [visible(str(label), lines=False) for label in frame.columns]
    # So many fit beside each other into a terminal of 80 columns.
    for first in range(0, len(labels), _BESIDE):
        table = Table(title="median over the values of each case")
        table.add_column("case", max_width=30)
        for label in labels[first : first + _BESIDE]:
            table.add_column(escape(label), justify="right", overflow="fold", min_width=8)
        for name, cells in frame.iterrows():
            numbers = list(cells)[first : first + _BESIDE]
            table.add_row(escape(str(name)), *("–" if one != one else f"{one:.2g}" for one in numbers))
        Console().print(table)
    for line in found.slips:
        typer.echo(f"likely slip: {visible(line, lines=False)}", err=True)
    for line in found.failures:
        # Whatever a method says stands below, and cannot be taken for a line of ours.
        typer.echo("nothing told: " + visible(line).replace("\n", "\n    "), err=True)
