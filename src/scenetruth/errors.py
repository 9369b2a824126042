"""The exception hierarchy; every exception carries the values that offended."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = [
    "BackendUnavailableError",
    "EstimateError",
    "EstimateWarning",
    "ExportError",
    "MachineError",
    "MismatchError",
    "OutputExistsError",
    "Problem",
    "RecipeError",
    "RecordingError",
    "RenderError",
    "SceneError",
    "SceneWarning",
    "ScenetruthError",
    "ScoreError",
    "StoreError",
    "visible",
]


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with an input.

    Parameters
    ----------
    path
        Where it is, inside the input: ``objects.0.mesh.file``.
    message
        What is wrong and how to mend it.
    value
        The offending value, if there is one to show.

    Examples
    --------
    >>> print(Problem("camera.width", "must be positive", -3))
    camera.width: must be positive (got -3)
    >>> print(SceneError([Problem("objects", "are missing")], source="cube.yaml"))
    1 problem with the scene in cube.yaml:
      - objects: are missing
    """

    path: str
    message: str
    value: Any = None

    def __str__(self) -> str:
        shown = "" if self.value is None else f" (got {_shorten(self.value)})"
        path = self.path if len(self.path) <= _LONGEST_PATH else f"{self.path[:_LONGEST_PATH]}..."
        return f"{visible(path, lines=False) or '(top level)'}: {visible(self.message)}{shown}"


_LONGEST_PATH = 400


def visible(text: str, *, lines: bool = True) -> str:
    r"""Return a text in which nothing can act on a terminal: control characters and the like are spelled out.

    Parameters
    ----------
    text
        Any text, from whatever file.
    lines
        Whether line ends stay as they are.

    Examples
    --------
    >>> print(visible("red: \x1b[31m, backwards: \u202e, half a character: \udc80"))
    red: \x1b[31m, backwards: \u202e, half a character: \udc80
    """
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() or (lines and character == "\n") else repr(character)[1:-1]
        for character in text
    )


def _shorten(value: Any, limit: int = 80) -> str:
    """Return the beginning of a value's representation, without making the rest, which may be endless."""
    text = ""
    for piece in _pieces(value, limit):
        text += piece
        if len(text) > limit:
            return text[: limit - 3] + "..."
    return text


def _pieces(value: Any, limit: int) -> Iterator[str]:
    """Yield the representation of a value bit by bit; each bit is bounded."""
    if isinstance(value, str | bytes):
        # One more than fits, so that what is left out shows.
        yield repr(value[: limit + 1])
    elif isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > _LONGEST_INTEGER_BITS:
        yield f"an integer of {value.bit_length()} bits"
    elif isinstance(value, Mapping):
        yield "{"
        for number, (key, item) in enumerate(value.items()):
            yield ", " if number else ""
            yield from _pieces(key, limit)
            yield ": "
            yield from _pieces(item, limit)
        yield "}"
    elif isinstance(value, list | tuple | set | frozenset):
        opening, closing = "[]" if isinstance(value, list) else "()" if isinstance(value, tuple) else "{}"
        yield opening
        for number, item in enumerate(value):
            yield ", " if number else ""
            yield from _pieces(item, limit)
        yield f",{closing}" if isinstance(value, tuple) and len(value) == 1 else closing
    else:
        try:
            # What makes its own representation may make several lines, as arrays do.
            yield " ".join(repr(value)[: 10 * limit].split())
        except Exception:  # whatever a foreign class raises
            yield f"a {type(value).__name__}"


_LONGEST_INTEGER_BITS = 260  # 78 digits


class ScenetruthError(Exception):
    """Base of every error that scenetruth raises on purpose."""


class _ProblemListError(ScenetruthError):
    """An error that reports all problems of one input at once."""

    _noun = "input"

    def __init__(self, problems: Sequence[Problem], source: str | Path | None = None) -> None:
        self.problems = tuple(problems)
        self.source = None if source is None else str(source)
        super().__init__(self.source, self.problems)

    def __str__(self) -> str:
        count = len(self.problems)
        where = f" in {visible(self.source, lines=False)}" if self.source else ""
        head = f"{count} problem{'s' if count != 1 else ''} with the {self._noun}{where}:"
        return "\n".join([head, *(f"  - {problem}" for problem in self.problems)])

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.problems, self.source)


class SceneError(_ProblemListError):
    """A scene that cannot be made; lists every problem with its path."""

    _noun = "scene"


class RecipeError(_ProblemListError):
    """A recipe of a data set that cannot be followed; lists every problem with its path."""

    _noun = "recipe"


class RecordingError(_ProblemListError):
    """Images, or a data set, that do not have the agreed form."""

    _noun = "data set"


class EstimateError(_ProblemListError):
    """Settings or a recording that the estimator cannot work with."""

    _noun = "estimate"


class ScoreError(_ProblemListError):
    """An estimate and a truth that cannot be compared."""

    _noun = "score"


class ExportError(_ProblemListError):
    """Data sets, or options, from which a format cannot be written."""

    _noun = "export"


class MachineError(_ProblemListError):
    """What the machine, its memory or its settings, does not allow."""

    _noun = "machine"


class MismatchError(_ProblemListError):
    """Parts that were made from different recordings."""

    _noun = "run"

    def __str__(self) -> str:
        return super().__str__() + "\nUse the parts of one run, or allow it (--allow-mismatch, check=False)."


class StoreError(ScenetruthError):
    """A store that is missing, not ours, damaged, or cannot be written.

    Parameters
    ----------
    path
        The store.
    message
        What is wrong with it and how to mend it.
    """

    def __init__(self, path: str | Path, message: str) -> None:
        self.path = str(path)
        self.message = message
        super().__init__(self.path, message)

    def __str__(self) -> str:
        return f"{visible(self.path, lines=False)}: {visible(self.message)}"


class OutputExistsError(StoreError):
    """An output that exists already and may not be overwritten."""

    def __init__(self, path: str | Path, message: str = "exists already; give another output or --overwrite") -> None:
        super().__init__(path, message)


class RenderError(ScenetruthError):
    """A render that failed."""


class BackendUnavailableError(RenderError):
    """A render backend that this machine cannot run.

    Parameters
    ----------
    backend
        Its name, with the platform where there is one: ``pyrender (osmesa)``.
    reason
        Why it does not run here.
    remedy
        What would make it run.
    """

    def __init__(self, backend: str, reason: str, remedy: str) -> None:
        self.backend = backend
        self.reason = reason
        self.remedy = remedy
        super().__init__(backend, reason, remedy)

    def __str__(self) -> str:
        return f"render backend {self.backend} does not run here: {self.reason}. Remedy: {self.remedy}"


class SceneWarning(UserWarning):
    """A scene that can be made but will hardly serve its purpose."""


class EstimateWarning(UserWarning):
    """An estimate that says less than the recording could tell."""
