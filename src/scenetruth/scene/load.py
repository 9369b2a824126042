"""Scene files: YAML in, validated scene out, with every problem named at once."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from scenetruth.errors import EstimateError, Problem, SceneError
from scenetruth.estimators import choose
from scenetruth.files import context_of
from scenetruth.scene.spec import Scene

__all__ = ["apply_overrides", "load_scene", "scene_from_plain"]


def load_scene(file: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Load a scene file.

    Parameters
    ----------
    file
        The YAML file. Relative paths in it count from its folder.
    overrides
        Changes to apply first, each ``path=value`` with the value in YAML: ``camera.width=320``, ``sensor=ideal``,
        ``objects.0.texture.rms_contrast=0.1``.

    Returns
    -------
    Scene
        Validated and frozen; paths of mesh and image files are absolute.

    Raises
    ------
    SceneError
        If the file cannot be read, or with every problem that its content has.
    """
    import yaml

    path = Path(file)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError([Problem("", f"cannot be read: {error}")], source=path) from error
    try:
        plain = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SceneError([Problem("", f"is not valid YAML: {' '.join(str(error).split())}")], source=path) from error
    if not isinstance(plain, dict):
        raise SceneError([Problem("", "must be a mapping of camera, stage, frames, objects, ...", plain)], source=path)
    apply_overrides(plain, overrides, source=path)
    return scene_from_plain(plain, source=path, folder=path.parent.resolve())


def scene_from_plain(plain: Mapping[str, Any], source: str | Path | None = None, folder: Path | None = None) -> Scene:
    """Validate a scene given as plain values.

    Parameters
    ----------
    plain
        The values, as in a scene file.
    source
        Where they are from, for messages.
    folder
        Folder that relative paths of files count from; None leaves them as they are.

    Raises
    ------
    SceneError
        With every problem and its path.
    """
    problems: list[Problem] = []
    validated = dict(plain)
    if "estimate" in plain:
        try:
            validated["estimate"] = choose(plain["estimate"])
        except EstimateError as error:
            # What is wrong inside the settings of a method is told field by field, with all else.
            del validated["estimate"]
            problems += [
                Problem(".".join(filter(None, ("estimate", problem.path))), problem.message, problem.value)
                for problem in error.problems
            ]
    try:
        scene = Scene.model_validate(validated, context=context_of(folder))
    except ValidationError as error:
        raise SceneError([*_problems_of(error, plain), *problems], source=source) from error
    if problems:
        raise SceneError(problems, source=source)
    return scene


def apply_overrides(plain: dict[str, Any], overrides: Sequence[str], source: str | Path | None = None) -> None:
    """Change plain values in place by ``path=value`` assignments.

    Raises
    ------
    SceneError
        With every assignment whose spelling or path does not fit.
    """
    import yaml

    problems = []
    for override in overrides:
        path, separator, text = override.partition("=")
        if not separator or not path.strip():
            problems.append(Problem("--set", "must read path=value", override))
            continue
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError:
            problems.append(Problem(f"--set {path}", "the value is not valid YAML", text))
            continue
        problem = _assign(plain, path.strip().split("."), value)
        if problem is not None:
            problems.append(Problem(f"--set {path}", problem, override))
    if problems:
        raise SceneError(problems, source=source)


def _assign(target: Any, keys: list[str], value: Any) -> str | None:
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        if isinstance(target, list):
            if not key.lstrip("-").isdigit() or not -len(target) <= int(key) < len(target):
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
            return f"'{'.'.join(keys[:depth])}' is {target!r} and has no fields"
    return None


def _problems_of(error: ValidationError, plain: Mapping[str, Any]) -> list[Problem]:
    found: dict[tuple[str, str], tuple[str, Problem]] = {}
    for entry in error.errors():
        path = _path_in(plain, entry["loc"])
        message = entry["msg"].removeprefix("Value error, ")
        value = entry.get("input")
        if entry["type"] == "extra_forbidden":
            message = "unknown key" + _suggestion(str(entry["loc"][-1]))
        elif entry["type"] == "missing":
            message, value = "is missing", None
        elif path == "sensor":
            message = "must be 'ideal', or a mapping of kind gaussian (the default), emva1288 or chain with its fields"
        message = message[:1].lower() + message[1:]
        found.setdefault((path, message), (entry["type"], Problem(path, message, value)))
    paths = [problem.path for _, problem in found.values()]
    # Of a value that may be a word or a mapping, pydantic reports both; what is wrong inside the mapping says more.
    return [
        problem
        for kind, problem in found.values()
        if not (kind == "literal_error" and any(path.startswith(f"{problem.path}.") for path in paths))
    ]


def _path_in(plain: Mapping[str, Any], loc: Sequence[str | int]) -> str:
    """Spell a location as keys of the file, leaving out the names of union members that pydantic puts in between."""
    keys, here = [], plain
    for index, key in enumerate(loc):
        inside = isinstance(here, dict) and key in here
        listed = isinstance(here, list) and isinstance(key, int) and key < len(here)
        if inside or listed:
            here = here[key]  # type: ignore[index]
        elif index < len(loc) - 1 or _is_union_member(here, key):
            continue
        keys.append(str(key))
    return ".".join(keys)


def _is_union_member(here: object, key: str | int) -> bool:
    """Tell whether the last part of a location names a type that was tried, not a field or an index."""
    if isinstance(key, int):
        return False
    # A mapping that is wrong as a whole is reported under its kind, which may be called like a field.
    kind = here.get("kind") if isinstance(here, dict) else None
    return key not in _known_keys() or (isinstance(kind, str) and kind.lower() == key)


def _suggestion(key: str) -> str:
    near = difflib.get_close_matches(key, _known_keys(), n=1)
    return f"; did you mean '{near[0]}'?" if near else "; see `scenetruth schema` for the known ones"


@cache
def _known_keys() -> tuple[str, ...]:
    schema = Scene.model_json_schema()
    keys = set(schema["properties"])
    for definition in schema.get("$defs", {}).values():
        keys |= set(definition.get("properties", ()))
    return tuple(sorted(keys))
