"""The exceptions and warnings of scenetruth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = [
    "ArgumentError",
    "BackendUnavailableError",
    "DesignSpecError",
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

    See Also
    --------
    SceneError : Holds them as ``problems``, as other errors with several causes do.

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
    """Base of every error that scenetruth raises on purpose.

    See Also
    --------
    SceneError, RecordingError, EstimateError, StoreError : Some of the errors that derive from it.

    Examples
    --------
    What goes wrong on purpose is caught by one name; slips in the calling code are not:

    >>> import scenetruth as st
    >>> try:
    ...     st.load_scene("no_such_file.yaml")
    ... except st.ScenetruthError as error:
    ...     print(type(error).__name__)
    SceneError
    """


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
    """A scene that cannot be made; lists every problem with its path.

    See Also
    --------
    Problem : One of its ``problems``.
    scenetruth.load_scene, scenetruth.Scene.from_dict : Raise it.

    Examples
    --------
    All that is wrong is told at once, each with the path of its field:

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
    """A recipe of a data set that cannot be followed; lists every problem with its path.

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
    """A design specification that cannot be followed; lists every problem with its path.

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


class ArgumentError(_ProblemListError, ValueError):
    """Arguments of a call that are impossible; lists every one.

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

    _noun = "call"


class RecordingError(_ProblemListError):
    """Images, or a data set, that do not have the agreed form.

    See Also
    --------
    scenetruth.make_recording, scenetruth.make_estimate : Raise it.

    Examples
    --------
    Images are stacked as (s, t, y, x); a single one is not:

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
    """Settings or a recording that the estimator cannot work with.

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
    """Data sets, or options, from which a format cannot be written.

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
    """What the machine, its memory or its settings, does not allow.

    See Also
    --------
    scenetruth.Limits : What may be taken of the machine.
    scenetruth.run_scene : Raises it, before any work.

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
    """Parts that were made from different recordings.

    See Also
    --------
    scenetruth.score, scenetruth.write_report, scenetruth.run_scene : Raise it.

    Examples
    --------
    Whoever knows better may allow it, as its message says:

    >>> print(MismatchError([Problem("truth.zarr", "belongs to another recording")]))
    1 problem with the run:
      - truth.zarr: belongs to another recording
    Use the parts of one run, or allow it (--allow-mismatch, allow_mismatch=True).
    """

    _noun = "run"

    def __str__(self) -> str:
        return super().__str__() + "\nUse the parts of one run, or allow it (--allow-mismatch, allow_mismatch=True)."


class StoreError(ScenetruthError):
    """A store that is missing, not ours, damaged, or cannot be written.

    Parameters
    ----------
    path
        The store.
    message
        What is wrong with it and how to mend it.

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
    scenetruth.save_store, scenetruth.simulate, scenetruth.run_scene : Raise it; ``overwrite=True`` allows to replace.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((3, 1, 4, 6)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     st.save_store(recording, f"{folder}/recording.zarr")
    ...     try:
    ...         st.save_store(recording, f"{folder}/recording.zarr")
    ...     except st.OutputExistsError as error:
    ...         print(error.message)
    exists already; give another output or --overwrite
    """

    def __init__(self, path: str | Path, message: str = "exists already; give another output or --overwrite") -> None:
        super().__init__(path, message)


class RenderError(ScenetruthError):
    """A render that failed.

    See Also
    --------
    BackendUnavailableError : A backend that does not run here.
    scenetruth.simulate : Raises it.

    Examples
    --------
    >>> issubclass(BackendUnavailableError, RenderError)
    True
    """


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

    See Also
    --------
    scenetruth.simulate : Raises it, unless the scene leaves the choice of the backend open (``render.backend: auto``).

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
    """A scene that can be made but will hardly serve its purpose.

    See Also
    --------
    EstimateWarning : Warns of an estimate.
    scenetruth.simulate, scenetruth.load_scene : Warn with it.

    Examples
    --------
    Python's own filters make an error of it, or silence it:

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
    """An estimate that says less than the recording could tell.

    See Also
    --------
    SceneWarning : Warns of a scene.
    scenetruth.estimate : Warns with it.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", EstimateWarning)
    ...     warnings.warn("a single frame tells no motion", EstimateWarning)
    >>> [str(one.message) for one in caught]
    ['a single frame tells no motion']
    """
