"""Loading and validation of scene files in YAML, with a report of every problem."""

from __future__ import annotations

import copy
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from scenetruth.errors import EstimateError, Problem, SceneError, SceneWarning
from scenetruth.estimators import DEFAULT_METHOD, choose
from scenetruth.input_files import bundled_file, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene.field_paths import METHOD, PathError, assign, drop_settings, expand, order_paths
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.scene_repair import SceneRemainder, find_remainder
from scenetruth.scene.suggestions import suggest_key, suggest_setting
from scenetruth.scene.yaml_reader import MAX_YAML_BYTES, InputProblemError, read_file, read_yaml
from scenetruth.validation_problems import keys_in, list_problems, suggest_word

__all__ = [
    "ChangedScene", "Overrides", "SceneLike", "SceneReading", "apply_overrides", "change_scene",
    "join_override_problems", "load_scene", "override", "part_of", "read_input", "read_scene", "validate_scene",
]  # fmt: skip


SceneLike = Scene | Mapping[str, Any] | str | PathLike[str]
"""A scene, its values as in a file, the path of its file, or the name of a bundled scene."""
Overrides = Mapping[str, Any] | Sequence[str]
"""Overrides of fields: values by path, or assignments ``path=value`` with the value in YAML."""


def load_scene(scene: SceneLike, *, overrides: Overrides = ()) -> Scene:
    """Load a scene.

    Parameters
    ----------
    scene
        Path of a YAML file, or the name of a bundled scene such as ``"cube"`` if no such file exists. Relative paths in
        the file refer to its directory. Also accepts a mapping of values, or a scene.
    overrides
        Overrides of fields: values by path, or assignments ``path=value`` with the value in YAML: ``camera.width=320``,
        ``sensor=ideal``, ``objects.0.texture.rms_contrast=0.1``.

    Returns
    -------
    Scene
        Validated and immutable; paths of mesh and image files are absolute.

    Raises
    ------
    SceneError
        If the file cannot be read or its content is invalid; lists every problem.

    See Also
    --------
    Scene.from_dict : Create a scene from values.
    simulate : Simulate images and ground truth of a scene.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> text = '''
    ... camera: {width: 40, height: 30, focal_length_px: 60}
    ... stage: {positions: 3, baseline_mm: 5}
    ... frames: {count: 2}
    ... objects:
    ...   - name: wall
    ...     mesh: {kind: plane, size_mm: [90, 90]}
    ...     texture: {kind: uniform}
    ...     pose: {position_mm: [0, 0, 100]}
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "wall.yaml").write_text(text)
    ...     load_scene(f"{folder}/wall.yaml", overrides=["camera.width=80", "render.backend=raycast"])
    Scene(80 x 30 px; 3 positions x 2 frames; objects: wall)
    >>> load_scene("plane", overrides={"camera.width": 80}).camera.width
    80
    """
    return read_scene(scene, overrides=overrides).required()


@dataclass(frozen=True, eq=False)
class SceneReading:
    """A scene, or its problems.

    ``remainder``: Valid part of an invalid scene, in which further problems can be detected; None if there is none.
    """

    scene: Scene | None
    problems: tuple[Problem, ...] = ()
    source: str | Path | None = None
    remainder: SceneRemainder | None = None

    @property
    def valid_part(self) -> Scene | None:
        """The scene, or the valid part of an invalid scene."""
        if self.problems:
            return None if self.remainder is None else self.remainder.scene
        return self.scene

    def required(self) -> Scene:
        """Return the scene, or raise an error with all problems."""
        if self.scene is None or self.problems:
            raise SceneError(self.problems, source=self.source)
        return self.scene


