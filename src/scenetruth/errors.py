"""Exceptions and warnings of scenetruth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = [
    "ArgumentError", "BackendUnavailableError", "CaptureError", "CaptureWarning", "CollectedErrors", "DesignSpecError",
    "EstimateError", "EstimateWarning", "ExportError", "MachineError", "MismatchError", "OutputExistsError", "Problem",
    "RecipeError", "RecordingError", "RenderError", "SceneError", "SceneWarning", "ScenetruthError", "ScoreError",
    "StoreError", "visible",
]  # fmt: skip


@dataclass(frozen=True)
class Problem:
    """A single input error: path, message and offending value.

    Parameters
    ----------
    path
        Path inside the input, such as ``objects.0.mesh.file``.
    message
        The problem and its fix.
    value
        The offending value; None if there is none to show.

    See Also
    --------
    SceneError : Lists problems, as other errors with several causes do.

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
    r"""Return a text with control characters and similar escaped, which is safe for a terminal.

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
    """Return the beginning of a value's representation, without computing the rest, which may be endless."""
    text = ""
    for piece in _pieces(value, limit):
        text += piece
        if len(text) > limit:
            return text[: limit - 3] + "..."
    return text


def _pieces(value: Any, limit: int) -> Iterator[str]:
    """Yield the representation of a value in bounded pieces."""
    if isinstance(value, str | bytes):
        # One more than the limit, so that an omission is visible.
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
            # Representations of arrays, for example, may have several lines.
            yield " ".join(repr(value)[: 10 * limit].split())
        except Exception:  # any exception of a foreign class
            yield f"a {type(value).__name__}"


_LONGEST_INTEGER_BITS = 260  # 78 digits


class ScenetruthError(Exception):
    """Base class of the exceptions of scenetruth.

    See Also
    --------
    SceneError, RecordingError, EstimateError, StoreError : Examples of derived exceptions.

    Examples
    --------
    All exceptions of scenetruth are caught by one class; programming errors in the calling code are not:

    >>> import scenetruth as st
    >>> try:
    ...     st.load_scene("no_such_file.yaml")
    ... except st.ScenetruthError as error:
    ...     print(type(error).__name__)
    SceneError
    """


class _ProblemListError(ScenetruthError):
    """An exception that lists all problems of one input."""

    _noun = "input"
    _of = "in"

    def __init__(self, problems: Sequence[Problem], source: str | Path | None = None) -> None:
        self.problems = tuple(problems)
        if not self.problems:
            msg = f"{type(self).__name__} requires at least one problem"
            raise ValueError(msg)
        self.source = None if source is None else str(source)
        super().__init__(self.source, self.problems)

    def __str__(self) -> str:
        count = len(self.problems)
        where = f" {self._of} {visible(self.source, lines=False)}" if self.source else ""
        head = f"{count} problem{'s' if count != 1 else ''} with the {self._noun}{where}:"
        return "\n".join([head, *(f"  - {problem}" for problem in self.problems)])

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.problems, self.source)


class SceneError(_ProblemListError):
    """An invalid scene; lists every problem with its path.

    See Also
    --------
    Problem : Element of its ``problems``.
    scenetruth.load_scene, scenetruth.Scene.from_dict : Raise it.

    Examples
    --------
    All problems are reported together, each with the path of its field:

    >>> import scenetruth as st
    >>> plain = st.load_scene("plane").to_dict()
    >>> plain["camera"]["width"] = -3
    >>> plain["stage"]["baseline_mm"] = "wide"
    >>> try:
    ...     st.Scene.from_dict(plain)
    ... except st.SceneError as error:
    ...     for problem in error.problems:
    ...         print(f"{problem.path}: {problem.value!r}")
    camera.width: -3
    stage.baseline_mm: 'wide'
    """

    _noun = "scene"


class RecipeError(_ProblemListError):
    """An invalid recipe of a data set; lists every problem with its path.

    See Also
    --------
    scenetruth.load_recipe, scenetruth.Recipe.from_dict : Raise it.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     st.Recipe.from_dict({"base": "cube", "samples": 0}).sampler()
    ... except st.RecipeError as error:
    ...     print([problem.path for problem in error.problems])
    ['name', 'samples']
    """

    _noun = "recipe"


class DesignSpecError(RecipeError):
    """An invalid design specification; lists every problem with its path.

    See Also
    --------
    scenetruth.optimise : Raises it.

    Examples
    --------
    >>> from scenetruth.design import DesignSpec
    >>> try:
    ...     DesignSpec.from_dict({"scene": "cube"})
    ... except DesignSpecError as error:
    ...     print("objectives" in [problem.path for problem in error.problems])
    True
    """

    _noun = "design specification"


