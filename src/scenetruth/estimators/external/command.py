"""A command, of whatever language, as a method of estimation."""

from __future__ import annotations

import os
import shlex
import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import xarray as xr
from pydantic import create_model, field_validator

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.choice import validate_settings
from scenetruth.estimators.external.command_line import files_of, filled, program_problem, words_of
from scenetruth.estimators.external.exchange.image_files import image_problems
from scenetruth.estimators.external.exchange.reading import read_results
from scenetruth.estimators.external.exchange.writing import write_recording
from scenetruth.estimators.external.naming import name_problems
from scenetruth.estimators.external.processes import can_be_seen
from scenetruth.estimators.external.running import Ended, last_lines, run_program
from scenetruth.estimators.external.workplace import Workplace
from scenetruth.estimators.protocol import Method, MethodSettings, Needs
from scenetruth.model import Positive
from scenetruth.progress import Progress

__all__ = ["CommandMethod", "CommandSettings"]

_GIVES = ("depth", "disparity", "flow", "velocity")


class CommandSettings(MethodSettings):
    """Which command, what it is given, and what it may take."""

    command: str
    """The command, with {recording} and {output} for the folders; it is split into words, and no shell reads it."""
    images: Literal["png", "tiff", "npy"] = "png"
    """How images are written: ``png``: 16 bits; ``tiff``: as recorded, or float32; ``npy``: one float32 array."""
    timeout_s: Positive = 600.0
    """How long it may run, in s."""
    memory_mb: Positive | None = None
    """How much resident memory it may have, with all that it starts, in MB; null: any."""

    @field_validator("command")
    @classmethod
    def _has_places(cls, command: str) -> str:
        words_of(command)
        return command


