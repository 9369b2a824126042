"""The command that writes results in formats of others: export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from scenetruth.cli import options

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(export)


def export(
    folder: Annotated[
        Path | None, typer.Argument(metavar="FOLDER", help="Folder of a run, or of a data set.", show_default=False)
    ] = None,
    format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="A format; --list tells all.", show_default=False),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder to make.", show_default=False)] = None,
    *,
    left: Annotated[
        int | None, typer.Option("--left", metavar="S", help="Left camera of a pair.", show_default=False)
    ] = None,
    flow: Annotated[
        str | None,
        typer.Option(
            "--flow",
            metavar="KIND",
            help="finite: where points are in the next image; instantaneous: dx/dt.",
            show_default=False,
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="An option of the format; may be repeated.", show_default=False
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method", metavar="NAME", help="Export this method's estimate, not the truth.", show_default=False
        ),
    ] = None,
    row: Annotated[int | None, typer.Option("--row", metavar="N", help="Row of a grid.", show_default=False)] = None,
    overwrite: options.Overwrite = False,
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes, for the samples of a data set.")] = 1,
    listed: Annotated[bool, typer.Option("--list", help="List the formats with their options, and end.")] = False,
) -> None:
    """Write the recording and truth (or an estimate) of a run, or of every sample of a data set, in another format."""
    from scenetruth.errors import ExportError, Problem, visible
    from scenetruth.pipeline import export_run

    if listed:
        from scenetruth.cli.tables import print_formats

        print_formats()
        return
    missing = {"FOLDER": folder, "--format": format, "--output": output}
    problems = [
        Problem(name, "is missing; see `scenetruth export --help`") for name, value in missing.items() if not value
    ]
    chosen: dict[str, Any] = {name: value for name, value in (("left", left), ("flow", flow)) if value is not None}
    problems += _read_settings(settings or (), chosen)
    if problems or folder is None or format is None or output is None:
        raise ExportError(problems)
    if (folder / "dataset.json").exists():
        _export_samples(folder, output, format, workers=workers, method=method, **chosen)
        return
    done = export_run(folder, output, format, method=method, row=row, overwrite=overwrite, **chosen)
    for note in done.notes:
        typer.echo(visible(f"note: {note}"), err=True)
    typer.echo(visible(f"written: {output} ({len(done.files)} files)"))


def _export_samples(folder: Path, output: Path, format: str, **wanted: Any) -> None:
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.exporting import export_dataset

    with reporting() as reporter:
        found = export_dataset(folder, output, format, progress=reporter, notice=reporter.say, **wanted)
    typer.echo(f"written: {output} ({found.done:,} samples, {found.present:,} were there)")
    if found.failed:
        raise typer.Exit(1)


def _read_settings(given: list[str] | tuple[str, ...], chosen: dict[str, Any]) -> list[Any]:
    """Put settings NAME=VALUE among what is chosen; return what is wrong with them."""
    import yaml

    from scenetruth.errors import Problem

    reserved = ("format", "method", "row", "overwrite", "folder", "out", "kind")
    problems = []
    for text in given:
        name, sign, value = text.partition("=")
        if not sign or not name.isidentifier():
            problems.append(Problem("--set", "must be NAME=VALUE", text))
        elif name in reserved:
            problems.append(Problem("--set", f"{name} is no option of a format; see `scenetruth export --help`", text))
        elif name in chosen:
            problems.append(Problem("--set", f"{name} is given twice", text))
        else:
            try:
                chosen[name] = yaml.safe_load(value)
            except yaml.YAMLError:
                problems.append(Problem("--set", "must have a value in YAML", text))
    return problems