def read_scene(scene: SceneLike, *, overrides: Overrides = ()) -> SceneReading:
    """Read a scene as `load_scene` does, without an error for a scene that is invalid."""
    if isinstance(scene, Scene) and not overrides:
        return SceneReading(scene)
    given = scene.to_dict() if isinstance(scene, Scene) else scene
    plain, source, folder = read_input(given, "a scene file", SceneError)
    plain, wrong = override(plain, overrides)
    reading = validate_scene(plain, source, folder)
    if not wrong:
        return reading
    remainder = reading.remainder or (None if reading.scene is None else SceneRemainder(reading.scene, frozenset()))
    return SceneReading(None, tuple(join_override_problems(wrong, reading.problems)), source, remainder)


def join_override_problems(wrong: Mapping[str, Sequence[Problem]], found: Sequence[Problem]) -> list[Problem]:
    """Return the problems of overrides that were not applied, and those of fields that they might not have corrected.

    ``wrong``: Problems of overrides by path. ``found``: Problems of the input.
    """
    others = [each for each in found if not any(_are_nested(each.path, path) for path in wrong)]
    return [*(problem for each in wrong.values() for problem in each), *others]


def _are_nested(one: str, other: str) -> bool:
    """Return whether one of two paths leads to the other."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")


@dataclass(frozen=True, eq=False)
class ChangedScene:
    """A scene with changes, None if it has no valid part, and its problems.

    ``problems``: Problems of the scene, then those of the changed scene. ``misplaced``: Problems of changes, by path.
    ``wrong``: Parts with problems, see `part_of`.
    """

    scene: Scene | None
    problems: tuple[Problem, ...]
    misplaced: tuple[Problem, ...]
    wrong: frozenset[str]


def part_of(path: str) -> str:
    """Return the part of a scene into which a path leads: a section, or an object or plant."""
    first, *rest = path.split(".")
    return ".".join([first, *rest[:1]]) if first in ("objects", "plants") else first


def change_scene(reading: SceneReading, changes: Mapping[str, Any], folder: Path | None = None) -> ChangedScene:
    """Return a scene with changes by path, and all problems of both; ``folder``: Directory of files in the changes."""
    scene, problems = reading.valid_part, list(reading.problems)
    wrong, misplaced = {part_of(each.path) for each in problems}, list[Problem]()
    if scene is None or not changes:
        return ChangedScene(scene, tuple(problems), (), frozenset(wrong))
    plain = scene.to_dict()
    for path in order_paths(changes):
        value = changes[path]
        try:
            for field in expand(plain, path):
                assign(plain, field, value)
        except PathError as error:
            if part_of(path) not in wrong:
                misplaced.append(Problem(path, str(error), value))
    wrong |= {part_of(each.path) for each in misplaced}
    changed = validate_scene(plain, folder=folder)
    problems += [each for each in changed.problems if part_of(each.path) not in wrong]
    wrong |= {part_of(each.path) for each in changed.problems}
    return ChangedScene(changed.valid_part or scene, tuple(problems), tuple(misplaced), frozenset(wrong))


def read_input(
    given: Any, what: str, refused: InputProblemError, *, within: str = "."
) -> tuple[Any, str | Path | None, Path | None]:
    """Return the values of a scene, recipe or specification given as a mapping, path or name."""
    if isinstance(given, Mapping):
        return given, None, None
    source = bundled_file(given, within=within) or given
    plain, folder = read_file(source, what, refused)
    return plain, source, folder


def override(plain: Any, overrides: Overrides) -> tuple[Any, dict[str, list[Problem]]]:
    """Return a copy of values with overrides, and the problems of those that cannot be applied, by path."""
    if not overrides or not isinstance(plain, Mapping):
        return plain, {}
    changed = copy.deepcopy(dict(plain))
    return changed, _override(changed, overrides)


_MAPPING = "a mapping of camera, stage, frames, objects, ..."


def validate_scene(plain: Any, source: str | Path | None = None, folder: Path | None = None) -> SceneReading:
    """Validate a scene given by its values."""
    if plain is None:
        return SceneReading(None, (Problem("", f"is empty; it must be {_MAPPING}"),), source)
    if not isinstance(plain, Mapping):
        return SceneReading(None, (Problem("", f"must be {_MAPPING}", plain),), source)
    problems = plain_problems(plain)
    if problems:
        return SceneReading(None, tuple(problems), source)
    validated = dict(plain)
    if "estimate" in plain:
        try:
            validated["estimate"] = choose(plain["estimate"], from_file=True)
        except EstimateError as error:
            # Problems of method settings are reported per field, together with all others.
            del validated["estimate"]
            problems += [_in_estimate(problem) for problem in error.problems]

    def validate(values: Mapping[str, Any]) -> Scene:
        return Scene.model_validate(values, context=validation_context(folder))

    try:
        scene = validate(validated)
    except ValidationError as error:
        remainder, hidden = find_remainder(validated, error, validate, _keys_in)
        found = _list_problems(error, plain)
        for values, entries in hidden:
            for entry in entries:
                if isinstance(entry["input"], Mapping):
                    # As given, without replaced values.
                    entry["input"] = _value_at(plain, _keys_in(values, entry))
            found += [each for each in _list_problems(entries, values) if each not in found]
        return SceneReading(None, (*found, *problems), source, remainder)
    remainder = SceneRemainder(scene, frozenset()) if problems else None
    return SceneReading(scene, tuple(problems), source, remainder)


def _value_at(plain: Any, keys: Sequence[str]) -> Any:
    """Return the value at a path; None if there is none."""
    for key in keys:
        listed = list(plain) if isinstance(plain, list | tuple) else None
        inside = {str(index): item for index, item in enumerate(listed)} if listed is not None else plain
        plain = inside.get(key) if isinstance(inside, Mapping) else None
    return plain


def _read_scene(plain: Any, source: str | Path | None = None, folder: Path | None = None) -> Scene:
    """Validate a scene given by its values, see `Scene.from_dict`."""
    return validate_scene(plain, source, folder).required()


Scene._reader = _read_scene


def apply_overrides(plain: dict[str, Any], overrides: Overrides) -> None:
    """Apply overrides in place, by path or by ``path=value`` assignments."""
    wrong = _override(plain, overrides)
    if wrong:
        raise SceneError([problem for each in wrong.values() for problem in each])


def _override(plain: dict[str, Any], overrides: Overrides) -> dict[str, list[Problem]]:
    """Apply overrides in place, and return the problems of those that are wrong, by their paths."""
    wrong: dict[str, list[Problem]] = {}
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(overrides, Mapping):
        paths = [str(path) for path in overrides]
        for path, value in overrides.items():
            _change_method(plain, str(path), value, paths)
            problem = _assign(plain, str(path).split("."), copy.deepcopy(value))
            if problem is not None:
                wrong.setdefault(str(path), []).append(Problem(f"overrides.{path}", problem, value))
        return wrong
    paths = [str(override).partition("=")[0].strip() for override in overrides]
    for override in overrides:
        if not isinstance(override, str):
            wrong.setdefault(_NOWHERE, []).append(Problem("--set", "must have the form path=value", override))
            continue
        path, separator, text = override.partition("=")
        keys = path.strip().split(".")
        problems = wrong.setdefault(path.strip() if separator and all(keys) else _NOWHERE, [])
        if not separator or not all(keys):
            problems.append(Problem("--set", "must have the form path=value, such as camera.width=320", override))
            continue
        if len(text) > MAX_YAML_BYTES:
            problems.append(Problem("--set", f"value must have at most {MAX_YAML_BYTES:,} characters", override))
            continue
        value, unread = read_yaml(text)
        if unread:
            problems += [
                Problem(f"--set {'.'.join(filter(None, (path, item.path)))}", f"value, {item.message}", item.value)
                for item in unread
            ]
            continue
        _change_method(plain, ".".join(keys), value, paths)
        problem = _assign(plain, keys, value)
        if problem is not None:
            problems.append(Problem(f"--set {path}", problem, override))
    return {path: problems for path, problems in wrong.items() if problems}


def _change_method(plain: dict[str, Any], path: str, method: Any, paths: Sequence[str]) -> None:
    """Drop the settings of the scene's method before an override with another; ``paths``: paths of all overrides."""
    section = METHOD.partition(".")[0]
    if path != METHOD or section in paths:
        return
    kept = {each.split(".")[1] for each in paths if each.startswith(f"{section}.")}
    dropped = drop_settings(plain, method, kept)
    if dropped:
        former, names = plain[section].get("method", DEFAULT_METHOD), ", ".join(dropped)
        message = f"{METHOD}: the settings of '{former}' in the scene do not apply to '{method}': {names} ignored"
        warnings.warn(message, SceneWarning, stacklevel=_CALLER)


