"""The commands under ``design``: one module for each, which is found by itself and holds a function of its name."""

from __future__ import annotations

import pkgutil
from importlib import import_module

import typer

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    group = typer.Typer(
        help="Design an experiment: what precision is possible, what limits it, and which rig does better.",
        no_args_is_help=True,
    )
    for entry in pkgutil.iter_modules(__path__):
        module = import_module(f"{__name__}.{entry.name}")
        # What is no command, but shared by some, has no function of its name.
        command = getattr(module, entry.name, None)
        if callable(command):
            group.command(entry.name)(command)
    app.add_typer(group, name="design")
