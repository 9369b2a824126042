"""Running a program within limits of time and memory, and ending it with all processes that it started."""

from __future__ import annotations

import math
import os
import secrets
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

from scenetruth.errors import EstimateError, Problem
from scenetruth.progress import Progress

__all__ = ["ProcessResult", "ProcessTree", "can_list_processes", "last_lines", "run_program"]


MARK = "SCENETRUTH_PROGRAM"
"""Environment variable by which the processes of a program are known, whoever their parent is by now."""

_PROCESSES = Path("/proc")
_KILL_S = 5.0
_DEAD = ("Z", "X")


def can_list_processes() -> bool:
    """Tell whether this machine tells of its processes."""
    return (_PROCESSES / "self" / "stat").is_file()


def new_mark() -> str:
    """Return a value of `MARK` that nobody else has."""
    return secrets.token_hex(8)


class ProcessTree:
    """A process that leads a session of its own, and all that it and its children start.

    To it belong the processes of its group and its session, the children of all that have been seen, and, when all are
    ended, those that have inherited its mark.

    ``leader``: Id of the process; it must not be waited for as long as this is in use, so that the id stays its own.
    ``mark``: What its environment says of `MARK`.
    """

    def __init__(self, leader: int, mark: str) -> None:
        self._leader = leader
        self._mark = f"{MARK}={mark}".encode()
        # When each was started, in the machine's clock: ids are used again.
        self._seen: dict[int, str] = {}

    def look(self) -> set[int]:
        """Return the ids of all that are alive."""
        found = _table()
        own = str(self._leader)
        members = {
            pid
            for pid, (_, _, group, session, started) in found.items()
            if own in (group, session) or self._seen.get(pid) == started
        }
        children: dict[str, list[int]] = {}
        for pid, (_, parent, *_) in found.items():
            children.setdefault(parent, []).append(pid)
        open_ = list(members)
        while open_:
            for pid in children.get(str(open_.pop()), ()):
                if pid not in members:
                    members.add(pid)
                    open_.append(pid)
        self._seen |= {pid: found[pid][4] for pid in members}
        return {pid for pid in members if found[pid][0] not in _DEAD}

    def memory_mb(self) -> float:
        """Return the resident memory of all together in MB (1e6 bytes); what they share counts once."""
        return sum(map(_resident_bytes, self.look())) / 1e6

    def kill(self) -> None:
        """End all of them; return when they are dead, or cannot be ended within some seconds."""
        until = time.monotonic() + _KILL_S
        while True:
            alive = self.look() | self._marked()
            # The group is ended in one go: nobody in it can start another one meanwhile.
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._leader, signal.SIGKILL)
            for pid in alive:
                with suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            if not alive or time.monotonic() > until:
                return
            time.sleep(0.005)

    def _marked(self) -> set[int]:
        """Return the ids of those that have inherited the mark; the dead tell of none."""
        found = set()
        for pid in _ids():
            with suppress(OSError):  # it has ended meanwhile, or is another user's
                if self._mark in (_PROCESSES / str(pid) / "environ").read_bytes().split(b"\0"):
                    found.add(pid)
        return found


def _ids() -> Iterator[int]:
    with suppress(FileNotFoundError):
        yield from (int(name) for name in os.listdir(_PROCESSES) if name.isdigit())


def _table() -> dict[int, tuple[str, str, str, str, str]]:
    """Return state, parent, group, session and start of every process."""
    found = {}
    for pid in _ids():
        try:
            text = (_PROCESSES / str(pid) / "stat").read_text(encoding="ascii", errors="replace")
        except OSError:  # it has ended meanwhile
            continue
        # The name of the program, in brackets, may hold anything.
        rest = text.rpartition(")")[2].split()
        found[pid] = (rest[0], rest[1], rest[2], rest[3], rest[19])
    return found


def _resident_bytes(pid: int) -> int:
    """Return the memory of a process, of what it shares its part; 0 of one that has ended."""
    folder = _PROCESSES / str(pid)
    try:
        for line in (folder / "smaps_rollup").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("Pss:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    try:
        # Kernels that do not tell shares: all that is resident.
        return int((folder / "statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


_PROGRESS_S = 0.5
# At most this long between two looks, and at most a tenth of the time for looking.
_POLL_INTERVAL_S = 0.1
_SHARE = 10
_LONGEST_PAUSE_S = 0.05
_LOG_BYTES = 16384


@dataclass(frozen=True)
class ProcessResult:
    """How a program has ended.

    ``code``: Its exit code; of one that a signal has ended, minus the signal's number.
    ``reason``: What it was ended for: ``"time"`` or ``"memory"``; empty if it ended by itself.
    ``seconds``: How long it ran.
    ``peak_memory_mb``: The largest resident memory of all its processes together that was seen, in MB.
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
) -> ProcessResult:
    """Run a program in a process group of its own; when this returns or raises, none of its processes is left.

    Memory is what is resident, looked at about ten times a second: a bound on address space, as the system offers it,
    would end programs that reserve more than they use, as compilers and GPU libraries do. A peak between two looks is
    not seen.

    ``progress``: Called with ("command", seconds, seconds at most) about twice a second; it may raise, which ends the
      program.
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
    return ProcessResult(code, reason, seconds, peak)


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
            look_s = passed + max(min(passed / 4, _POLL_INTERVAL_S), _SHARE * spent)
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