_CALLER = 6  # frames between the warning and the caller of `load_scene`
_NOWHERE = "--set"  # in place of the path of an override without one
_INDEX = re.compile(r"-?[0-9]{1,9}", re.ASCII)  # at most nine ASCII digits


def _assign(target: Any, keys: list[str], value: Any) -> str | None:
    keys = _joined_keys(target, keys)
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        if isinstance(target, list):
            if not _INDEX.fullmatch(key) or not -len(target) <= int(key) < len(target):
                return f"'{'.'.join(keys[:depth])}' is a list of {len(target)}; '{key}' is not an index of it"
            if last:
                target[int(key)] = value
            else:
                target = target[int(key)]
        elif isinstance(target, dict):
            if last:
                target[key] = value
            else:
                if target.get(key) is None:
                    target[key] = {}
                target = target[key]
        else:
            return f"'{'.'.join(keys[:depth])}' is {_brief(target)} and has no fields"
    return None


def _joined_keys(target: Any, keys: list[str]) -> list[str]:
    """Return keys with parts joined to keys that contain dots, as in recipes and designs."""
    joined: list[str] = []
    start = 0
    while start < len(keys) and isinstance(target, dict):
        # Iterate over the keys of the mapping, to avoid quadratic time in the path length.
        known = [each.split(".") for each in target if isinstance(each, str)]
        parts = max((each for each in known if keys[start : start + len(each)] == each), key=len, default=[keys[start]])
        joined.append(".".join(parts))
        start += len(parts)
        target = target.get(joined[-1])
    return joined + keys[start:]


