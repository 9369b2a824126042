"""Loading of scene files: YAML in, a validated scene out, with every problem named."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from scenetruth.errors import EstimateError, Problem, RecipeError, SceneError
from scenetruth.estimators import choose
from scenetruth.input_files import bundled_file, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.suggestions import collect_keys, list_kinds, suggest_key, suggest_setting, suggest_word
from scenetruth.scene.yaml_reader import MAX_YAML_BYTES, read_file, read_yaml

__all__ = ["Overrides", "SceneLike", "apply_overrides", "load_scene", "read_input"]


SceneLike = Scene | Mapping[str, Any] | str | PathLike[str]
"""A scene, its values as in a file, the path of its file, or the name of a scene that is shipped."""
Overrides = Mapping[str, Any] | Sequence[str]
"""Changes of fields: values by path, or assignments ``path=value`` with the value in YAML."""

InputProblemError = type[SceneError] | type[RecipeError]


def load_scene(scene: SceneLike, *, overrides: Overrides = ()) -> Scene:
    """Load a scene.

    Parameters
    ----------
    scene
        The YAML file, or the name of a scene that is shipped, as ``"cube"``, if no file has it. Relative paths in it
        count from its folder. Also the values of a scene as a mapping, or a scene.
    overrides
        Changes to apply first: values by path, or assignments ``path=value`` with the value in YAML:
        ``camera.width=320``, ``sensor=ideal``, ``objects.0.texture.rms_contrast=0.1``.

    Returns
    -------
    Scene
        Validated and frozen; paths of mesh and image files are absolute.

    Raises
    ------
    SceneError
        If the file cannot be read, or with every problem that its content has.

    See Also
    --------
    Scene.from_dict : A scene from its values.
    simulate : Images and truth of a scene.

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
    """Return the values of a scene, a recipe or a specification that is given as a mapping, a path or a name."""
    if isinstance(given, Mapping):
        # Changes are for this copy alone.
        plain, source, folder = copy.deepcopy(dict(given)) if overrides else given, None, None
    else:
        source = bundled_file(given, within=within) or given
        plain, folder = read_file(source, what, refused)
    if overrides and isinstance(plain, dict):
        apply_overrides(plain, overrides, source=source, refused=refused)
    return plain, source, folder


_MAPPING = "a mapping of camera, stage, frames, objects, ..."


def _read_scene(plain: Any, source: str | Path | None = None, folder: Path | None = None) -> Scene:
    """Validate a scene given by its values; see `Scene.from_dict`."""
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
            # What is wrong inside the settings of a method is told field by field, with all else.
            del validated["estimate"]
            problems += [_in_estimate(problem) for problem in error.problems]
    try:
        scene = Scene.model_validate(validated, context=validation_context(folder))
    except ValidationError as error:
        raise SceneError([*_problems_of(error, plain), *problems], source=source) from error
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
    """Change values in place, by path or by ``path=value`` assignments."""
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
            problems.append(Problem("--set", "must read path=value", override))
            continue
        path, separator, text = override.partition("=")
        keys = path.strip().split(".")
        if not separator or not all(keys):
            problems.append(Problem("--set", "must read path=value, as camera.width=320", override))
            continue
        if len(text) > MAX_YAML_BYTES:
            problems.append(Problem("--set", f"a value has at most {MAX_YAML_BYTES:,} characters", override))
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


# No list has more items than nine digits can count, and other alphabets have digits too.
_INDEX = re.compile(r"-?[0-9]{1,9}", re.ASCII)


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
    """Return keys with those joined that are a single key of a mapping: of recipes and designs, some hold dots."""
    joined: list[str] = []
    start = 0
    while start < len(keys) and isinstance(target, dict):
        # Of the mapping's own keys, so that the time does not grow with the square of the path's length.
        known = [each.split(".") for each in target if isinstance(each, str)]
        parts = max((each for each in known if keys[start : start + len(each)] == each), key=len, default=[keys[start]])
        joined.append(".".join(parts))
        start += len(parts)
        target = target.get(joined[-1])
    return joined + keys[start:]


def _brief(value: Any) -> str:
    return repr(value) if not isinstance(value, str) or len(value) <= 40 else repr(value[:40] + "...")


def _in_estimate(problem: Problem) -> Problem:
    """Return a problem of the settings of a method as one of the scene."""
    message = problem.message
    if message.startswith("unknown setting"):
        message += suggest_setting(problem.path)
    elif message.startswith("input should be '"):
        message += suggest_word(problem.value, message)
    return Problem(".".join(filter(None, ("estimate", problem.path))), message, problem.value)


