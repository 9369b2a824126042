"""Method that runs an external program by a command."""

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
"""Placeholders that a command must contain in braces, each at least once."""

_BRACES = re.compile(r"\{\{|\}\}|\{([^{}]*)\}")


def split_command(command: str) -> list[str]:
    """Return the words of a command, split as by a shell but without expansion.

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
            hint = f"did you mean {{{near[0]}}}?" if near else "valid: {recording}, {output}; double all other braces"
            wrong.append(f"{{{place}}} is unknown, {hint}")
    wrong += [f"{{{place}}} is missing" for place in PLACEHOLDERS if place not in places]
    if wrong:
        raise ValueError("; ".join(wrong))
    return words


def fill_placeholders(words: list[str], folders: Mapping[str, Path], base: Path) -> list[str]:
    """Return words with placeholders replaced by folders, and files below ``base`` as absolute paths."""
    return [_filled(word, folders, base) for word in words]


def _filled(word: str, folders: Mapping[str, Path], base: Path) -> str:
    def one(match: re.Match[str]) -> str:
        place: str | None = match[1]
        return match[0][0] if place is None else str(folders[place])

    if not any(match[1] is not None for match in _BRACES.finditer(word)):
        try:
            if word and (base / word).is_file():
                return str(base / word)
        except (OSError, ValueError):  # not a valid file name
            pass
    return _BRACES.sub(one, word)


def find_command_files(words: list[str], base: Path) -> list[Path]:
    """Return the files named by words, also after ``--option=``, and the program, wherever it is installed."""
    import shutil

    named = [part for word in words for part in (word, word.partition("=")[2]) if part]
    found = [] if (base / words[0]).is_file() else [Path(shutil.which(words[0]) or base)]
    for name in named:
        try:
            found += [base / name] if (base / name).is_file() else []
        except (OSError, ValueError):  # not a valid file name
            continue
    return [path for path in found if path.is_file()]


def program_problem(word: str, base: Path) -> str:
    """Return the reason why a program cannot be started; empty if none is detected."""
    import os
    import shutil

    if (base / word).is_file() and not os.access(base / word, os.X_OK):
        return "is not executable; put its interpreter before it, or run chmod +x"
    if (base / word).is_file() or shutil.which(word) is not None:
        return ""
    return "no such program"


class WorkingDirectory:
    """A new folder with ``recording``, ``output``, ``work`` and ``log.txt``; temporary, unless kept in ``keep_in``."""

    def __init__(self, name: str, keep_in: Path | None) -> None:
        if keep_in is not None:
            keep_in.mkdir(parents=True, exist_ok=True)
        self._stays = keep_in is not None
        # The name must not identify the run of the recording.
        self.folder = Path(tempfile.mkdtemp(prefix=f"scenetruth-{name}-", dir=keep_in)).resolve()
        self.recording, self.output, self.work = (self.folder / part for part in ("recording", "output", "work"))
        self.log = self.folder / "log.txt"
        for part in (self.recording, self.output, self.work):
            part.mkdir()

    @property
    def places(self) -> dict[str, Path]:
        """Folders by placeholder."""
        return {"recording": self.recording, "output": self.output}

    def clear(self) -> None:
        """Remove the folder unless it is kept."""
        if not self._stays:
            shutil.rmtree(self.folder, ignore_errors=True)

    def clear_to_log(self) -> None:
        """Remove everything but the log unless the folder is kept."""
        if not self._stays:
            for part in (self.recording, self.output, self.work):
                shutil.rmtree(part, ignore_errors=True)


_GIVES = ("depth", "disparity", "flow", "velocity")


class CommandSettings(MethodSettings):
    """Settings of a command: placeholders, image format and resource limits."""

    command: str
    """Command, with {recording} and {output} for the folders; it is split into words without a shell."""
    images: Literal["png", "tiff", "npy"] = "png"
    """Image format: ``png``: 16 bits; ``tiff``: as recorded, or float32; ``npy``: one float32 array."""
    timeout_s: Positive = 600.0
    """Longest run time in s."""
    memory_mb: Positive | None = None
    """Largest resident memory of the program and its child processes in MB; null: unlimited."""

    @field_validator("command")
    @classmethod
    def _has_places(cls, command: str) -> str:
        split_command(command)
        return command


class CommandMethod(Method):
    """An external program in any language as a method.

    The recording is written to a new folder as images and camera.json, the program is run, and its output folder is
    read. The program has no access to ground truth, scene and run directory. The estimate has the attributes
    ``run_time_s`` and ``peak_memory_mb``: run time of the program, and peak memory including child processes.

    Parameters
    ----------
    command
        Command, split into words as by a shell, but run without one. ``{recording}`` and ``{output}`` stand for the two
        folders. Words that name files are converted to absolute paths, as the program runs in a scratch folder.
    name
        Name of the method.
    images
        Image format: ``"png"``, ``"tiff"`` or ``"npy"``; see `write_recording`.
    timeout_s
        Longest run time in s.
    memory_mb
        Largest resident memory, including child processes, in MB (1e6 bytes); None for unlimited.
    keep_in
        Folder in which the folders of all runs are kept; default: temporary folders, except those of the first failed
        run and the logs of all failed runs.
    gives
        Quantities among depth, disparity, flow and velocity that its results always contain.
    needs
        Requirements on the recording; ``Needs(exclusion_mask=True)`` states that the program excludes the pixels marked
        by masks: otherwise recordings with a mask are rejected.

    Raises
    ------
    EstimateError
        If arguments are invalid; lists all of them.

    See Also
    --------
    scenetruth.estimators.external.write_recording : Contents of ``{recording}``.
    scenetruth.estimators.external.read_results : Files allowed in ``{output}``.
    scenetruth.estimators.external.ResultsFolder : Use existing results as a method.

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
            problems.append(Problem("needs.grid", "must be false: programs process one row of cameras"))
        if strange := sorted(self.gives - set(_GIVES)):
            problems.append(Problem("gives", f"must be a subset of {', '.join(_GIVES)}", strange))
        given = {"command": command, "images": images, "timeout_s": timeout_s, "memory_mb": memory_mb}
        try:
            checked = validate_settings(self, given)
        except EstimateError as error:
            problems += error.problems
        if problems:
            raise EstimateError(problems, source="command of a method")
        # The arguments become the defaults of the settings, so that they are stored in estimates.
        fields: dict[str, Any] = {
            key: (CommandSettings.model_fields[key].rebuild_annotation(), value)
            for key, value in checked.model_dump().items()
        }
        self.settings = create_model("CommandSettings", __base__=CommandSettings, **fields)
        self._keep_in = None if keep_in is None else Path(keep_in).absolute()
        self._base = Path.cwd()
        self._has_kept = False
        self.called_code = set[Path]()
        self._given = {
            **checked.model_dump(),
            "name": self.name,
            "keep_in": self._keep_in,
            "gives": self.gives,
            "needs": needs,
        }

    def __reduce__(self) -> tuple[Any, ...]:
        # Models created at run time cannot be unpickled; worker processes create their own.
        return _remade, (self._given, self._base)

    def as_option(self, label: str) -> tuple[str, str]:
        """Return the option and value of the command line that specify the method."""
        return "--command", f"{label}={self._given['command']}"

    def named_files(self) -> list[Path]:
        """Return the files that the command names, with the program first if it is a file."""
        return find_command_files(split_command(self._given["command"]), self._base)

    def requirements(self, recording: xr.Dataset, settings: CommandSettings) -> list[Problem]:
        """Return the reasons why the program cannot be started or the images cannot be written."""
        word = fill_placeholders(split_command(settings.command), {"recording": Path(), "output": Path()}, self._base)[
            0
        ]
        problems = image_problems(recording, settings.images)
        if message := program_problem(word, self._base):
            problems.append(Problem("command", message, word))
        if settings.memory_mb is not None and not can_list_processes():
            problems.append(Problem("memory_mb", "is not supported here: the system does not report memory (/proc)"))
        return problems

    def estimate(self, recording: xr.Dataset, settings: CommandSettings, progress: Progress | None) -> xr.Dataset:
        """Write the recording, run the program and read its results."""
        place = WorkingDirectory(self.name, self._keep_in)
        words = fill_placeholders(split_command(settings.command), place.places, self._base)
        try:
            write_recording(recording, place.recording, settings.images, progress=progress)
            ended, problems = _run(words, place, settings, progress)
            self.called_code |= {file for file in ended.code_files if not file.is_relative_to(place.folder)}
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
        """Keep the files of a failed run, and return problems that state their location."""
        lines = last_lines(place.log)
        end = (
            ", which ends:" + "".join(f"\n      {line}" for line in lines) if lines else "; the program printed nothing"
        )
        again = f"cd {shlex.quote(str(place.work))} && {shlex.join(words)}"
        if self._has_kept:
            # A data set may have thousands of samples that fail; the files of the first suffice.
            place.clear_to_log()
            again += "  (recordings are kept for the first failure only; set keep_in)" if self._keep_in is None else ""
        self._has_kept = True
        return [Problem("log", f"{place.log}{end}"), Problem("to repeat", again)]


