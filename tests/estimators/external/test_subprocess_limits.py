"""Processes of a program: all are found and ended, also those that hide from their parents."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from scenetruth.errors import EstimateError
from scenetruth.estimators.external import can_list_processes, last_lines, run_program
from tests.helpers.external_scripts import is_gone, wait_for

pytestmark = pytest.mark.skipif(not can_list_processes(), reason="this system tells of no processes (/proc)")

DAEMON = """
import os, sys, time
# A daemon: its parent ends at once, and it leads a session of its own.
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        with open(sys.argv[1], "w") as file:
            file.write(str(os.getpid()))
        time.sleep(60)
    os._exit(0)
while not (os.path.exists(sys.argv[1]) and os.path.getsize(sys.argv[1])):
    time.sleep(0.001)
"""


def test_a_daemon_is_ended_with_the_program_that_started_it(tmp_path: Path) -> None:
    words = [sys.executable, "-I", "-S", "-c", DAEMON, str(tmp_path / "pid")]
    ended = run_program(words, folder=tmp_path, log=tmp_path / "log", timeout_s=30)
    assert (ended.code, ended.reason) == (0, "")
    (pid,) = wait_for(tmp_path / "pid", 1)
    assert is_gone(pid)


def test_processes_of_others_are_left_alone(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-I", "-S", "-c", "import time; time.sleep(60)"]) as other:
        try:
            run_program(["true"], folder=tmp_path, log=tmp_path / "log", timeout_s=30)
            assert other.poll() is None
        finally:
            other.kill()


@pytest.mark.parametrize("words", [["no-such-program"], ["/"]])
def test_what_cannot_be_started_is_told(words: list[str], tmp_path: Path) -> None:
    with pytest.raises(EstimateError, match="cannot be started"):
        run_program(words, folder=tmp_path, log=tmp_path / "log", timeout_s=1)


def raising(error: type[BaseException]) -> Callable[[str, int, int], None]:
    def tell(what: str, done: int, total: int) -> None:
        raise error("stop")

    return tell


@pytest.mark.parametrize("error", [OSError, RuntimeError, KeyboardInterrupt])
def test_what_progress_raises_comes_out(error: type[BaseException], tmp_path: Path) -> None:
    with pytest.raises(error, match="stop"):
        run_program(["sleep", "60"], folder=tmp_path, log=tmp_path / "log", timeout_s=30, progress=raising(error))


def test_the_end_of_a_long_log_is_read(tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(b"".join(b"line %d \xff\n" % number for number in range(100_000)))
    assert last_lines(tmp_path / "log", 2) == ["line 99998 \ufffd", "line 99999 \ufffd"]
    assert last_lines(tmp_path / "none") == []
