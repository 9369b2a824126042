"""Goals: YAML in, validated goal out, with every problem of its form named at once."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from scenetruth.design.optimise.goal.spec import Goal
from scenetruth.design.optimise.problems import GoalError
from scenetruth.errors import Problem
from scenetruth.files import context_of
from scenetruth.files.shipped import shipped_file
from scenetruth.plain import plain_problems
from scenetruth.scene.reading import read_file

__all__ = ["goal_from_plain", "load_goal"]

_MAPPING = "a mapping of scene, free, constraints, objectives, ..."


def load_goal(file: str | Path) -> Goal:
    """Load a goal file.

    Parameters
    ----------
    file
        The YAML file, or the name of a goal that is shipped, as ``"leaf_growth"``, if no file has it. Relative paths in
        it count from its folder.

    Returns
    -------
    Goal
        Validated and frozen.

    Raises
    ------
    GoalError
        If the file cannot be read, or with every problem of its form.

    See Also
    --------
    goal_from_plain : A goal from plain values.
    scenetruth.design.optimise.optimise : Finds the rig.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> text = '''
    ... title: Depth of a cube
    ... scene: cube
    ... free:
    ...   stage.baseline_mm: {from: 1, to: 8}
    ... constraints:
    ...   - {kind: stage_travel, at_most: 25}
    ... objectives:
    ...   - {quantity: depth, within: 0.05}
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "goal.yaml").write_text(text)
    ...     goal = load_goal(f"{folder}/goal.yaml")
    >>> goal.title, goal.objectives[0].within, list(goal.free)
    ('Depth of a cube', 0.05, ['stage.baseline_mm'])

    A goal that is shipped:

    >>> load_goal("cube_depth").title
    'Depth and motion of the noise cube'
    """
    file = shipped_file(file, within="goals") or file
    plain, folder = read_file(file, "a goal", GoalError)
    return goal_from_plain(plain, source=file, folder=folder)


def goal_from_plain(plain: Any, source: str | Path | None = None, folder: Path | None = None) -> Goal:
    """Validate a goal given as plain values.

    Parameters
    ----------
    plain
        The values, as in a file.
    source
        Where they are from, for messages.
    folder
        Folder that relative paths of files count from; None leaves them as they are.

    Returns
    -------
    Goal
        Validated and frozen.

    Raises
    ------
    GoalError
        With every problem and its path.

    See Also
    --------
    load_goal : A goal from a file in YAML.
    scenetruth.design.optimise.optimise : Finds the rig.

    Examples
    --------
    >>> from scenetruth.errors import RecipeError
    >>> try:
    ...     goal_from_plain({"scene": "cube.yaml", "free": {"stage.baseline_mm": {"from": 5, "to": 2}}})
    ... except RecipeError as error:
    ...     print(error)
    2 problems with the goal:
      - free.stage.baseline_mm: has no values: from 5 is not below to 2 (got {'from': 5, 'to': 2})
      - objectives: is missing
    """
    if not isinstance(plain, Mapping):
        raise GoalError([Problem("", f"must be {_MAPPING}", plain)], source=source)
    problems = plain_problems(plain)
    if problems:
        raise GoalError(problems, source=source)
    try:
        goal = Goal.model_validate(dict(plain), context=context_of(folder))
    except ValidationError as error:
        raise GoalError(_problems_of(error, plain), source=source) from error
    problems = [*_contradictions(goal)]
    if problems:
        raise GoalError(problems, source=source)
    return goal


def _contradictions(goal: Goal) -> Sequence[Problem]:
    """Return which bounds of one thing leave nothing between them."""
    found = []
    bounds: dict[str, tuple[int, float | None, float | None]] = {}
    for number, one in enumerate(goal.constraints):
        key = one.model_dump_json(exclude={"at_least", "at_most"})
        _, low, high = bounds.get(key, (number, None, None))
        low = one.at_least if low is None or (one.at_least or low) > low else low
        high = one.at_most if high is None or (one.at_most or high) < high else high
        earlier = bounds.get(key)
        bounds[key] = (number, low, high)
        if low is not None and high is not None and low > high:
            message = (
                f"contradicts constraints.{earlier[0] if earlier else number}: {one.title} would have to be at least"
            )
            found.append(Problem(f"constraints.{number}", f"{message} {low:g} and at most {high:g} {one.unit}"))
    return found


def _problems_of(error: ValidationError, plain: Mapping[str, Any]) -> list[Problem]:
    found: dict[tuple[str, str], Problem] = {}
    for entry in error.errors(include_url=False)[:100]:
        path, inside = _path_in(plain, entry["loc"])
        message = str(entry["msg"]).removeprefix("Value error, ")
        if entry["type"] == "extra_forbidden":
            message = "unknown key" + _near(str(entry["loc"][-1]), entry["loc"])
        elif entry["type"] == "missing":
            message = "is missing"
        elif entry["type"] == "union_tag_invalid":
            message = f"is of no known kind: '{entry['ctx']['tag']}' is none of {entry['ctx']['expected_tags']}"
        elif entry["type"] == "union_tag_not_found":
            message = "needs a kind, such as {kind: stage_travel, at_most: 50}"
        value = None if entry["type"] == "missing" or not inside else entry.get("input")
        found.setdefault((path, message), Problem(path, message[:1].lower() + message[1:], value))
    return list(found.values())


def _near(key: str, loc: Sequence[Any]) -> str:
    if len(loc) != 1:
        return ""
    near = difflib.get_close_matches(key, list(Goal.model_fields), n=1)
    return f"; did you mean '{near[0]}'?" if near else f"; known here: {', '.join(Goal.model_fields)}"


def _path_in(plain: Any, loc: Sequence[Any]) -> tuple[str, bool]:
    """Spell a location as keys of the file, leaving out the kinds that pydantic puts in between; and if it has any."""
    keys, here = list[str](), plain
    for index, key in enumerate(loc):
        inside = isinstance(here, Mapping) and key in here
        listed = isinstance(here, list | tuple) and isinstance(key, int) and key < len(here)
        if inside or listed:
            here = here[key]
        elif index < len(loc) - 1 or (isinstance(here, Mapping) and here.get("kind") == key) or _is_type(key, here):
            continue
        keys.append(str(key))
    return ".".join(keys), bool(keys)


def _is_type(key: Any, here: Any) -> bool:
    """Whether a last key names one of several types of a value, and no key of it."""
    return isinstance(key, str) and not isinstance(here, Mapping | list | tuple) and (key == "str" or "[" in key)
