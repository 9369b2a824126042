"""Messages of commands: their form, and the options --quiet and --verbose."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path

import typer

__all__ = ["Verbosity", "echo", "print_note", "print_wrote", "set_verbosity", "verbosity"]


class Verbosity(IntEnum):
    """Amount of messages; results, warnings and errors are printed with each."""

    quiet = 0
    normal = 1
    verbose = 2


_current = [Verbosity.normal]


def set_verbosity(*, quiet: bool, verbose: bool) -> None:
    """Set the amount of messages of this process."""
    if quiet and verbose:
        msg = "--quiet and --verbose exclude each other"
        raise typer.BadParameter(msg)
    _current[0] = Verbosity.quiet if quiet else Verbosity.verbose if verbose else Verbosity.normal


def verbosity() -> Verbosity:
    """Return the amount of messages of this process."""
    return _current[0]


def echo(text: str, *, err: bool = False) -> None:
    """Print a text; control characters, for example of file names, are printed as their codes."""
    from scenetruth.errors import visible

    typer.echo(visible(text), err=err)


def print_note(text: str) -> None:
    """Print a note on standard error, except with --quiet."""
    print_message(f"note: {text}")


def print_message(text: str) -> None:
    """Print a message on standard error, except with --quiet."""
    if verbosity() is not Verbosity.quiet:
        echo(text, err=True)


def print_wrote(paths: Path | str | Iterable[Path | str], detail: str = "") -> None:
    """Print which files or directories were written, except with --quiet."""
    if verbosity() is Verbosity.quiet:
        return
    listed = [paths] if isinstance(paths, str | Path) else paths
    echo(f"wrote {', '.join(map(str, listed))}" + (f" ({detail})" if detail else ""))
