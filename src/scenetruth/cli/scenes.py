"""The commands that look at scenes and at what is installed: check, scenes, schema, methods, warm-up, doctor."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from scenetruth.cli import options

__all__ = ["register"]

_EXIT_UNFIT = 2


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (check, scenes, schema, methods, warm_up, doctor):
        app.command()(command)


def check(scene: options.SceneFile, overrides: options.Overrides = None, limits: options.Limits = None) -> None:
    """Validate a scene and print what will be made from it."""
    from scenetruth.cli.checking import print_check
    from scenetruth.resources.bounds import limits_from
    from scenetruth.scene import load_scene

    print_check(load_scene(scene, overrides or ()), scene, limits_from(limits or ()))


def scenes() -> None:
    """List the scenes that are shipped, and recipes and goals: each is called by its name alone."""
    from scenetruth.cli.tables import print_shipped

    print_shipped()


def schema() -> None:
    """Print the JSON Schema of scene files."""
    from scenetruth.scene import Scene

    typer.echo(json.dumps(Scene.model_json_schema(), indent=2))


def methods() -> None:
    """List the methods of estimation, ours and those of plug-ins, and what keeps one from being used here."""
    from scenetruth.cli.tables import print_methods

    print_methods()


def warm_up() -> None:
    """Compile now what is compiled at first use: a minute or two once, seconds from then on."""
    from scenetruth import pipeline
    from scenetruth.cli.console import reporting

    with reporting() as report, pipeline.figure_help(options.helpers()) as helper:
        pipeline.warm_up(report, None if helper is None else helper.compile_method)
    typer.echo("everything is compiled")


def doctor(
    as_json: Annotated[
        bool, typer.Option("--json", help="As JSON, to be sent along with the report of a fault.")
    ] = False,
) -> None:
    """Say what works on this machine and what does not, each with a remedy; exit code 2 if scenes cannot be run."""
    from scenetruth.cli import doctor as room

    findings = room.examine()
    if as_json:
        typer.echo(room.as_json(findings))
    else:
        room.print_findings(findings)
    if not room.is_fit(findings):
        raise typer.Exit(_EXIT_UNFIT)
