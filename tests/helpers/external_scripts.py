"""Commands for tests: little programs, and whether their processes are gone."""

from __future__ import annotations

import shlex
import sys
import textwrap
import time
from pathlib import Path

HEAD = """
import os, subprocess, sys, time
recording, output = sys.argv[1], sys.argv[2]
"""


def command(folder: Path, code: str, *more: object) -> str:
    """Write a program, and return the command that runs it: it has the names recording, output, and sys.argv[3:]."""
    file = folder / "mine.py"
    file.write_text(HEAD + textwrap.dedent(code))
    # Isolated: nothing of what is installed is imported, so that it starts quickly.
    return shlex.join([sys.executable, "-I", str(file), "{recording}", "{output}", *map(str, more)])


def is_gone(pid: int) -> bool:
    """Tell whether a process has ended, or is dead and only not waited for."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True
    return text.rpartition(")")[2].split()[0] in ("Z", "X")


def wait_for(file: Path, count: int, longest_s: float = 20.0) -> list[int]:
    """Return the numbers in a file, as soon as there are so many."""
    until = time.monotonic() + longest_s
    while True:
        found = [int(word) for word in file.read_text().split()] if file.exists() else []
        if len(found) >= count or time.monotonic() > until:
            return found
        time.sleep(0.01)
