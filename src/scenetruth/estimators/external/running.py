"""Running a program within bounds of time and memory, and ending it with all that it has started."""

from __future__ import annotations

import math
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.external.processes import MARK, ProcessTree, new_mark
from scenetruth.progress import Progress

__all__ = ["Ended", "last_lines", "run_program"]

_PROGRESS_S = 0.5
# At most this long between two looks, and at most a tenth of the time for looking.
_LOOK_S = 0.1
_SHARE = 10
_LONGEST_PAUSE_S = 0.05
_LOG_BYTES = 16384


@dataclass(frozen=True)
class Ended:
    """How a program has ended.

    Parameters
    ----------
    code
        Its exit code; of one that a signal has ended, minus the signal's number.
    reason
        What it was ended for: ``"time"`` or ``"memory"``; empty if it ended by itself.
    seconds
        How long it ran.
    peak_memory_mb
        The largest resident memory of all its processes together that was seen, in MB.
    """

    code: int
    reason: Literal["", "time", "memory"]
    seconds: float
    peak_memory_mb: float


def run_program(
    words: Sequence[str],
    *,
    folder: Path,
    log: Path,
    timeout_s: float,
    memory_mb: float | None = None,
    progress: Progress | None = None,
) -> Ended:
    """Run a program in a process group of its own; when this returns or raises, none of its processes is left.

    Memory is what is resident, looked at about ten times a second: a bound on address space, as the system offers it,
    would end programs that reserve more than they use, as compilers and GPU libraries do. A peak between two looks is
    not seen.

    Parameters
    ----------
    words
        The program and its arguments; no shell reads them.
    folder
        Where it runs.
    log
        The file that takes all that it prints.
    timeout_s
        How long it may run.
    memory_mb
        How much resident memory it may have, all processes together, in MB; None for any.
    progress
        Called with ("command", seconds, seconds at most) about twice a second; it may raise, which ends the program.

    Raises
    ------
    EstimateError
        If the program cannot be started.
    """
    with log.open("wb") as printed:
        begun = time.monotonic()
        mark = new_mark()
        process = _started(words, _environment(folder, mark), folder, printed)
        tree = ProcessTree(process.pid, mark)
        try:
            reason, peak = _watch(process.pid, tree, begun, timeout_s, memory_mb, progress)
            seconds = time.monotonic() - begun
        finally:
            tree.kill()
            code = process.wait()
    return Ended(code, reason, seconds, peak)


def _started(
    words: Sequence[str], environment: dict[str, str], folder: Path, printed: IO[bytes]
) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(
            list(words),
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=printed,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise EstimateError([Problem("command", f"cannot be started: {error.strerror or error}", words[0])]) from error


def _watch(
    pid: int, tree: ProcessTree, begun: float, timeout_s: float, memory_mb: float | None, progress: Progress | None
) -> tuple[Literal["", "time", "memory"], float]:
    """Wait for the end of a process; return what it must be ended for, and the largest memory seen."""
    peak = look_s = told_s = 0.0
    pause_s = 0.001
    # The process is not waited for here: as long as it is not, nobody else gets its number.
    while os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        passed = time.monotonic() - begun
        if passed > timeout_s:
            return "time", peak
        if passed >= look_s:
            peak = max(peak, tree.memory_mb())
            spent = time.monotonic() - begun - passed
            look_s = passed + max(min(passed / 4, _LOOK_S), _SHARE * spent)
            if memory_mb is not None and peak > memory_mb:
                return "memory", peak
        if progress is not None and passed >= told_s:
            progress("command", int(passed), math.ceil(timeout_s))
            told_s = passed + _PROGRESS_S
        time.sleep(pause_s)
        pause_s = min(1.5 * pause_s, _LONGEST_PAUSE_S)
    return "", peak


def _environment(folder: Path, mark: str) -> dict[str, str]:
    """Return the environment of a program: ours, without what says where we are and what we work on."""
    ours = ("PWD", "OLDPWD", "_")
    kept = {name: text for name, text in os.environ.items() if name not in ours and not name.startswith("SCENETRUTH_")}
    return kept | {"PWD": str(folder), MARK: mark}


def last_lines(log: Path, count: int = 20) -> list[str]:
    """Return the last lines of a log, without reading all of it."""
    try:
        with log.open("rb") as opened:
            opened.seek(0, os.SEEK_END)
            opened.seek(max(opened.tell() - _LOG_BYTES, 0))
            text = opened.read().decode("utf-8", errors="replace")
    except OSError:
        return []
    return [line.rstrip() for line in text.splitlines()][-count:]