def _remade(given: dict[str, Any], base: Path) -> CommandMethod:
    made = CommandMethod(**given)
    made._base = base
    return made


def _run(
    words: list[str], place: WorkingDirectory, settings: CommandSettings, progress: Progress | None
) -> tuple[ProcessResult, list[Problem]]:
    """Run the program; return its result and problems."""
    ended = run_program(
        words,
        folder=place.work,
        log=place.log,
        timeout_s=settings.timeout_s,
        memory_mb=settings.memory_mb,
        progress=progress,
    )
    if ended.reason == "time":
        message = f"exceeded timeout_s = {settings.timeout_s:g} s; terminated with its child processes"
        return ended, [Problem("command", message)]
    if ended.reason == "memory":
        message = (
            f"used {ended.peak_memory_mb:.0f} MB of memory, more than memory_mb = {settings.memory_mb:g}; "
            "terminated with its child processes"
        )
        return ended, [Problem("command", message)]
    if ended.code:
        return ended, [Problem("command", _describe_return_code(ended.code))]
    return ended, []


def _describe_return_code(code: int) -> str:
    if code > 0:
        return f"ended with exit code {code}"
    try:
        return f"was terminated by signal {signal.Signals(-code).name}"
    except ValueError:
        return f"was terminated by signal {-code}"
