"""What the commands print: progress, warnings, errors."""

from __future__ import annotations

import io
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

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

from scenetruth.compilation import announced_compilation, check_environment
from scenetruth.errors import EstimateWarning, ScenetruthError, SceneWarning, visible

__all__ = ["Reporter", "guard", "print_warning", "reporting"]

_EXIT_ERROR = 2
_EXIT_INTERRUPTED = 130
_AGAIN_S = 0.05
_SILENT_S = 3.0
_SILENT_PART = 0.1
_LOOKED_S = 0.25
_START, _COMPILE = "start", "compile"


@dataclass
class Reporter:
    """Shows progress, and measures how long each kind of work takes.

    Parameters
    ----------
    progress
        The bars.
    timings_s
        Seconds spent on each kind of work so far.
    """

    progress: Progress
    timings_s: dict[str, float] = field(default_factory=dict)
    _tasks: dict[str, TaskID] = field(default_factory=dict)
    _state: str = "loading libraries"
    _begun_s: float = field(default_factory=lambda: time.monotonic())
    _told_s: float = field(default_factory=lambda: time.monotonic())

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` pieces of some work are done."""
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
        """Show that something is going on before any work tells of itself: libraries are loaded."""
        self._tasks[_START] = self.progress.add_task(_START, total=None)

    def end_start(self) -> None:
        """Take that away."""
        if _START in self._tasks:
            self.progress.remove_task(self._tasks.pop(_START))

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Measure the time of one kind of work."""
        start = time.perf_counter()
        yield
        self.timings_s[what] = round(time.perf_counter() - start, 3)

    def compiles(self, name: str, before: int) -> None:
        """Show that a kernel is being compiled, and how many have been before it."""
        if before == 0:
            self.say(
                "compiling for this machine, which takes a minute or two once; later runs read it from disk "
                "(`scenetruth warm-up` does it beforehand)"
            )
        self._show(_COMPILE, before + 1, None)
        self._state = f"{_COMPILE}: {before + 1} kernels so far"

    def say(self, text: str) -> None:
        """Print a line above the bars."""
        self._told_s = time.monotonic()
        self.progress.console.print(visible(text), highlight=False, markup=False, emoji=False, soft_wrap=True)

    def break_silence(self) -> None:
        """Print how far the work is if nothing was printed for seconds, or for a tenth of the time if that is more."""
        now = time.monotonic()
        passed = now - self._begun_s
        # Whoever waits for it to end the first time has not seen yet that it does.
        patience = 0.0 if self._state.startswith(_COMPILE) else _SILENT_PART * passed
        if now - self._told_s >= max(_SILENT_S - _LOOKED_S, patience):
            self.say(f"after {passed:.0f} s, {self._state}")

    def finish(self) -> None:
        """Leave no bar behind that runs on."""
        self.end_start()
        if _COMPILE in self._tasks:
            task = self._tasks[_COMPILE]
            self.progress.update(task, total=self.progress.tasks[self.progress.task_ids.index(task)].completed)
        if not self.progress.task_ids:
            # Where no bar was, none is printed, nor an empty line after it.
            self.progress.live.transient = True
            self.progress.live.stop()
            self.progress.disable = True


@contextmanager
def reporting() -> Iterator[Reporter]:
    """Show progress bars on standard error while the block runs; where that is no terminal, a line now and then."""
    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        reporter = Reporter(progress)
        reporter.begin_start()
        with _no_silence(reporter):
            try:
                with announced_compilation(reporter.compiles):
                    yield reporter
            finally:
                reporter.finish()


@contextmanager
def _no_silence(reporter: Reporter) -> Iterator[None]:
    """Let a reporter say how far the work is while the block runs, where no bars move because there is no terminal."""
    if reporter.progress.console.is_terminal:
        yield
        return
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_LOOKED_S):
            reporter.break_silence()

    watcher = threading.Thread(target=watch, name="no silence", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def guard(run: Callable[[], None]) -> None:
    """Run a command; turn errors that are ours into messages and exit codes.

    Exit code 2: an input or the machine does not allow it. 130: interrupted. What nobody foresaw keeps its traceback.
    """
    warnings.showwarning = _show_warning
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show a character shows its number.
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
            # What is left in the buffer may find that nobody reads it, or that the disk is full.
            _flush()
    except BaseException as error:
        # Compiled code may turn the interrupt that reaches it into an error of its own.
        if _interrupted:
            _print_error(
                "interrupted; nothing half-written was kept, only finished results; the command can be repeated"
            )
            sys.exit(_EXIT_INTERRUPTED)
        told = _told(error)
        if told is None:
            raise
        _print_error(told)
        sys.exit(_EXIT_ERROR)
    finally:
        sys.unraisablehook = shown


def _flush() -> None:
    if sys.stdout is not None:
        try:
            sys.stdout.flush()
        except OSError:
            # Python would try again when it ends, and fail again.
            sys.stdout = None
            raise


def _told(error: BaseException) -> str | None:
    """Return what to tell a user of an error; None for one that only who mends the program can understand."""
    if isinstance(error, ScenetruthError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); make images, meshes, textures or the number of frames smaller"
    if isinstance(error, RecursionError):
        return f"an input is nested too deeply ({error})"
    if isinstance(error, UnicodeError):
        return f"a text is not UTF-8, or cannot be written in it: {error}"
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    return None


class _Interrupted(BaseException):
    """Somebody wants the command to end; not a KeyboardInterrupt, which the command line library would swallow."""


_interrupted: list[int] = []


def _interrupt(number: int, frame: object) -> None:
    _interrupted.append(number)
    raise _Interrupted


def _again_if_swallowed(unraisable: sys.UnraisableHookArgs) -> None:
    """Interrupt again where compiled code, as the compiler's own, could not hand the interrupt on to its caller."""
    if isinstance(unraisable.exc_value, _Interrupted):
        signal.signal(signal.SIGALRM, _interrupt)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)


def _print_error(text: str) -> None:
    _print_plainly(f"error: {text}", "red")


def _print_plainly(text: str, style: str) -> None:
    """Print on standard error; nothing in the text acts on the terminal."""
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
    text = str(message) if issubclass(category, SceneWarning | EstimateWarning) else f"{category.__name__}: {message}"
    print_warning(text)


def print_warning(text: str) -> None:
    """Print a warning on standard error."""
    _print_plainly(f"warning: {text}", "yellow")
