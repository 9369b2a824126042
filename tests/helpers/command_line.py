"""Calling the command line from a test: in this process, where everything is loaded, or in one of its own."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import typer

from scenetruth.cli import options
from scenetruth.cli.app import app
from scenetruth.cli.console import guard

__all__ = ["help_texts", "in_own_process", "names", "scenetruth"]


def scenetruth(
    *arguments: str | Path, env: Mapping[str, str] | None = None, helped: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run a command as `scenetruth.cli.app.run_app` does; return its exit code and what it printed.

    Unless it is to be ``helped``, no second process draws pictures: it takes longer to start than a few pictures take,
    and draws the same ones (`tests.pipeline.test_figure_worker`).
    """
    words = list(map(str, arguments))
    output, errors = io.StringIO(), io.StringIO()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    code = 0
    try:
        with (
            contextlib.redirect_stdout(output),
            contextlib.redirect_stderr(errors),
            mock.patch.dict(os.environ, env or {}, clear=env is not None),
            contextlib.nullcontext() if helped else mock.patch.object(options, "helpers", return_value=0),
            warnings.catch_warnings(),
        ):
            # As in a process of its own: a warning is printed, it is not an error.
            warnings.simplefilter("default")
            guard(lambda: app(words))
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return subprocess.CompletedProcess(words, code, output.getvalue(), errors.getvalue())


def in_own_process(*arguments: str | Path, env: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own."""
    command = [sys.executable, "-m", "scenetruth", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=env)


def names(folder: Path) -> set[str]:
    """Return the names of everything in a folder."""
    return {path.name for path in folder.iterdir()}


def help_texts() -> dict[str, str]:
    """Return the texts that ``--help`` shows, by command: its description and those of arguments and options."""

    def visit(words: tuple[str, ...], command: Any) -> Iterator[tuple[str, str]]:
        texts = [command.help or "", *(getattr(one, "help", None) or "" for one in command.params)]
        yield " ".join(words) or "scenetruth", "\n".join(texts)
        for name, inner in getattr(command, "commands", {}).items():
            yield from visit((*words, name), inner)

    return dict(visit((), typer.main.get_command(app)))
