"""Execution of a program with limits of time and memory, and termination of all its processes."""

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
from scenetruth.estimators.process_files import list_process_code
from scenetruth.progress import Progress

__all__ = ["ProcessResult", "ProcessTree", "can_list_processes", "last_lines", "run_program"]


MARK = "SCENETRUTH_PROGRAM"
"""Environment variable that identifies the processes of a program, whatever their current parent."""

_PROCESSES = Path("/proc")
_KILL_S = 5.0
_DEAD = ("Z", "X")


def can_list_processes() -> bool:
    """Return whether the system lists its processes."""
    return (_PROCESSES / "self" / "stat").is_file()


def new_mark() -> str:
    """Return a unique value for `MARK`."""
    return secrets.token_hex(8)


class ProcessTree:
    """A process that leads its own session, and all processes that it and its children start.

    These are the processes of its group and its session, the children of all processes detected earlier, and, on
    termination, those that have inherited its mark.

    ``code_files``: The libraries, programs and scripts that they ran whenever their memory was measured.
    ``leader``: Process id; the process must not be reaped while this object is in use, so that its id stays unique.
    """

    def __init__(self, leader: int, mark: str) -> None:
        self._leader = leader
        self._mark = f"{MARK}={mark}".encode()
        # Start time by process id, because ids are reused.
        self._seen: dict[int, str] = {}
        self.code_files = set[Path]()

    def look(self) -> set[int]:
        """Return the ids of all processes that are alive."""
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
        """Return the resident memory of all processes in MB (1e6 bytes), with shared memory counted once."""
        alive = self.look()
        self.code_files.update(*map(list_process_code, alive))
        return sum(map(_resident_bytes, alive)) / 1e6

    def kill(self) -> None:
        """Kill all processes; return when they are dead, or after 5 s."""
        until = time.monotonic() + _KILL_S
        while True:
            alive = self.look() | self._marked()
            # The group is killed in one call, so that none of its processes can start another one.
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._leader, signal.SIGKILL)
            for pid in alive:
                with suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            if not alive or time.monotonic() > until:
                return
            time.sleep(0.005)

    def _marked(self) -> set[int]:
        """Return the ids of all living processes that have inherited the mark."""
        found = set()
        for pid in _ids():
            with suppress(OSError):  # it has ended, or belongs to another user
                if self._mark in (_PROCESSES / str(pid) / "environ").read_bytes().split(b"\0"):
                    found.add(pid)
        return found


def _ids() -> Iterator[int]:
    with suppress(FileNotFoundError):
        yield from (int(name) for name in os.listdir(_PROCESSES) if name.isdigit())


def _table() -> dict[int, tuple[str, str, str, str, str]]:
    """Return state, parent, group, session and start time of every process."""
    found = {}
    for pid in _ids():
        try:
            text = (_PROCESSES / str(pid) / "stat").read_text(encoding="ascii", errors="replace")
        except OSError:  # it has ended
            continue
        # The name of the program, in parentheses, may contain any characters.
        rest = text.rpartition(")")[2].split()
        found[pid] = (rest[0], rest[1], rest[2], rest[3], rest[19])
    return found


def _resident_bytes(pid: int) -> int:
    """Return the memory of a process, with its share of shared memory; 0 if it has ended."""
    folder = _PROCESSES / str(pid)
    try:
        for line in (folder / "smaps_rollup").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("Pss:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    try:
        # Without proportional shares, the resident memory is used.
        return int((folder / "statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


_PROGRESS_S = 0.5
# Longest interval between two polls, and inverse of the largest fraction of time spent on polling.
_POLL_INTERVAL_S = 0.1
_SHARE = 10
_LONGEST_PAUSE_S = 0.05
_LOG_BYTES = 16384


@dataclass(frozen=True)
class ProcessResult:
    """Result of a program run.

    ``code``: Exit code; minus the signal number if terminated by a signal.
    ``reason``: Exceeded limit: ``"time"`` or ``"memory"``; empty if the program ended by itself.
    ``peak_memory_mb``: Largest measured resident memory of all its processes together.
    ``code_files``: The user's libraries, programs and scripts that its processes ran; those of processes shorter than
      0.1 s may be missing.
    """

    code: int
    reason: Literal["", "time", "memory"]
    seconds: float
    peak_memory_mb: float
    code_files: frozenset[Path] = frozenset()


def run_program(
    words: Sequence[str],
    *,
    folder: Path,
    log: Path,
    timeout_s: float,
    memory_mb: float | None = None,
    progress: Progress | None = None,
) -> ProcessResult:
    """Run a program in its own process group; no process is left when this function returns or raises.

    The resident memory is measured about ten times a second, so that shorter peaks are missed. A limit of the address
    space would terminate programs that reserve more memory than they use, such as compilers and GPU libraries.

    ``progress``: Called with ("command", seconds, limit) about twice a second; an exception terminates the program.
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
    return ProcessResult(code, reason, seconds, peak, frozenset(tree.code_files))


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
    """Wait for a process to end; return the exceeded limit, if any, and the peak memory."""
    peak = look_s = report_s = 0.0
    pause_s = 0.001
    # The process is not reaped here, so that its id cannot be reused.
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
        if progress is not None and passed >= report_s:
            progress("command", int(passed), math.ceil(timeout_s))
            report_s = passed + _PROGRESS_S
        time.sleep(pause_s)
        pause_s = min(1.5 * pause_s, _LONGEST_PAUSE_S)
    return "", peak


def _environment(folder: Path, mark: str) -> dict[str, str]:
    """Return the environment of a program, without variables that reveal the working directory and the run."""
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
