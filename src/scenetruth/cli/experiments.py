"""The commands under ``experiment``: questions about the method, answered by many virtual measurements."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli import options

if TYPE_CHECKING:
    from scenetruth.experiment.fidelity.run import Fidelity

__all__ = ["register"]


class Platform(StrEnum):
    """OpenGL platforms of pyrender."""

    auto = "auto"
    osmesa = "osmesa"
    egl = "egl"


class Divergence(StrEnum):
    """Forms of the divergence term."""

    paper = "paper"
    consistent = "consistent"


def register(app: typer.Typer) -> None:
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
    from scenetruth.experiment import run_figure2
    from scenetruth.placing import claim_folder, write_aside

    with write_aside(output, overwrite=overwrite, claim=claim_folder("figure2.csv")) as folder, reporting() as report:
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
    from scenetruth.experiment import run_emva
    from scenetruth.placing import claim_folder, write_aside

    with (
        write_aside(output, overwrite=overwrite, claim=claim_folder("emva.csv", "emva_levels.csv")) as folder,
        reporting() as report,
    ):
        results = run_emva(folder, preset or (), progress=report)
    for one in results:
        typer.echo(f"{one.sensor:16} {one.quantity:22} {one.told:10.5g} {one.measured:10.5g} {100 * one.error:+8.3f} %")
    typer.echo(f"written: {output / 'emva.csv'}, {output / 'emva_levels.csv'} and a picture of each sensor")


def fidelity(
    output: options.Output,
    platform: Annotated[Platform, typer.Option(help="OpenGL platform of pyrender.")] = Platform.auto,
    overwrite: options.Overwrite = False,
) -> None:
    """Measure how true the renderers are to the exact pixel integral, at sub-pixel shifts."""
    from scenetruth.cli.console import reporting
    from scenetruth.experiment import run_fidelity
    from scenetruth.placing import claim_folder, write_aside

    with (
        write_aside(output, overwrite=overwrite, claim=claim_folder("fidelity.csv", "fidelity.json")) as folder,
        reporting() as report,
    ):
        results, reason = run_fidelity(folder, platform=platform.value, progress=report)
    _print_fidelity(results)
    if reason:
        typer.echo(f"left out: {reason}")
    names = ("fidelity.csv", "fidelity.json", "fidelity.png", "fidelity_maps.png")
    typer.echo("written: " + ", ".join(str(output / name) for name in names))


def _print_fidelity(results: Sequence[Fidelity]) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console

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
    console().print(table)
