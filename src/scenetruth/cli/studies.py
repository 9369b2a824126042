"""Commands that run many simulated measurements: `compare` (benchmark of methods) and the validation studies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import typer

from scenetruth.cli import design_options, options
from scenetruth.cli.messages import print_wrote

if TYPE_CHECKING:
    from scenetruth.benchmark import BenchmarkResult
    from scenetruth.validation_studies.rendering_accuracy import RenderingAccuracy

__all__ = ["register_compare", "register_validation"]


def register_compare(app: typer.Typer) -> None:
    """Add the command to the command line."""
    options.add_command(app, compare)


def compare(
    methods: options.BenchmarkMethods = None,
    suite: design_options.Suite = design_options.SuiteName.core,
    *,
    output: options.Output,
    cases: design_options.Cases = None,
    levels: design_options.Levels = None,
    seeds: options.OptionalSeeds = None,
    limits: options.Limits = None,
    settings: options.Settings = None,
    command: options.LabelledCommands = None,
    command_timeout_s: options.CommandTimeoutS = 600.0,
    command_memory_mb: options.CommandMemoryMb = None,
    external_results: design_options.ExternalResults = None,
    write_recordings: design_options.WriteRecordings = False,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    fresh: options.Fresh = False,
) -> None:
    """Run methods on the benchmark suite and report error statistics with their lower bounds."""
    from scenetruth.benchmark import compare as compare_methods
    from scenetruth.benchmark.suite import select_available_cases
    from scenetruth.cli.console import reporting
    from scenetruth.errors import CollectedErrors, EstimateError, Problem
    from scenetruth.estimators.external import CommandMethod, ResultsFolder
    from scenetruth.resources.limits import limits_from

    if write_recordings:
        from scenetruth.benchmark import suite as suites

        with reporting() as reporter:
            written = suites.write_recordings(
                output, suite.value, cases=cases or None, levels=levels or None, progress=reporter
            )
        print_wrote(output, f"{len(written)} recordings")
        return
    chosen: list[Any] = []
    errors = CollectedErrors()
    with errors.collect():
        chosen += options.with_settings(methods or (), settings)
    with errors.collect():
        for label, words in _labelled("--command", command):
            chosen.append(CommandMethod(words, label, timeout_s=command_timeout_s, memory_mb=command_memory_mb))
    with errors.collect():
        chosen += [ResultsFolder(folder, label) for label, folder in _labelled("--results", external_results)]
    with errors.collect():
        if not chosen and not errors:
            raise EstimateError(
                [Problem("METHOD", "is missing; `scenetruth list methods` lists the installed methods")]
            )
    with errors.collect():
        counted = design_options.read_seeds(seeds)
    with errors.collect():
        most = limits_from(limits or ())
    if errors:
        with errors.collect():
            select_available_cases(suite.value, cases or None, levels or None)
    errors.raise_all()
    with reporting() as reporter:
        found = compare_methods(
            chosen,
            suite=suite.value,
            cases=cases or None,
            levels=levels or None,
            seeds=counted,
            limits=most,
            output=output,
            workers=workers,
            scheduler=scheduler,
            fresh=fresh,
            progress=reporter,
        )
    _print_summary(found)
    print_wrote(output / name for name in ("index.html", "results.csv", "summary.csv"))
    if found.failures:
        raise typer.Exit(1)


def _labelled(option: str, given: Sequence[str] | None) -> list[tuple[str, str]]:
    from scenetruth.errors import EstimateError, Problem

    pairs = [one.partition("=") for one in given or ()]
    problems = [Problem(option, "must be LABEL=...", "".join(pair)) for pair in pairs if not (pair[0] and pair[2])]
    if problems:
        raise EstimateError(problems)
    return [(label.strip(), rest.strip()) for label, _, rest in pairs]


_BESIDE = 3


def _print_summary(found: BenchmarkResult) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from scenetruth.benchmark.ranking_charts import describe_quantity
    from scenetruth.errors import visible
    from scenetruth.number_format import format_two_digits

    frame, names = found.ranking(), [describe_quantity(one) for one in found.headlines()]
    labels = [visible(str(label), lines=False) for label in frame.columns]
    # Maximum number of columns in a terminal of 80 characters.
    for first in range(0, len(labels), _BESIDE):
        table = Table(title="median over the values of each case")
        table.add_column("case", max_width=30)
        for label in labels[first : first + _BESIDE]:
            table.add_column(escape(label), justify="right", overflow="fold", min_width=8)
        for name, cells in zip(names, frame.to_numpy(), strict=True):
            numbers = cells[first : first + _BESIDE]
            table.add_row(escape(name), *(format_two_digits(float(one)) for one in numbers))
        Console().print(table)
    for line in found.convention_mismatches:
        typer.echo(f"possible convention error: {visible(line, lines=False)}", err=True)
    for line in found.failures:
        # Lines of a method are indented to distinguish them from messages of the command.
        typer.echo("no estimate: " + visible(line).replace("\n", "\n    "), err=True)


def register_validation(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    group = typer.Typer(help="Validate the simulator and the structure-tensor method.", no_args_is_help=True)
    options.add_command(group, paper_figure2, "paper-figure2")
    options.add_command(group, emva1288)
    options.add_command(group, rendering)
    app.add_typer(group, name="validation")


def paper_figure2(
    output: options.Output,
    divergence: design_options.DivergenceOption = design_options.Divergence.paper,
    runs: design_options.Runs = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Reproduce figure 2 of the paper: errors of U_X, U_Z and Z over their true values."""
    from scenetruth.cli.console import reporting
    from scenetruth.output import claim_folder, write_atomically
    from scenetruth.validation_studies import run_figure2

    with (
        write_atomically(output, overwrite=overwrite, claim=claim_folder("figure2.csv")) as folder,
        reporting() as report,
    ):
        run_figure2(folder, divergence=divergence.value, runs=runs, progress=report)
    print_wrote((output / "figure2.csv", output / "figure2.png"))


def emva1288(
    output: options.Output, presets: design_options.SensorPresets = None, overwrite: options.Overwrite = False
) -> None:
    """Measure the sensor presets by EMVA 1288: gain, noise, saturation, linearity."""
    from scenetruth.cli.console import reporting
    from scenetruth.output import claim_folder, write_atomically
    from scenetruth.validation_studies import run_emva

    with (
        write_atomically(output, overwrite=overwrite, claim=claim_folder("emva.csv", "emva_levels.csv")) as folder,
        reporting() as report,
    ):
        results = run_emva(folder, presets or (), progress=report)
    for one in results:
        values = f"{one.nominal:10.5g} {one.measured:10.5g} {100 * one.error:+8.3f} %"
        typer.echo(f"{one.sensor:16} {one.quantity:22} {values}")
    print_wrote((output / "emva.csv", output / "emva_levels.csv"), "and a figure of each sensor")


def rendering(
    output: options.Output,
    platform: design_options.Platform = design_options.OpenGLPlatform.auto,
    overwrite: options.Overwrite = False,
) -> None:
    """Compare the renderers with the exact pixel integral at sub-pixel shifts."""
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
        typer.echo(f"not measured: {reason}")
    names = ("fidelity.csv", "fidelity.json", "fidelity.png", "fidelity_maps.png")
    print_wrote(output / name for name in names)


def _print_fidelity(results: Sequence[RenderingAccuracy]) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console

    table = Table(title="rendered and exact images, subsets of 25 x 25 px", title_justify="left")
    for heading in ("wavelengths", "backend"):
        table.add_column(heading)
    for heading in ("samples", "shift RMS, px", "max, px", "bound, px", "grey RMS / std", "ms per image"):
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