def _brief(value: Any) -> str:
    return repr(value) if not isinstance(value, str) or len(value) <= 40 else repr(value[:40] + "...")


def _in_estimate(problem: Problem) -> Problem:
    """Return a problem of method settings as a problem of the scene."""
    message = problem.message
    if message.startswith("unknown setting"):
        message += suggest_setting(problem.path)
    elif message.startswith("input should be '"):
        message += suggest_word(problem.value, re.findall(r"'([^']*)'", message))
    return Problem(".".join(filter(None, ("estimate", problem.path))), message, problem.value)


def _list_problems(error: ValidationError | Sequence[ErrorDetails], values: Mapping[str, Any]) -> list[Problem]:
    return list_problems(error, values, model=Scene, words=_words)


def _keys_in(values: Mapping[str, Any], entry: ErrorDetails) -> list[str]:
    return keys_in(values, entry["loc"], entry["type"], Scene)


def _words(entry: ErrorDetails, path: str) -> str | None:
    """Return the message of a problem that only scenes have."""
    message, value = entry["msg"].removeprefix("Value error, "), entry.get("input")
    match entry["type"]:
        case "extra_forbidden":
            return "unknown key" + suggest_key(entry["loc"])
        case "missing":
            return None
        case _ if path == "format":
            return "unsupported format of scene files; this scenetruth version reads format 1: update scenetruth"
        case "bands" | "value_error" if path == "sensor":
            return message
        case _ if path == "sensor":
            named = value.get("kind") if isinstance(value, dict) else value
            kinds = ["ideal", "gaussian", "emva1288", "chain"]
            remedy = "must be 'ideal', or a mapping with `kind` gaussian (the default), emva1288 or chain"
            return f"{remedy} and its fields{suggest_word(named, kinds)}"
    return None
