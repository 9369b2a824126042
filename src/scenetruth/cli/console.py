"""What the commands print: progress, warnings, errors."""

from __future__ import annotations

import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from scenetruth.errors import EstimateWarning, ScenetruthError, SceneWarning

__all__ = ["Reporter", "guard", "reporting"]

_EXIT_ERROR = 2
_EXIT_INTERRUPTED = 130
_AGAIN_S = 0.05


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

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` pieces of some work are done."""
        if _interrupted:
            raise _Interrupted
        if what not in self._tasks:
            self._tasks[what] = self.progress.add_task(what, total=total)
        self.progress.update(self._tasks[what], completed=done, total=total)

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Measure the time of one kind of work."""
        start = time.perf_counter()
        yield
        self.timings_s[what] = round(time.perf_counter() - start, 3)

    def say(self, text: str) -> None:
        """Print a line above the bars."""
        self.progress.console.print(text, highlight=False, markup=False, soft_wrap=True)


@contextmanager
def reporting() -> Iterator[Reporter]:
    """Show progress bars on standard error while the block runs."""
    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield Reporter(progress)


def guard(run: Callable[[], None]) -> None:
    """Run a command; turn errors that are ours into messages and exit codes.

    Exit code 2: an input or the machine does not allow it. 130: interrupted.
    """
    warnings.showwarning = _show_warning
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    shown = sys.unraisablehook
    sys.unraisablehook = _again_if_swallowed
    try:
        run()
    except BaseException as error:
        # Compiled code may turn the interrupt that reaches it into an error of its own.
        if _interrupted:
            _print_error(
                "interrupted; nothing half-written was kept, only finished results; the command can be repeated"
            )
            sys.exit(_EXIT_INTERRUPTED)
        if isinstance(error, ScenetruthError):
            _print_error(str(error))
            sys.exit(_EXIT_ERROR)
        raise
    finally:
        sys.unraisablehook = shown


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
    Console(stderr=True).print(f"error: {text}", style="red", highlight=False, markup=False, soft_wrap=True)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: object = None,
    line: object = None,
) -> None:
    text = str(message) if issubclass(category, SceneWarning | EstimateWarning) else f"{category.__name__}: {message}"
    Console(stderr=True).print(f"warning: {text}", style="yellow", highlight=False, markup=False, soft_wrap=True)
