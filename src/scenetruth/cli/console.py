"""Output on the terminal: progress, warnings, errors and interruption; tables of scores."""

from __future__ import annotations

import gc
import io
import logging
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from scenetruth.cli.messages import Verbosity, verbosity
from scenetruth.compilation import announced_compilation, check_environment
from scenetruth.errors import CaptureWarning, EstimateWarning, ScenetruthError, SceneWarning, visible
from scenetruth.number_format import format_number, format_share
from scenetruth.progress import LOGGER

if TYPE_CHECKING:
    from scenetruth.scoring import Score

__all__ = [
    "ProgressReporter",
    "guard",
    "make_console",
    "print_main_figures",
    "print_score",
    "print_warning",
    "reporting",
]


_EXIT_ERROR = 2
_EXIT_INTERRUPTED = 130
_AGAIN_S = 0.05
_SILENT_S = 3.0
_SILENT_PART = 0.1
_POLL_INTERVAL_S = 0.25
_START, _COMPILE = "start", "compile"
# Libraries create some 250,000 objects that stay, which the collector would visit again and again: 0.4 s.
_OBJECTS_OF_LIBRARIES = 400_000


@dataclass
class ProgressReporter:
    """Shows progress, and measures the accumulated duration of each type of task."""

    progress: Progress
    timings_s: dict[str, float] = field(default_factory=dict)
    _tasks: dict[str, TaskID] = field(default_factory=dict)
    _state: str = "loading libraries"
    _begun_s: float = field(default_factory=lambda: time.monotonic())
    _told_s: float = field(default_factory=lambda: time.monotonic())
    _collection: tuple[int, int, int] | None = None

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` steps of a task are complete."""
        if _interrupted:
            raise _Interrupted
        self._show(what, done, total)
        self._state = f"{what}: {done:,} of {total:,}"

    def _show(self, what: str, done: int, total: int | None) -> None:
        if what not in self._tasks:
            self.end_start()
            self._tasks[what] = self.progress.add_task(escape(visible(what, lines=False)), total=total)
        self.progress.update(self._tasks[what], completed=done, total=total)

    def begin_start(self) -> None:
        """Show activity, and collect less garbage, while libraries are loaded until the first task reports progress."""
        self._collection = gc.get_threshold()
        gc.set_threshold(_OBJECTS_OF_LIBRARIES, *self._collection[1:])
        self._tasks[_START] = self.progress.add_task(_START, total=None)

    def end_start(self) -> None:
        """Remove the display of activity, and collect garbage as usual."""
        if self._collection is not None:
            gc.set_threshold(*self._collection)
            self._collection = None
        if _START in self._tasks:
            self.progress.remove_task(self._tasks.pop(_START))

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Measure the duration of one type of task."""
        start = time.perf_counter()
        yield
        self.timings_s[what] = round(time.perf_counter() - start, 3)

    def compiles(self, name: str, before: int) -> None:
        """Show that a kernel is being compiled, and the number of kernels compiled before."""
        if before == 0:
            self.say(
                "compiling what this run needs, once on this machine; later runs read the result from disk "
                "(`scenetruth precompile` compiles everything in advance, in 1 to 2 min)"
            )
        self._show(_COMPILE, before + 1, None)
        self._state = f"{_COMPILE}: {before + 1} kernels so far"

    def say(self, text: str) -> None:
        """Print a line above the bars."""
        self._told_s = time.monotonic()
        self.progress.console.print(visible(text), highlight=False, markup=False, emoji=False, soft_wrap=True)

    def break_silence(self) -> None:
        """Print the progress after some seconds, or a tenth of the elapsed time, without output."""
        now = time.monotonic()
        passed = now - self._begun_s
        # The final state is not reported as progress.
        patience = 0.0 if self._state.startswith(_COMPILE) else _SILENT_PART * passed
        if now - self._told_s >= max(_SILENT_S - _POLL_INTERVAL_S, patience):
            self.say(f"after {passed:.0f} s, {self._state}")

    def finish(self) -> None:
        """Stop all bars."""
        self.end_start()
        if verbosity() is Verbosity.verbose:
            self._print_run_times()
        if _COMPILE in self._tasks:
            task = self._tasks[_COMPILE]
            self.progress.update(task, total=self.progress.tasks[self.progress.task_ids.index(task)].completed)
        if not self.progress.task_ids:
            # Without a bar, nothing is printed, not even an empty line.
            self.progress.live.transient = True
            self.progress.live.stop()
            self.progress.disable = True

    def _print_run_times(self) -> None:
        for task in self.progress.tasks:
            if task.elapsed is not None:
                self.say(f"{task.description}: {task.completed:,.0f} in {task.elapsed:.2f} s")
        self.say(f"run time: {time.monotonic() - self._begun_s:.2f} s")


@contextmanager
def reporting() -> Iterator[ProgressReporter]:
    """Show progress bars on standard error; without a terminal occasional lines, with --quiet nothing."""
    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    quiet = verbosity() is Verbosity.quiet
    with Progress(*columns, console=Console(stderr=True, quiet=quiet)) as progress:
        reporter = ProgressReporter(progress)
        reporter.begin_start()
        with _no_silence(reporter), _printed_messages(reporter):
            try:
                with announced_compilation(reporter.compiles):
                    yield reporter
            finally:
                reporter.finish()


class _ReporterHandler(logging.Handler):
    """Print messages of the package above the bars."""

    def __init__(self, reporter: ProgressReporter) -> None:
        super().__init__(logging.INFO)
        self._reporter = reporter

    def emit(self, record: logging.LogRecord) -> None:
        self._reporter.say(record.getMessage())


@contextmanager
def _printed_messages(reporter: ProgressReporter) -> Iterator[None]:
    handler, before = _ReporterHandler(reporter), LOGGER.level
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOGGER.setLevel(before)
        LOGGER.removeHandler(handler)


@contextmanager
def _no_silence(reporter: ProgressReporter) -> Iterator[None]:
    """Let a reporter print the progress regularly while the block runs, for output without a terminal."""
    if reporter.progress.console.is_terminal:
        yield
        return
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_POLL_INTERVAL_S):
            reporter.break_silence()

    watcher = threading.Thread(target=watch, name="no silence", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def guard(run: Callable[[], None]) -> None:
    """Run a command; convert exceptions of scenetruth to messages and exit codes.

    Exit code 2: invalid input or insufficient resources. 130: interrupted. Unexpected exceptions keep their traceback.
    """
    warnings.showwarning = _show_warning
    for stream in (sys.stdout, sys.stderr):
        # Characters that a terminal cannot show are replaced by their codes.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    shown = sys.unraisablehook
    sys.unraisablehook = _again_if_swallowed
    try:
        check_environment()
        try:
            run()
        finally:
            # Writing the buffer may fail because of a closed pipe or a full disk.
            _flush()
    except BaseException as error:
        # Compiled code may convert an interrupt to another exception.
        if _interrupted:
            _print_error(
                "interrupted; incomplete results were removed, finished results remain; run the same command to resume"
            )
            sys.exit(_EXIT_INTERRUPTED)
        entries = _error_message(error)
        if entries is None:
            raise
        _print_error(entries)
        sys.exit(_EXIT_ERROR)
    finally:
        sys.unraisablehook = shown


def _flush() -> None:
    if sys.stdout is not None:
        try:
            sys.stdout.flush()
        except OSError:
            # Otherwise Python would try and fail again at exit.
            sys.stdout = None
            raise


def _error_message(error: BaseException) -> str | None:
    if isinstance(error, ScenetruthError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); reduce the size of images, meshes or textures, or the number of frames"
    if isinstance(error, RecursionError):
        return f"an input is nested too deeply ({error})"
    if isinstance(error, UnicodeError):
        return f"a text is not valid UTF-8, or cannot be encoded in it: {error}"
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    return None


class _Interrupted(BaseException):
    """Request to end the command; not a KeyboardInterrupt, which the command-line library would catch."""


_interrupted: list[int] = []


def _interrupt(number: int, frame: object) -> None:
    _interrupted.append(number)
    raise _Interrupted


def _again_if_swallowed(unraisable: sys.UnraisableHookArgs) -> None:
    """Interrupt again where compiled code could not pass the interrupt to its caller."""
    if isinstance(unraisable.exc_value, _Interrupted):
        signal.signal(signal.SIGALRM, _interrupt)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)


def _print_error(text: str) -> None:
    _print_plainly(f"error: {text}", "red")


def _print_plainly(text: str, style: str) -> None:
    """Print on standard error, with control characters escaped."""
    console = Console(stderr=True, highlight=False, markup=False, emoji=False)
    console.print(visible(text), style=style, soft_wrap=True)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: object = None,
    line: object = None,
) -> None:
    text = (
        str(message)
        if issubclass(category, SceneWarning | EstimateWarning | CaptureWarning)
        else f"{category.__name__}: {message}"
    )
    print_warning(text)


def print_warning(text: str) -> None:
    """Print a warning on standard error."""
    _print_plainly(f"warning: {text}", "yellow")


def make_console() -> Console:
    """Return a console on standard output, without markup; without terminal and ``COLUMNS``, tables fit into it."""
    from rich.console import Console

    console = Console(markup=False, emoji=False, highlight=False)
    if console.is_terminal or "COLUMNS" in os.environ:
        return console
    return Console(width=120, markup=False, emoji=False, highlight=False)


def print_score(scored: Score, method: str = "", region: str = "interior") -> None:
    """Print the statistics of an estimate: those of a region, then the RMSE of all regions."""
    from rich.table import Table

    from scenetruth.errors import Problem, ScoreError, visible
    from scenetruth.scoring import get_units
    from scenetruth.scoring.score_result import select_summary_quantities

    headings = {
        "bias": "bias",
        "rmse": "RMSE",
        "median_abs_error": "median",
        "p95_abs_error": "95 %",
        "relative_rmse": "RMSE,\nrel.",
        "rms_z": "RMS\nof z",
        "coverage_2_std": "in 2\nstd",
        "density": "density",
    }
    if region not in scored.regions:
        raise ScoreError([Problem("--region", f"must be one of {', '.join(scored.regions)}", region)])
    title = visible(f"{method}, region {region}" if method else f"region {region}")
    table = Table(title=title, title_justify="left")
    table.add_column("quantity", overflow="fold")
    table.add_column("unit")
    for name in headings.values():
        table.add_column(name, justify="right")
    for quantity in select_summary_quantities(scored.regions, grows=scored.grows):
        cells = [scored.regions[region][quantity].get(name) for name in headings]
        table.add_row(quantity, get_units(quantity), *(format_number(value) for value in cells))
    make_console().print(table)
    _print_common(scored, region)
    _print_regions(scored)


def _print_common(scored: Score, region: str) -> None:
    """Print the statistics of errors that pixels have in common, for quantities with a stated common part."""
    from scenetruth.scoring import COMMON_STATISTICS
    from scenetruth.scoring.score_result import select_summary_quantities

    for quantity in select_summary_quantities(scored.regions, grows=scored.grows):
        values = [scored.regions[region][quantity].get(name) for name in COMMON_STATISTICS]
        if any(value is not None for value in values):
            of_mean, of_rest = (format_number(value) for value in values)
            make_console().print(
                f"{quantity}: bias {of_mean} times the stated standard deviation of the mean; without the common part, "
                f"RMS of z {of_rest}"
            )


_MAIN = (
    ("depth", "disparity"),
    ("velocity_x", "flow_x"),
    ("velocity_y", "flow_y"),
    ("velocity_z",),
    ("growth_rate_windowed", "growth_rate"),
)
"""Groups of quantities; the first available quantity of each group is a main figure."""


_ALL_FIGURES = 72
"""Console width required for all columns."""


def print_main_figures(scored: Score, method: str) -> None:
    """Print the errors of depth, motion and growth in the interior; report and files contain all statistics."""
    from rich.table import Table

    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import get_title, get_units
    from scenetruth.scoring.score_result import find_growing_objects, select_summary_quantities

    shown, interior = select_summary_quantities(scored.regions, grows=scored.grows), scored.regions["interior"]
    growing = find_growing_objects(scored.regions)
    table = Table(title=visible(f"errors of {method}, region interior", lines=False), title_justify="left")
    table.add_column("quantity", min_width=13)
    # Columns are omitted rather than digits.
    headings = ("RMSE", "median", "unit", "RMSE, rel.", "density")[: 5 if make_console().width >= _ALL_FIGURES else 3]
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "unit" else "right", no_wrap=True)
    for name in (next((one for one in several if one in shown), None) for several in _MAIN):
        if name is None:
            continue
        entries, title = interior[name], get_title(name)
        # Growth of soil is zero, and its errors are not those of the leaf before it.
        if name in _GROWTH and growing is not None:
            entries, title = growing.values(scored.regions, name), visible(f"{title}, {growing.names}", lines=False)
        rms, median, relative, density = (
            entries.get(key) for key in ("rmse", "median_abs_error", "relative_rmse", "density")
        )
        shares = ("–" if value is None else format_share(value) for value in (relative, density))
        values = (format_number(value) for value in (rms, median))
        table.add_row(title, *[*values, get_units(name), *shares][: len(headings)])
    make_console().print(table)


_GROWTH = ("growth_rate", "growth_rate_windowed")


def _print_regions(scored: Score) -> None:
    from rich.table import Table

    from scenetruth.errors import visible
    from scenetruth.scoring import get_units
    from scenetruth.scoring.score_result import select_summary_quantities

    shown = select_summary_quantities(scored.regions, grows=scored.grows)
    names = [
        name
        for name in ("depth", "normal", "flow_x", "velocity_z", "velocity_epe", *_GROWTH)
        if name in shown
        # Flow is shown where no better motion is available.
        and (name != "flow_x" or "velocity_z" not in scored.regions["all"])
    ]
    table = Table(title="all regions, RMSE", title_justify="left")
    table.add_column("region", overflow="fold")
    for name in ("pixels", "density", *(f"{name}\n{get_units(name)}" for name in names)):
        table.add_column(name, justify="right")
    first = names[0] if names else next(iter(scored.regions["all"]))
    for region, quantities in scored.regions.items():
        count, density = (quantities[first][key] for key in ("count", "density"))
        if not count:
            continue
        cells = [density, *(quantities[name]["rmse"] for name in names)]
        table.add_row(visible(region, lines=False), f"{count:,}", *(format_number(value) for value in cells))
    make_console().print(table)
