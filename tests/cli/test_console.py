"""Interrupts end the command whatever swallows them, and tables fit the terminal without losing digits."""

from __future__ import annotations

import gc
import io
import itertools
import math
import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from unittest import mock

import pytest
from rich.console import Console
from rich.progress import Progress

from scenetruth.cli.console import ProgressReporter, print_main_figures, reporting
from scenetruth.scoring import Score

SWALLOWED = """
import ctypes, os, signal, time
from scenetruth.cli.console import guard

def work():
    callback = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))
    callback()  # an exception cannot leave a callback of C code
    print("went on", flush=True)
    time.sleep(60)

guard(work)
"""


def test_an_interrupt_that_c_code_swallows_comes_again() -> None:
    done = subprocess.run([sys.executable, "-c", SWALLOWED], capture_output=True, text=True, timeout=50, check=False)
    assert "went on" in done.stdout
    assert done.returncode == 130, done.stderr
    assert "error: interrupted" in done.stderr
    assert "Traceback" not in done.stderr


class Clock:
    """A clock that a test sets."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def told_by(clock: Clock, seconds: float, work: Callable[[ProgressReporter, float], None]) -> list[tuple[float, str]]:
    """Return the lines of a reporter that is asked every quarter of a second, each with its time."""
    lines = []
    with mock.patch("time.monotonic", clock):
        file = io.StringIO()
        reporter = ProgressReporter(Progress(console=Console(file=file, width=200)))
        while clock.now < seconds:
            clock.now += 0.25
            work(reporter, clock.now)
            before = file.tell()
            reporter.break_silence()
            if file.tell() > before:
                lines.append((clock.now, file.getvalue()[before:].strip()))
    return lines


def test_a_pipe_hears_of_compiling_every_three_seconds() -> None:
    counts = iter(range(10_000))
    lines = told_by(Clock(), 120, lambda reporter, _: reporter.compiles("kernel", next(counts)))
    times = [0.0, *(time for time, _ in lines)]
    assert max(b - a for a, b in itertools.pairwise(times)) <= 3
    assert lines[0][1] == "after 3 s, compile: 12 kernels so far"


def test_a_pipe_hears_of_long_work_ever_more_rarely() -> None:
    def work(reporter: ProgressReporter, now: float) -> None:
        if now > 10:
            reporter("render", int(now), 40_000)

    lines = told_by(Clock(), 36_000, work)
    assert lines[0] == (2.75, "after 3 s, loading libraries")
    assert lines[3] == (11.0, "after 11 s, render: 11 of 40,000")
    # Ten lines to 30 s, and then each when 1.11 times as much time has passed as at the one before.
    assert len(lines) == pytest.approx(10 + math.log(36_000 / 30) / math.log(1 / 0.9), abs=4)


@pytest.mark.parametrize("terminal", [False, True])
def test_where_nothing_was_worked_on_nothing_is_left(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    file = io.StringIO()
    monkeypatch.setattr(sys, "stderr", file)
    monkeypatch.setenv("FORCE_COLOR" if terminal else "NO_COLOR", "1")
    with reporting():
        pass
    assert ("start" in file.getvalue()) == terminal
    if not terminal:
        assert file.getvalue() == ""
    with reporting() as reporter:
        reporter("render", 1, 2)
    assert "1/2" in file.getvalue()


VALUES = {"rmse": 0.0123, "median_abs_error": 0.00456, "relative_rmse": 0.0789, "density": 0.918}


@pytest.mark.parametrize(("columns", "shares"), [(60, False), (72, True), (100, True)])
def test_main_figures_have_all_digits_however_narrow_the_terminal(
    columns: int, shares: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    several = dict.fromkeys(("depth", "velocity_x", "velocity_y", "velocity_z", "growth_rate_windowed"), VALUES)
    regions = {"all": several, "interior": several}
    print_main_figures(Score(regions), "refined")
    told = capsys.readouterr().out
    assert max(map(len, told.splitlines())) <= columns
    assert "…" not in told
    assert re.search(r"Velocity in Z\s+│\s+0\.0123 │\s+0\.00456 │ mm/frame", told)
    assert ("7.89 %" in told) is ("91.8 %" in told) is shares


def test_large_errors_are_factors_without_exponents(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    depth = {"rmse": 12345.6, "median_abs_error": 1234.0, "relative_rmse": 10.2, "density": 1.0}
    print_main_figures(Score({"all": {"depth": depth}, "interior": {"depth": depth}}), "refined")
    assert re.search(r"Depth\s+│\s+12300 │\s+1230 │ mm\s+│\s+10 times │\s+100 %", capsys.readouterr().out)


@pytest.mark.parametrize("ends", ["with the first task", "without a task", "with an error"])
def test_garbage_is_collected_as_usual_once_libraries_are_loaded(ends: str) -> None:
    before, usual = gc.get_threshold(), (700, 10, 10)
    gc.set_threshold(*usual)
    try:
        with suppress(ZeroDivisionError), reporting() as reporter:
            assert gc.isenabled()
            assert gc.get_threshold()[0] > 100 * usual[0]
            if ends == "with the first task":
                reporter("render", 0, 2)
                assert gc.get_threshold() == usual
            elif ends == "with an error":
                raise ZeroDivisionError
        assert gc.get_threshold() == usual
    finally:
        gc.set_threshold(*before)
