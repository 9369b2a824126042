"""The commands that look at scenes and at what is installed: check, schema, methods, warm-up."""

from __future__ import annotations

import json

import typer

from scenetruth.cli import options

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (check, schema, methods, warm_up):
        app.command()(command)


def check(scene: options.SceneFile, overrides: options.Overrides = None, limits: options.Limits = None) -> None:
    """Validate a scene and print what will be made from it."""
    from scenetruth.cli.checking import print_check
    from scenetruth.resources.bounds import limits_from
    from scenetruth.scene import load_scene

    print_check(load_scene(scene, overrides or ()), scene, limits_from(limits or ()))


def schema() -> None:
    """Print the JSON Schema of scene files."""
    from scenetruth.scene import Scene

    typer.echo(json.dumps(Scene.model_json_schema(), indent=2))


def methods() -> None:
    """List the methods of estimation that are installed, ours and those of plug-ins."""
    from scenetruth.cli.tables import print_methods

    print_methods()


def warm_up() -> None:
    """Compile now what is compiled at first use: a minute or two once, seconds from then on."""
    from scenetruth import pipeline
    from scenetruth.cli.console import reporting

    with reporting() as report:
        pipeline.warm_up(report)
    typer.echo("everything is compiled")
