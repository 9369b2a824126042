"""Commands that run many simulated measurements: `compare` (benchmark of methods) and the validation studies."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scenetruth.cli import options

if TYPE_CHECKING:
    from scenetruth.benchmark import BenchmarkResult
    from scenetruth.validation_studies.rendering_accuracy import RenderingAccuracy

__all__ = ["register_compare", "register_validation"]


class SuiteName(StrEnum):
    """Suites of the comparison."""

    core = "core"
    full = "full"


def register_compare(app: typer.Typer) -> None:
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
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    listed: Annotated[bool, typer.Option("--list", help="List the cases, and end.")] = False,
) -> None:
    """Compare methods over the metrology suite: noise, bias, limits, resolution, with the bound that noise sets."""
    from scenetruth.benchmark import compare as compare_methods
    from scenetruth.cli.console import reporting
    from scenetruth.errors import EstimateError, Problem
    from scenetruth.estimators.external import CommandMethod, ResultsFolder
    from scenetruth.estimators.method_specs import parse_methods

    if listed:
        _print_cases()
        return
    if recordings is not None:
        from scenetruth.benchmark.suite import write_recordings

        with reporting() as reporter:
            written = write_recordings(
                recordings, suite.value, cases=case or None, levels=value or None, progress=reporter
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
            parse_methods(chosen),
            suite=suite.value,
            cases=case or None,
            levels=value or None,
            output=output,
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
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
    from scenetruth.benchmark.cases.case import all_cases

    for case in all_cases().values():
        suite = "core" if case.core else "full"
        values = ", ".join(map(case.label_of, case.values(suite))) or case.lacks()
        alone = "" if case.core else "; suite full alone"
        typer.echo(f"{case.kind}: {case.question} ({case.varied}: {values}{alone})")


_BESIDE = 3


def _print_summary(found: BenchmarkResult) -> None:
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


class OpenGLPlatform(StrEnum):
    """OpenGL platforms of pyrender."""

    auto = "auto"
    osmesa = "osmesa"
    egl = "egl"


class Divergence(StrEnum):
    """Forms of the divergence term."""

    paper = "paper"
    consistent = "consistent"


def register_validation(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    experiments = typer.Typer(
        help="Answer a question about the method by many virtual measurements.", no_args_is_help=True
    )
    for command in (figure2, emva, fidelity):
        experiments.command()(command)
    app.add_typer(experiments, name="experiment")


def figure2(
    output: options.Output,
    divergence: Annotated[Divergence, typer.Option(help="Setting of the estimator.")] = Divergence.paper,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Measurements for each point; 8 without, 60 with noise if not given.")
    ] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Draw the paper's figure 2: errors of U_X, U_Z and Z over their size."""
    from scenetruth.cli.console import reporting
    from scenetruth.output import claim_folder, write_atomically
    from scenetruth.validation_studies import run_figure2

    with (
        write_atomically(output, overwrite=overwrite, claim=claim_folder("figure2.csv")) as folder,
        reporting() as report,
    ):
        run_figure2(folder, divergence=divergence.value, runs=runs, progress=report)
    typer.echo(f"written: {output / 'figure2.csv'}, {output / 'figure2.png'}")


def emva(
    output: options.Output,
    preset: Annotated[
        list[str] | None,
        typer.Option("--preset", metavar="NAME", help="A sensor preset; may be repeated; all if not given."),
    ] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Measure sensor presets as EMVA 1288 does: gain, noise, fixed patterns, saturation, linearity."""
    from scenetruth.cli.console import reporting
    from scenetruth.output import claim_folder, write_atomically
    from scenetruth.validation_studies import run_emva

    with (
        write_atomically(output, overwrite=overwrite, claim=claim_folder("emva.csv", "emva_levels.csv")) as folder,
        reporting() as report,
    ):
        results = run_emva(folder, preset or (), progress=report)
    for one in results:
        typer.echo(f"{one.sensor:16} {one.quantity:22} {one.told:10.5g} {one.measured:10.5g} {100 * one.error:+8.3f} %")
    typer.echo(f"written: {output / 'emva.csv'}, {output / 'emva_levels.csv'} and a picture of each sensor")


def fidelity(
    output: options.Output,
    platform: Annotated[OpenGLPlatform, typer.Option(help="OpenGL platform of pyrender.")] = OpenGLPlatform.auto,
    overwrite: options.Overwrite = False,
) -> None:
    """Measure how true the renderers are to the exact pixel integral, at sub-pixel shifts."""
    from scenetruth.cli.console import reporting
    from scenetruth.output import claim_folder, write_atomically
    from scenetruth.validation_studies import run_fidelity

    with (
        write_atomically(output, overwrite=overwrite, claim=claim_folder("fidelity.csv", "fidelity.json")) as folder,
        reporting() as report,
    ):
        results, reason = run_fidelity(folder, platform=platform.value, progress=report)
    _print_fidelity(results)
    if reason:
        typer.echo(f"left out: {reason}")
    names = ("fidelity.csv", "fidelity.json", "fidelity.png", "fidelity_maps.png")
    typer.echo("written: " + ", ".join(str(output / name) for name in names))


def _print_fidelity(results: Sequence[RenderingAccuracy]) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console

    table = Table(title="rendered against exact images, subsets of 25 x 25 px", title_justify="left")
    for heading in ("wavelengths", "backend"):
        table.add_column(heading)
    for heading in ("samples", "shift rms, px", "max, px", "bound, px", "grey rms / std", "ms per image"):
        table.add_column(heading, justify="right")
    for result in results:
        bound = result.bound_px
        verdict = "–" if bound is None else f"{bound:.0e}, {'kept' if result.within_bounds else 'missed'}"
        table.add_row(
            f"from {result.shortest_wavelength_px:g} px",
            result.backend,
            f"{result.supersampling} x {result.supersampling}",
            f"{result.rms_px:.1e}",
            f"{result.max_px:.1e}",
            verdict,
            f"{result.rms_grey:.1e}",
            f"{1000 * result.seconds_per_image:.0f}",
        )
    make_console().print(table)
