"""The command-line application, which collects the commands of all modules."""

from __future__ import annotations

from typing import Annotated

import typer

from scenetruth.cli import capture_simulation, commands, data_sets, design_synthesis, scene_templates, studies

__all__ = ["app", "run_app"]

app = typer.Typer(
    name="scenetruth",
    help="Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage.",
    # All commands inherit these settings, including the option -h.
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def run_app() -> None:
    """Run the command line."""
    from scenetruth.cli.console import guard

    guard(lambda: app())


def _show_version(wanted: bool) -> None:
    if wanted:
        from scenetruth import __version__

        typer.echo(f"scenetruth {__version__}{_note_on_editable()}")
        raise typer.Exit


def _note_on_editable() -> str:
    """Return the note for an editable installation, whose version is that of its installation date, unlike its code."""
    import json
    from importlib import metadata

    try:
        values = metadata.distribution("scenetruth").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return ""
    editable = json.loads(values or "{}").get("dir_info", {}).get("editable", False)
    return " (of the last pip install -e; the code is that of the checkout)" if editable else ""


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


for register in (
    commands.register_runs,
    commands.register_info,
    scene_templates.register,
    data_sets.register,
    commands.register_export,
    studies.register_compare,
    design_synthesis.register,
    capture_simulation.register,
    studies.register_validation,
):
    register(app)