class CaptureError(_ProblemListError):
    """A folder of real images, or its capture file, that cannot be used; lists every problem with its path.

    See Also
    --------
    scenetruth.read_images, scenetruth.capture.load_capture : Raise it.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     st.read_images("no_such_folder/s{s}_t{t}.png", focal_length_px=500, baseline_mm=5)
    ... except st.CaptureError as error:
    ...     print(error.problems[0].path)
    pattern
    """

    _noun = "capture"


class ArgumentError(_ProblemListError, ValueError):
    """Invalid arguments of a call; lists every problem.

    See Also
    --------
    scenetruth.simulate, scenetruth.run_scene, scenetruth.compare : Raise it.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     st.make_truth("plane", truth_views="al")
    ... except st.ArgumentError as error:
    ...     print(error.problems[0].path, isinstance(error, ValueError))
    truth_views True
    """

    _noun = "arguments"
    _of = "of"


class RecordingError(_ProblemListError):
    """Images or a data set of invalid form.

    See Also
    --------
    scenetruth.make_recording, scenetruth.make_estimate : Raise it.

    Examples
    --------
    Images have the dimensions (s, t, y, x); a single image is rejected:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> try:
    ...     st.make_recording(np.zeros((40, 60)), focal_length_px=500, baseline_mm=5)
    ... except st.RecordingError as error:
    ...     print(error.problems[0].path)
    images
    """

    _noun = "data set"


class EstimateError(_ProblemListError):
    """Settings or a recording that a method cannot use.

    See Also
    --------
    scenetruth.estimate : Raises it.

    Examples
    --------
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((3, 5, 40, 60)), focal_length_px=500, baseline_mm=5)
    >>> try:
    ...     st.estimate(recording, "structure_tensor", window=4)
    ... except st.EstimateError as error:
    ...     print(error.problems[0].path)
    window
    """

    _noun = "estimate"


class ScoreError(_ProblemListError):
    """An estimate and a truth that cannot be compared.

    See Also
    --------
    scenetruth.score, scenetruth.write_report : Raise it.

    Examples
    --------
    The camera of an estimate must be that of the truth:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 1, "baseline_mm": 5}, "frames": {"count": 1}}
    >>> truth = st.make_truth(st.Scene.from_dict(plain))
    >>> recording = st.make_recording(np.zeros((1, 1, 30, 40)), focal_length_px=61, baseline_mm=5)
    >>> try:
    ...     st.score(st.make_estimate(depth=truth.depth, recording=recording), truth, recording)
    ... except st.ScoreError as error:
    ...     print(error.problems[0])
    attrs.focal_length_px: the estimate's 61.0 differs from the truth's 60.0
    """

    _noun = "score"


class ExportError(_ProblemListError):
    """Data sets or options that are invalid for an export format.

    See Also
    --------
    scenetruth.export : Raises it.

    Examples
    --------
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((3, 1, 20, 30)), focal_length_px=500, baseline_mm=5)
    >>> try:
    ...     st.export((recording, None), "gif", output="never_made")
    ... except st.ExportError as error:
    ...     print(error.problems[0].path, error.problems[0].value)
    format gif
    """

    _noun = "export"


class MachineError(_ProblemListError):
    """Insufficient resources, or invalid settings, of the machine.

    See Also
    --------
    scenetruth.Limits : Resource limits.
    scenetruth.run_scene : Raises it before any work.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     st.run_scene(st.load_scene("plane"), output="never_made", limits=st.Limits(memory_gb=0.001))
    ... except st.MachineError as error:
    ...     print(error.problems[0].path)
    memory of render
    """

    _noun = "machine"


class MismatchError(_ProblemListError):
    """Parts of different recordings.

    See Also
    --------
    scenetruth.score, scenetruth.write_report, scenetruth.run_scene : Raise it.

    Examples
    --------
    The check can be disabled, as the message describes:

    >>> print(MismatchError([Problem("truth.zarr", "belongs to another recording")]))
    1 problem with the run:
      - truth.zarr: belongs to another recording
    Use the parts of one run, or allow it (--allow-mismatch, allow_mismatch=True).
    """

    _noun = "run"

    def __str__(self) -> str:
        return super().__str__() + "\nUse the parts of one run, or allow it (--allow-mismatch, allow_mismatch=True)."


class StoreError(ScenetruthError):
    """A store that is missing, foreign, damaged, or not writable.

    Parameters
    ----------
    path
        The store.
    message
        The problem and its fix.

    See Also
    --------
    scenetruth.load_store, scenetruth.open_store, scenetruth.verify : Raise it.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     st.load_store("nowhere/recording.zarr")
    ... except st.StoreError as error:
    ...     print(error.path)
    nowhere/recording.zarr
    """

    def __init__(self, path: str | Path, message: str) -> None:
        self.path = str(path)
        self.message = message
        super().__init__(self.path, message)

    def __str__(self) -> str:
        return f"{visible(self.path, lines=False)}: {visible(self.message)}"


