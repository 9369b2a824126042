"""Command-line interface."""

from __future__ import annotations

import atexit
import os
import sys
from contextlib import suppress

__all__ = ["main"]


def main() -> None:
    """Run the command ``scenetruth``; the process ends with it."""
    codes: list[int] = []
    # Called after the threads have ended and after all that is registered later.
    atexit.register(_leave, codes)
    try:
        from scenetruth.cli.app import run_app

        run_app()
    except KeyboardInterrupt:  # during the import of modules
        raise SystemExit(130) from None
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            codes.append(end.code or 0)
        raise


def _leave(codes: list[int]) -> None:
    """End the process with the exit code, if there is one, without freeing every object: after compiling, over 1 s."""
    if codes:
        for stream in (sys.stdout, sys.stderr):
            # What can fail was reported before.
            with suppress(AttributeError, OSError, ValueError):
                stream.flush()
        os._exit(codes[0])