def _problems_of(error: ValidationError, plain: Mapping[str, Any]) -> list[Problem]:
    found: dict[tuple[str, str], tuple[str, Problem]] = {}
    entries = error.errors(include_url=False)
    for entry in entries[:_MAX_PROBLEMS]:
        path = _path_in(plain, entry["loc"], entry["type"])
        message, value = _message_of(entry, path), entry.get("input")
        # Of what is not there, nothing can be shown.
        shown = None if entry["type"] == "missing" or value in ((), []) else value
        problem = Problem(path, message[:1].lower() + message[1:], shown)
        found.setdefault((path, problem.message), (entry["type"], problem))
    problems = _joined(list(found.values()))
    if any(entry["type"] == "missing" or entry.get("input") in ((), []) for entry in entries):
        # What is missing may stand there under a wrong name, which is what is to be mended.
        problems.sort(key=lambda one: "." in one.path or not one.message.startswith("unknown key; did you mean"))
    if len(entries) > _MAX_PROBLEMS:
        problems.append(Problem("", f"{len(entries) - _MAX_PROBLEMS:,} more problems are not told; mend these first"))
    return problems


# Each is told with what may have been meant, which takes some milliseconds.
_MAX_PROBLEMS = 100


def _message_of(entry: ErrorDetails, path: str) -> str:
    message, value = entry["msg"].removeprefix("Value error, "), entry.get("input")
    match entry["type"]:
        case "extra_forbidden":
            return "unknown key" + suggest_key(entry["loc"])
        case "missing":
            return "is missing"
        case _ if path == "format":
            return "is a format of scene files that this scenetruth does not read; it reads 1: update it"
        case _ if path == "sensor":
            named = value.get("kind") if isinstance(value, dict) else value
            return (
                "must be 'ideal', or a mapping of kind gaussian (the default), emva1288 or chain with its fields"
                + suggest_word(named, "'ideal', 'gaussian', 'emva1288', 'chain'")
            )
        case "literal_error":
            return message + suggest_word(value, message)
        case "union_tag_invalid":
            kinds = entry["ctx"]["expected_tags"]
            return f"is of no known kind: '{entry['ctx']['tag']}' is none of {kinds}" + suggest_word(
                entry["ctx"]["tag"], kinds
            )
        case "union_tag_not_found":
            return f"needs a kind, one of {str(list_kinds(entry['loc']))[1:-1]}"
    return message


def _joined(found: Sequence[tuple[str, Problem]]) -> list[Problem]:
    """Return problems so that each value has one: of a value that may be of several types, pydantic reports each."""
    problems: list[Problem] = []
    for kind, problem in found:
        others = [other for entry, other in found if entry != "literal_error" and other.path == problem.path]
        if kind == "literal_error":
            # What is wrong inside a mapping says more than that it is not a word.
            if not others and not any(other.path.startswith(f"{problem.path}.") for _, other in found):
                problems.append(problem)
            continue
        words = [
            other.message.removeprefix("input should be ")
            for entry, other in found
            if entry == "literal_error" and other.path == problem.path
        ]
        message = " or ".join([problem.message.partition(", unable to parse")[0], *words]) if words else problem.message
        problems.append(Problem(problem.path, message, problem.value))
    return problems


def _path_in(plain: Mapping[str, Any], loc: Sequence[str | int], kind_of_error: str) -> str:
    """Spell a location as keys of the file, leaving out the names of union members that pydantic puts in between."""
    keys, here = [], plain
    for index, key in enumerate(loc):
        # A field may be called like the kind of its mapping, as `file`: what has more below it is the kind then.
        below = index < len(loc) - 1 and isinstance(here, dict) and not isinstance(here.get(str(key)), dict | list)
        named = isinstance(here, dict) and str(here.get("kind", "")).lower() == key
        inside = isinstance(here, dict) and key in here and not (below and named)
        listed = isinstance(here, list) and isinstance(key, int) and key < len(here)
        if inside or listed:
            here = here[key]  # type: ignore[index]
        elif index < len(loc) - 1 or (kind_of_error != "missing" and _is_union_member(here, key)):
            continue
        keys.append(str(key))
    return ".".join(keys)


def _is_union_member(here: object, key: str | int) -> bool:
    """Tell whether the last part of a location names a type that was tried, not a field or an index."""
    if isinstance(key, int):
        return False
    # A mapping that is wrong as a whole is reported under its kind, which may be called like a field.
    kind = here.get("kind") if isinstance(here, dict) else None
    return key not in collect_keys() or (isinstance(kind, str) and kind.lower() == key)