class CommandMethod(Method):
    """A program of any language as a method.

    The recording is written into a fresh folder as images and camera.json, the program is run, and what it leaves in
    another folder is read. Truth, scene and run stay out of its sight. The estimate has the attributes ``seconds`` and
    ``peak_memory_mb``: the time that the program took, and the largest memory of it and all that it started.

    Parameters
    ----------
    command
        The command: words as in a shell, but no shell reads them. ``{recording}`` and ``{output}`` stand for the two
        folders. Words that name files are made absolute, as the program runs in a scratch folder.
    name
        What the method is called.
    images
        How images are written: ``"png"``, ``"tiff"`` or ``"npy"``; see `write_recording`.
    timeout_s
        How long it may run.
    memory_mb
        How much resident memory it may have, with all that it starts, in MB (1e6 bytes); None for any.
    keep_in
        A folder in which the folders of every run stay. Without it they are temporary, but for those of the first run
        that fails and the logs of all that fail.
    gives
        Which of depth, disparity, flow and velocity its results always hold, as far as it is known.
    needs
        What a recording must hold; ``Needs(mask=True)`` says that the program leaves out the pixels that masks mark:
        otherwise recordings that have a mask are refused.

    Raises
    ------
    EstimateError
        With everything that is wrong with these.

    See Also
    --------
    scenetruth.estimators.external.write_recording : What the program finds in ``{recording}``.
    scenetruth.estimators.external.read_results : What it may leave in ``{output}``.
    scenetruth.estimators.external.ResultsFolder : Results that were made before.

    Examples
    --------
    >>> method = CommandMethod("python mine.py {recording} {output}", "mine", timeout_s=60, gives=["depth"])
    >>> method.settings().timeout_s, sorted(method.gives)
    (60.0, ['depth'])
    """

    reads_frames = True

    def __init__(
        self,
        command: str,
        name: str,
        *,
        images: Literal["png", "tiff", "npy"] = "png",
        timeout_s: float = 600.0,
        memory_mb: float | None = None,
        keep_in: str | os.PathLike[str] | None = None,
        gives: Iterable[str] = (),
        needs: Needs = Method.needs,
    ) -> None:
        self.name, self.settings, self.gives, self.needs = str(name), CommandSettings, frozenset(gives), needs
        problems = name_problems(name)
        if needs.grid:
            problems.append(Problem("needs.grid", "must be false: programs are given one row of cameras at a time"))
        if strange := sorted(self.gives - set(_GIVES)):
            problems.append(Problem("gives", f"must be some of {', '.join(_GIVES)}", strange))
        given = {"command": command, "images": images, "timeout_s": timeout_s, "memory_mb": memory_mb}
        try:
            checked = validate_settings(self, given)
        except EstimateError as error:
            problems += error.problems
        if problems:
            raise EstimateError(problems, source="command of a method")
        # What was given here is what settings are by default, so that estimates tell it.
        fields: dict[str, Any] = {
            key: (CommandSettings.model_fields[key].rebuild_annotation(), value)
            for key, value in checked.model_dump().items()
        }
        self.settings = create_model("CommandSettings", __base__=CommandSettings, **fields)
        self._keep_in = None if keep_in is None else Path(keep_in).absolute()
        self._base = Path.cwd()
        self._has_kept = False
        self._given = {
            **checked.model_dump(),
            "name": self.name,
            "keep_in": self._keep_in,
            "gives": self.gives,
            "needs": needs,
        }

    def __reduce__(self) -> tuple[Any, ...]:
        # Models that are made at run time cannot be found by those who unpickle: workers make their own.
        return _remade, (self._given, self._base)

    def as_option(self, label: str) -> tuple[str, str]:
        """Return how the command line of a comparison calls it."""
        return "--command", f"{label}={self._given['command']}"

    def named_files(self) -> list[Path]:
        """Return the files that the command names, the program first if it is found."""
        return files_of(words_of(self._given["command"]), self._base)

    def requirements(self, recording: xr.Dataset, settings: CommandSettings) -> list[Problem]:
        """Return what keeps the program from being started, and images from being written."""
        word = filled(words_of(settings.command), {"recording": Path(), "output": Path()}, self._base)[0]
        problems = image_problems(recording, settings.images)
        if message := program_problem(word, self._base):
            problems.append(Problem("command", message, word))
        if settings.memory_mb is not None and not can_be_seen():
            problems.append(Problem("memory_mb", "cannot be kept here: the system does not tell the memory (/proc)"))
        return problems

    def estimate(self, recording: xr.Dataset, settings: CommandSettings, progress: Progress | None) -> xr.Dataset:
        """Write the recording, run the program, read its results."""
        place = Workplace(self.name, self._keep_in)
        words = filled(words_of(settings.command), place.places, self._base)
        try:
            write_recording(recording, place.recording, settings.images, progress=progress)
            ended, problems = _run(words, place, settings, progress)
            if not problems:
                found = read_results(place.output, recording)
        except EstimateError as error:
            problems = list(error.problems)
        except BaseException:
            place.clear()
            raise
        if problems:
            problems += self._traces(words, place)
            raise EstimateError(problems, source=f"command of '{self.name}'")
        place.clear()
        found.attrs |= {"seconds": ended.seconds, "peak_memory_mb": ended.peak_memory_mb}
        return found

    def _traces(self, words: list[str], place: Workplace) -> list[Problem]:
        """Keep what shows why a run failed, and tell where it is."""
        lines = last_lines(place.log)
        end = (
            ", which ends:" + "".join(f"\n      {line}" for line in lines) if lines else "; the program printed nothing"
        )
        again = f"cd {shlex.quote(str(place.work))} && {shlex.join(words)}"
        if self._has_kept:
            # A data set may have thousands of samples that fail: one of them will do.
            place.clear_to_log()
            again += "  (recordings are kept of the first failure only: give keep_in)" if self._keep_in is None else ""
        self._has_kept = True
        return [Problem("log", f"{place.log}{end}"), Problem("to repeat", again)]


def _remade(given: dict[str, Any], base: Path) -> CommandMethod:
    made = CommandMethod(**given)
    made._base = base
    return made


def _run(
    words: list[str], place: Workplace, settings: CommandSettings, progress: Progress | None
) -> tuple[Ended, list[Problem]]:
    """Run the program; return how it ended, and what was wrong with that."""
    ended = run_program(
        words,
        folder=place.work,
        log=place.log,
        timeout_s=settings.timeout_s,
        memory_mb=settings.memory_mb,
        progress=progress,
    )
    if ended.reason == "time":
        message = f"took longer than timeout_s = {settings.timeout_s:g} s, and was ended with all that it had started"
        return ended, [Problem("command", message)]
    if ended.reason == "memory":
        message = (
            f"took {ended.peak_memory_mb:.0f} MB of memory, more than memory_mb = {settings.memory_mb:g}, "
            "and was ended with all that it had started"
        )
        return ended, [Problem("command", message)]
    if ended.code:
        return ended, [Problem("command", _code_told(ended.code))]
    return ended, []


def _code_told(code: int) -> str:
    if code > 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by signal {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
