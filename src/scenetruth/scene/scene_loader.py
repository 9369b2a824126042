"""Loading and validation of scene files in YAML, with a report of every problem."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from scenetruth.errors import EstimateError, Problem, SceneError
from scenetruth.estimators import choose
from scenetruth.input_files import bundled_file, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.suggestions import suggest_key, suggest_setting
from scenetruth.scene.yaml_reader import MAX_YAML_BYTES, InputProblemError, read_file, read_yaml
from scenetruth.validation_problems import list_problems, suggest_word

__all__ = ["Overrides", "SceneLike", "apply_overrides", "load_scene", "read_input"]


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
    if isinstance(scene, Scene) and not overrides:
        return scene
    given = scene.to_dict() if isinstance(scene, Scene) else scene
    plain, source, folder = read_input(given, "a scene file", SceneError, overrides=overrides)
    return Scene.from_dict(plain, source=source, folder=folder)


def read_input(
    given: Any, what: str, refused: InputProblemError, *, within: str = ".", overrides: Overrides = ()
) -> tuple[Any, str | Path | None, Path | None]:
    """Return the values of a scene, recipe or specification given as a mapping, path or name."""
    if isinstance(given, Mapping):
        # Overrides apply to this copy only.
        plain, source, folder = copy.deepcopy(dict(given)) if overrides else given, None, None
    else:
        source = bundled_file(given, within=within) or given
        plain, folder = read_file(source, what, refused)
    if overrides and isinstance(plain, dict):
        apply_overrides(plain, overrides, source=source, refused=refused)
    return plain, source, folder


_MAPPING = "a mapping of camera, stage, frames, objects, ..."


def _read_scene(plain: Any, source: str | Path | None = None, folder: Path | None = None) -> Scene:
    """Validate a scene given by its values, see `Scene.from_dict`."""
    if plain is None:
        raise SceneError([Problem("", f"is empty; it must be {_MAPPING}")], source=source)
    if not isinstance(plain, Mapping):
        raise SceneError([Problem("", f"must be {_MAPPING}", plain)], source=source)
    problems = plain_problems(plain)
    if problems:
        raise SceneError(problems, source=source)
    validated = dict(plain)
    if "estimate" in plain:
        try:
            validated["estimate"] = choose(plain["estimate"], from_file=True)
        except EstimateError as error:
            # Problems of method settings are reported per field, together with all others.
            del validated["estimate"]
            problems += [_in_estimate(problem) for problem in error.problems]
    try:
        scene = Scene.model_validate(validated, context=validation_context(folder))
    except ValidationError as error:
        raise SceneError([*list_problems(error, plain, model=Scene, words=_words), *problems], source=source) from error
    if problems:
        raise SceneError(problems, source=source)
    return scene


Scene._reader = _read_scene


def apply_overrides(
    plain: dict[str, Any],
    overrides: Overrides,
    source: str | Path | None = None,
    refused: InputProblemError = SceneError,
) -> None:
    """Apply overrides in place, by path or by ``path=value`` assignments."""
    problems = []
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(overrides, Mapping):
        for path, value in overrides.items():
            problem = _assign(plain, str(path).split("."), copy.deepcopy(value))
            if problem is not None:
                problems.append(Problem(f"overrides.{path}", problem, value))
        overrides = ()
    for override in overrides:
        if not isinstance(override, str):
            problems.append(Problem("--set", "must have the form path=value", override))
            continue
        path, separator, text = override.partition("=")
        keys = path.strip().split(".")
        if not separator or not all(keys):
            problems.append(Problem("--set", "must have the form path=value, such as camera.width=320", override))
            continue
        if len(text) > MAX_YAML_BYTES:
            problems.append(Problem("--set", f"value must have at most {MAX_YAML_BYTES:,} characters", override))
            continue
        value, wrong = read_yaml(text)
        if wrong:
            problems += [
                Problem(f"--set {'.'.join(filter(None, (path, item.path)))}", f"value, {item.message}", item.value)
                for item in wrong
            ]
            continue
        problem = _assign(plain, keys, value)
        if problem is not None:
            problems.append(Problem(f"--set {path}", problem, override))
    if problems:
        raise refused(problems, source=source)


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
