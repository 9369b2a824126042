"""A command that runs a program in any language, as a method."""

from __future__ import annotations

import difflib
import os
import re
import shlex
import shutil
import signal
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import xarray as xr
from pydantic import create_model, field_validator

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.external.image_writer import image_problems
from scenetruth.estimators.external.recording_writer import write_recording
from scenetruth.estimators.external.results_folder import read_results
from scenetruth.estimators.external.subprocess_limits import ProcessResult, can_list_processes, last_lines, run_program
from scenetruth.estimators.protocol import Method, MethodSettings, Needs
from scenetruth.estimators.registry import name_problems, validate_settings
from scenetruth.progress import Progress
from scenetruth.validated_model import Positive

__all__ = ["CommandMethod", "CommandSettings", "WorkingDirectory"]


PLACEHOLDERS = ("recording", "output")
"""What must stand in braces in a command, each at least once."""

_BRACES = re.compile(r"\{\{|\}\}|\{([^{}]*)\}")


def split_command(command: str) -> list[str]:
    """Return the words of a command, as a shell would split them; nothing in them is expanded.

    >>> split_command("python 'my program.py' {recording} --to={output}")
    ['python', 'my program.py', '{recording}', '--to={output}']
    >>> split_command("mine {recordings} {output}")
    Traceback (most recent call last):
    ValueError: {recordings} is unknown, did you mean {recording}?; {recording} is missing
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        msg = f"cannot be split into words: {error}"
        raise ValueError(msg) from error
    places = [match[1] for word in words for match in _BRACES.finditer(word) if match[1] is not None]
    wrong = []
    for place in dict.fromkeys(places):
        if place not in PLACEHOLDERS:
            near = difflib.get_close_matches(place, PLACEHOLDERS, n=1)
            hint = f"did you mean {{{near[0]}}}?" if near else "known: {recording}, {output}; other braces are doubled"
            wrong.append(f"{{{place}}} is unknown, {hint}")
    wrong += [f"{{{place}}} is missing" for place in PLACEHOLDERS if place not in places]
    if wrong:
        raise ValueError("; ".join(wrong))
    return words


def fill_placeholders(words: list[str], folders: Mapping[str, Path], base: Path) -> list[str]:
    """Return words with folders in their places.

    Programs run in a folder of their own. Words without a place that name a file below ``base`` become absolute, so
    that ``python mine.py`` finds what it found there.
    """
    return [_filled(word, folders, base) for word in words]


def _filled(word: str, folders: Mapping[str, Path], base: Path) -> str:
    def one(match: re.Match[str]) -> str:
        place: str | None = match[1]
        return match[0][0] if place is None else str(folders[place])

    if not any(match[1] is not None for match in _BRACES.finditer(word)):
        try:
            if word and (base / word).is_file():
                return str(base / word)
        except (OSError, ValueError):  # a word that no file can be named like
            pass
    return _BRACES.sub(one, word)


def find_command_files(words: list[str], base: Path) -> list[Path]:
    """Return the files that words name, also after ``--option=``, and the program, wherever it is found."""
    import shutil

    named = [part for word in words for part in (word, word.partition("=")[2]) if part]
    found = [] if (base / words[0]).is_file() else [Path(shutil.which(words[0]) or base)]
    for name in named:
        try:
            found += [base / name] if (base / name).is_file() else []
        except (OSError, ValueError):  # a word that no file can be named like
            continue
    return [path for path in found if path.is_file()]


def program_problem(word: str, base: Path) -> str:
    """Return why a program cannot be started; empty if it can, as far as can be told."""
    import os
    import shutil

    if (base / word).is_file() and not os.access(base / word, os.X_OK):
        return "may not be executed: name its interpreter before it, or allow it (chmod +x)"
    if (base / word).is_file() or shutil.which(word) is not None:
        return ""
    return "there is no such program"


class WorkingDirectory:
    """A fresh folder with folders in it: ``recording``, ``output``, ``work``, where the program runs, and ``log.txt``.

    ``name``: What it is called after.
    ``keep_in``: The folder in which it stays; None for a temporary one that goes.
    """

    def __init__(self, name: str, keep_in: Path | None) -> None:
        if keep_in is not None:
            keep_in.mkdir(parents=True, exist_ok=True)
        self._stays = keep_in is not None
        # The name says nothing of the run that the recording is from.
        self.folder = Path(tempfile.mkdtemp(prefix=f"scenetruth-{name}-", dir=keep_in)).resolve()
        self.recording, self.output, self.work = (self.folder / part for part in ("recording", "output", "work"))
        self.log = self.folder / "log.txt"
        for part in (self.recording, self.output, self.work):
            part.mkdir()

    @property
    def places(self) -> dict[str, Path]:
        """The folders that commands name."""
        return {"recording": self.recording, "output": self.output}

    def clear(self) -> None:
        """Remove all, unless it is to stay."""
        if not self._stays:
            shutil.rmtree(self.folder, ignore_errors=True)

    def clear_to_log(self) -> None:
        """Remove all but the log, unless all is to stay."""
        if not self._stays:
            for part in (self.recording, self.output, self.work):
                shutil.rmtree(part, ignore_errors=True)


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
        split_command(command)
        return command


class CommandMethod(Method):
    """A program of any language as a method.

    The recording is written into a fresh folder as images and camera.json, the program is run, and what it leaves in
    another folder is read. Truth, scene and run stay out of its sight. The estimate has the attributes ``run_time_s``
    and ``peak_memory_mb``: the time that the program took, and the largest memory of it and all that it started.

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
        What a recording must hold; ``Needs(exclusion_mask=True)`` says that the program leaves out the pixels that
        masks mark: otherwise recordings that have a mask are refused.

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
        return find_command_files(split_command(self._given["command"]), self._base)

    def requirements(self, recording: xr.Dataset, settings: CommandSettings) -> list[Problem]:
        """Return what keeps the program from being started, and images from being written."""
        word = fill_placeholders(split_command(settings.command), {"recording": Path(), "output": Path()}, self._base)[
            0
        ]
        problems = image_problems(recording, settings.images)
        if message := program_problem(word, self._base):
            problems.append(Problem("command", message, word))
        if settings.memory_mb is not None and not can_list_processes():
            problems.append(Problem("memory_mb", "cannot be kept here: the system does not tell the memory (/proc)"))
        return problems

    def estimate(self, recording: xr.Dataset, settings: CommandSettings, progress: Progress | None) -> xr.Dataset:
        """Write the recording, run the program, read its results."""
        place = WorkingDirectory(self.name, self._keep_in)
        words = fill_placeholders(split_command(settings.command), place.places, self._base)
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
        found.attrs |= {"run_time_s": ended.seconds, "peak_memory_mb": ended.peak_memory_mb}
        return found

    def _traces(self, words: list[str], place: WorkingDirectory) -> list[Problem]:
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
    words: list[str], place: WorkingDirectory, settings: CommandSettings, progress: Progress | None
) -> tuple[ProcessResult, list[Problem]]:
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
        return ended, [Problem("command", _describe_return_code(ended.code))]
    return ended, []


def _describe_return_code(code: int) -> str:
    if code > 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by signal {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