class OutputExistsError(StoreError):
    """An output that exists already and may not be overwritten.

    See Also
    --------
    scenetruth.save_store, scenetruth.simulate, scenetruth.run_scene : Raise it without ``overwrite=True``.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((3, 1, 4, 6)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     try:
    ...         _ = st.save_store(recording, f"{folder}/recording.zarr")
    ...     except st.OutputExistsError as error:
    ...         print(error.message)
    exists already; give another output or --overwrite
    """

    def __init__(self, path: str | Path, message: str = "exists already; give another output or --overwrite") -> None:
        super().__init__(path, message)


class RenderError(ScenetruthError):
    """A failure of the rendering.

    See Also
    --------
    BackendUnavailableError : A backend that is unavailable on this machine.
    scenetruth.simulate : Raises it.

    Examples
    --------
    >>> issubclass(BackendUnavailableError, RenderError)
    True
    """


class BackendUnavailableError(RenderError):
    """A render backend that is unavailable on this machine.

    Parameters
    ----------
    backend
        Its name, with the platform if there is one: ``pyrender (osmesa)``.
    reason
        Reason for the failure.
    remedy
        Remedy.

    See Also
    --------
    scenetruth.simulate : Raises it if the scene specifies a backend (not with ``render.backend: auto``).

    Examples
    --------
    >>> print(BackendUnavailableError("pyrender", "no OpenGL", "render.backend: raycast"))
    render backend pyrender does not run here: no OpenGL. Remedy: render.backend: raycast
    """

    def __init__(self, backend: str, reason: str, remedy: str) -> None:
        self.backend = backend
        self.reason = reason
        self.remedy = remedy
        super().__init__(backend, reason, remedy)

    def __str__(self) -> str:
        return f"render backend {self.backend} does not run here: {self.reason}. Remedy: {self.remedy}"


class SceneWarning(UserWarning):
    """A valid scene with properties that impair its results.

    See Also
    --------
    EstimateWarning : Warns of an estimate.
    scenetruth.simulate, scenetruth.load_scene : Warn with it.

    Examples
    --------
    The filters of Python turn it into an exception, or silence it:

    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", SceneWarning)
    ...     try:
    ...         warnings.warn("0.6 % of the pixels are saturated", SceneWarning)
    ...     except SceneWarning as warning:
    ...         print(warning)
    0.6 % of the pixels are saturated
    """


class EstimateWarning(UserWarning):
    """An estimate with less information than the recording or the method permits.

    See Also
    --------
    SceneWarning : Warns of a scene.
    scenetruth.estimate : Warns with it.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", EstimateWarning)
    ...     warnings.warn("a single frame contains no motion", EstimateWarning)
    >>> [str(one.message) for one in caught]
    ['a single frame contains no motion']
    """


class CaptureWarning(UserWarning):
    """Real images that can be used, but are incomplete or impaired.

    See Also
    --------
    SceneWarning : Warns of a scene.
    scenetruth.read_images : Warns with it.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", CaptureWarning)
    ...     warnings.warn("s1_t0.png: is missing", CaptureWarning)
    >>> [str(one.message) for one in caught]
    ['s1_t0.png: is missing']
    """


class CollectedErrors:
    """Errors of independent checks, which are raised together.

    >>> found = CollectedErrors()
    >>> for name in ("workers", "seeds"):
    ...     with found.collect():
    ...         raise ArgumentError([Problem(name, "must be positive")])
    >>> found.raise_all()
    Traceback (most recent call last):
    ...
    scenetruth.errors.ArgumentError: 2 problems with the arguments:
      - workers: must be positive
      - seeds: must be positive
    """

    def __init__(self) -> None:
        self._errors: list[_ProblemListError] = []

    def __bool__(self) -> bool:
        return bool(self._errors)

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Collect the error of a check, if it has one."""
        try:
            yield
        except _ProblemListError as error:
            self._errors.append(error)

    def raise_all(self) -> None:
        """Raise the collected errors as one: of their class if it is common to all, otherwise an `ArgumentError`."""
        if not self._errors:
            return
        if len(self._errors) == 1:
            raise self._errors[0]
        kinds, sources = {type(each) for each in self._errors}, {each.source for each in self._errors}
        kind = kinds.pop() if len(kinds) == 1 else ArgumentError
        source = sources.pop() if len(sources) == 1 else None
        problems = [
            each if source is not None or error.source is None or not isinstance(error, SceneError)
            else Problem(f"{error.source}: {each.path or '(top level)'}", each.message, each.value)
            for error in self._errors
            for each in error.problems
        ]  # fmt: skip
        raise kind(problems, source=source)
