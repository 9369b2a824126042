"""All methods by name.

Built-in methods, those of installed plugins and plain functions; and the choice of a method with its settings.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, cast

from pydantic import (
    BaseModel,
    ConfigDict,
    GetJsonSchemaHandler,
    SerializationInfo,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.protocol import Estimator
from scenetruth.estimators.user_code import locate_exception
from scenetruth.plain_data import plain_problems
from scenetruth.validated_model import FrozenModel

__all__ = [
    "DEFAULT_METHOD",
    "MethodChoice",
    "MethodEntry",
    "choose",
    "find_method",
    "method_entries",
    "name_problems",
    "offered",
    "validate_settings",
]


DEFAULT_METHOD = "structure_tensor"
"""The method where none is named."""
ENTRY_POINTS = "scenetruth.estimators"
"""Group of entry points under which packages offer methods."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_DOTTED = re.compile(r"[\w.]{1,200}")


@dataclass(frozen=True)
class MethodEntry:
    """A method that is installed, whether it can be loaded or not.

    Parameters
    ----------
    name
        Its name.
    origin
        Who brings it: ``scenetruth``, or a distribution and its version.
    problem
        Why it cannot be used; empty if nothing is known to be wrong. That its code is broken shows only when it is
        loaded.
    load
        Loads it: returns an object that is, or makes, an `Estimator`.

    See Also
    --------
    scenetruth.estimators.method_entries : Those of all methods that are installed.
    scenetruth.estimators.find_method : The method itself, loaded and looked over.

    Examples
    --------
    >>> from scenetruth.estimators import method_entries
    >>> entry = next(entry for entry in method_entries() if entry.name == "plane_sweep")
    >>> entry.origin, entry.problem, sorted(entry.load().gives)
    ('scenetruth', '', ['depth', 'disparity'])
    """

    name: str
    origin: str
    problem: str
    load: Callable[[], Any]


def method_entries() -> list[MethodEntry]:
    """Return all methods that are installed, without loading any, in order of their names; ours first.

    Returns
    -------
    list of MethodEntry
        One for each, also for those that cannot be loaded.

    See Also
    --------
    scenetruth.estimators.find_method : A method by its name.

    Examples
    --------
    >>> names = [entry.name for entry in method_entries() if not entry.problem]
    >>> "plane_sweep" in names, "refined" in names, "structure_tensor" in names
    (True, True, True)
    """
    own = list(_own_entries())
    offered = sorted(metadata.entry_points(group=ENTRY_POINTS), key=lambda point: (point.name, point.value))
    names = [point.name for point in offered]
    taken = {entry.name for entry in own}
    return own + [
        MethodEntry(point.name, _distribution(point), _name_problem(point.name, names, taken), point.load)
        for point in offered
    ]


def find_method(name: object) -> Estimator:
    """Return a method.

    Parameters
    ----------
    name
        The name of a method that is installed; ``module:function`` for a plain function, or for any object that is a
        method; or such a function or method itself.

    Returns
    -------
    Estimator
        The method.

    Raises
    ------
    EstimateError
        If there is none of that name, or it cannot be loaded, or it is not what a method must be; says what is wrong.

    See Also
    --------
    scenetruth.estimators.method_entries : All methods that are installed, loaded or not.
    scenetruth.estimators.validate_settings : Settings of a method from plain values.

    Examples
    --------
    >>> method = find_method("plane_sweep")
    >>> sorted(method.gives), str(method.needs)
    (['depth', 'disparity'], '2 cameras')

    A function is a method too; its parameters are the settings:

    >>> import numpy as np
    >>> def wall(recording, depth_mm: float = 500.0):
    ...     return {"depth": np.full(recording["image"].shape[-2:], depth_mm)}
    >>> method = find_method(wall)
    >>> method.name, method.settings()
    ('wall', FunctionSettings(depth_mm=500.0))
    """
    if not isinstance(name, str):
        return _made(name, getattr(name, "name", getattr(name, "__name__", type(name).__name__)))
    if name in _OFFERED:
        return _OFFERED[name]
    if ":" in name:
        return _made(_attribute_of(name), name)
    # A plug-in cannot take the name of one of ours: those need no look at what is installed.
    entries = [entry for entry in _own_entries() if entry.name == name]
    entries = entries or [entry for entry in method_entries() if entry.name == name]
    if not entries:
        import difflib

        if hint := _file_hint(name):
            raise _refused(hint, name)
        known = sorted({entry.name for entry in method_entries()})
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else "."
        raise _refused(f"no such method{hint} Installed: {', '.join(known)}", name)
    entry = entries[0]
    if entry.problem:
        raise _refused(entry.problem, name)
    try:
        found = entry.load()
    except Exception as error:  # whatever a plug-in's code raises
        message = f"cannot be loaded from {entry.origin}: {type(error).__name__}: {error}"
        raise _refused(message, name) from error
    return _made(found, name)


_OFFERED: dict[str, Estimator] = {}


@contextmanager
def offered(method: Estimator) -> Iterator[None]:
    """Let a method that was made just now be found by its name, in this process, until the block ends."""
    if method.name in _OFFERED or method.name in {entry.name for entry in method_entries()}:
        raise _refused("is the name of a method that is there already; choose another", method.name)
    _OFFERED[method.name] = method
    try:
        yield
    finally:
        del _OFFERED[method.name]


@cache
def _own_entries() -> tuple[MethodEntry, ...]:
    from scenetruth.estimators import methods

    return tuple(
        MethodEntry(item.name, "scenetruth", "", _loader(f"{methods.__name__}.{item.name}"))
        for item in pkgutil.iter_modules(methods.__path__)
    )


def _loader(module: str) -> Callable[[], Any]:
    return lambda: importlib.import_module(module).METHOD


def _distribution(point: metadata.EntryPoint) -> str:
    return "an unknown package" if point.dist is None else f"{point.dist.name} {point.dist.version}"


def _name_problem(name: str, names: list[str], taken: set[str]) -> str:
    if not _NAME.fullmatch(name):
        return "its name is not possible: lower-case letters, digits and underscores, beginning with a letter"
    if name in taken:
        return "its name is that of a method of scenetruth; the plug-in must choose another"
    if names.count(name) > 1:
        return "several installed plug-ins have this name; uninstall all but one"
    return ""


def _attribute_of(path: str) -> Any:
    module, _, attribute = path.partition(":")
    if module.endswith(".py"):
        raise _refused(f"names a file, not a module; leave out .py: {_module_of(module)}:{attribute}", path)
    try:
        with _searched(os.getcwd()):
            return getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:  # whatever a user's module raises
        told = f"it called sys.exit({error.code!r})" if isinstance(error, SystemExit) else _describe_exception(error)
        raise _refused(f"cannot be imported as module:function: {told}", path) from error


def _describe_exception(error: BaseException) -> str:
    place = locate_exception(error)
    return f"{type(error).__name__}: {error}" + (f" ({place})" if place else "")


def _file_hint(name: str) -> str:
    """Return what to write instead of the name of a module; empty if it is that of none in the current folder."""
    dotted = _DOTTED.fullmatch(name) is not None
    if not name.endswith(".py") and not (dotted and Path(f"{name.replace('.', '/')}.py").is_file()):
        return ""
    module = _module_of(name) if name.endswith(".py") else name
    return f"no such method; a function of one's own is named with its module: {module}:FUNCTION"


def _module_of(file: str) -> str:
    """Return what Python calls the module in a file, from the current folder."""
    path = Path(file).with_suffix("")
    if path.is_absolute() and path.is_relative_to(Path.cwd()):
        path = path.relative_to(Path.cwd())
    return path.name if path.is_absolute() or ".." in path.parts else ".".join(path.parts)


@contextmanager
def _searched(folder: str) -> Iterator[None]:
    """Let modules be imported from a folder too, as ``python -m`` lets them from the current one."""
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def _made(found: Any, name: str) -> Estimator:
    """Return what was found as a method: as it is, made by its class, or a function in a method's clothes."""
    from scenetruth.estimators.protocol import RESERVED_SETTINGS, Estimator
    from scenetruth.estimators.user_code import FunctionMethod
    from scenetruth.validated_model import FrozenModel

    try:
        if isinstance(found, type):
            found = found()
        elif callable(found) and not hasattr(found, "estimate"):
            found = FunctionMethod(found, name)
    except (Exception, SystemExit) as error:  # whatever a plug-in's code raises
        raise _refused(f"cannot be made: {type(error).__name__}: {error}", name) from error
    wrong = []
    if not isinstance(found, Estimator):
        needed = ("name", "settings", "gives", "needs", "requirements", "estimate")
        missing = ", ".join(part for part in needed if not hasattr(found, part))
        wrong.append(f"is not a method: it lacks {missing}")
    elif not (isinstance(found.settings, type) and issubclass(found.settings, FrozenModel)):
        wrong.append("its settings are not a model derived from scenetruth.estimators.MethodSettings")
    else:
        shadows = sorted(RESERVED_SETTINGS & set(found.settings.model_fields))
        if shadows:
            wrong.append(f"its settings have names that are reserved: {', '.join(shadows)}; rename them")
    if not wrong and found.name != name:
        wrong.append(f"calls itself '{found.name}': the name of its entry point must be the same")
    if wrong:
        raise _refused("; ".join(wrong), name)
    return cast("Estimator", found)


def _refused(message: str, name: str) -> EstimateError:
    return EstimateError([Problem("method", message, name)])


def name_problems(name: object) -> list[Problem]:
    """Return what is wrong with the name of a method: estimates and their files are called after it.

    >>> print(*name_problems("My program"))
    name: must be lower-case letters, digits and underscores, beginning with a letter (got 'My program')
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        message = "must be lower-case letters, digits and underscores, beginning with a letter"
        return [Problem("name", message, name)]
    if name in {entry.name for entry in method_entries()}:
        return [Problem("name", "is that of a method that is installed; choose another", name)]
    return []


class MethodChoice(BaseModel):
    """Which method estimates, and with which settings; in a file, both stand side by side.

    ``module:function`` is refused here: a file that is read imports no code but that of installed methods.

    >>> choice = MethodChoice.model_validate({"method": "structure_tensor", "window_sigma_px": 4})
    >>> choice.settings.window_sigma_px, choice.model_dump()["window_taps_px"]
    (4.0, 25)
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str
    """Name of the method: see `scenetruth list methods`."""
    settings: FrozenModel
    """Its settings."""

    @model_validator(mode="before")
    @classmethod
    def _apart(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and isinstance(given.get("settings"), FrozenModel):
            return given
        try:
            chosen = choose(given, from_file=True)
        except EstimateError as error:
            raise ValueError("; ".join(map(str, error.problems))) from error
        return {"method": chosen.method, "settings": chosen.settings}

    @model_serializer(mode="plain")
    def _side_by_side(self, info: SerializationInfo) -> dict[str, Any]:
        return {"method": self.method, **self.settings.model_dump(mode=info.mode)}

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return one object for every method that can be loaded; broken ones are left out."""
        variants = []
        for entry in method_entries():
            try:
                method = find_method(entry.name)
            except EstimateError:
                continue
            variant = _in_place(method.settings.model_json_schema())
            named = {"const": entry.name, "description": "The method.", "title": "Method", "type": "string"}
            if entry.name == DEFAULT_METHOD:
                named["default"] = entry.name
            else:
                variant["required"] = ["method", *variant.get("required", ())]
            variant["properties"] = {"method": named, **variant.get("properties", {})}
            variants.append(variant)
        return {"oneOf": variants}


def _in_place(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON Schema in which models within models stand where they are used: its own $defs cannot be kept."""
    definitions = schema.pop("$defs", {})

    def spelled(part: Any, within: tuple[str, ...] = ()) -> Any:
        if isinstance(part, list):
            return [spelled(each, within) for each in part]
        if not isinstance(part, dict):
            return part
        name = str(part.get("$ref", "")).removeprefix("#/$defs/")
        rest = {key: spelled(each, within) for key, each in part.items() if key != "$ref"}
        if name not in definitions:
            return rest
        # A model that holds itself is told once.
        return {**({"type": "object"} if name in within else spelled(definitions[name], (*within, name))), **rest}

    return dict(spelled(schema))


def choose(given: Any, *, from_file: bool = False) -> MethodChoice:
    """Return a validated choice from what a scene file says."""
    if isinstance(given, MethodChoice):
        return given
    if not isinstance(given, Mapping):
        raise EstimateError([Problem("", "must be a mapping of method and its settings", given)])
    fields = dict(given)
    method = fields.pop("method", DEFAULT_METHOD)
    if not isinstance(method, str):
        raise EstimateError([Problem("method", "must be the name of a method", method)])
    if from_file and ":" in method:
        message = f"is code, which no file may name; give it to the call (--method {method}) or install it as a plug-in"
        raise EstimateError([Problem("method", message, method)])
    settings = validate_settings(find_method(method), fields)
    return MethodChoice.model_construct(method=method, settings=settings)


def validate_settings(method: Estimator, fields: Mapping[str, Any]) -> FrozenModel:
    """Return the settings of a method.

    Parameters
    ----------
    method
        The method.
    fields
        Its settings by name, as plain values; those that are not given have their defaults.

    Returns
    -------
    MethodSettings
        The settings, of the type ``method.settings``.

    Raises
    ------
    EstimateError
        With every setting that is unknown or impossible.

    See Also
    --------
    scenetruth.estimators.find_method : A method by its name.
    scenetruth.estimators.MethodSettings : What models of settings derive from.

    Examples
    --------
    What is not given has its default; all that is wrong is told at once:

    >>> import scenetruth as st
    >>> from scenetruth.estimators import find_method
    >>> method = find_method("plane_sweep")
    >>> settings = validate_settings(method, {"uniqueness_ratio": 1.5})
    >>> settings.uniqueness_ratio, settings.disparity_px
    (1.5, 'auto')
    >>> try:
    ...     validate_settings(method, {"uniqueness_ratio": -1, "disparity": 20})
    ... except st.EstimateError as error:
    ...     print(error)
    2 problems with the estimate in settings of 'plane_sweep':
      - disparity: unknown setting of 'plane_sweep'; did you mean 'disparity_px'? (got 20)
      - uniqueness_ratio: input should be greater than or equal to 1 (got -1)
    """
    problems = plain_problems(fields)
    if problems:
        raise EstimateError(problems, source=f"settings of '{method.name}'")
    try:
        return method.settings.model_validate(dict(fields))
    except ValidationError as error:
        told: dict[str, list[Problem]] = {}
        for problem in (_problem_of(entry, method) for entry in error.errors(include_url=False)[:_MAX_PROBLEMS]):
            told.setdefault(problem.path, []).append(problem)
        # Of a setting that may be a number or a word, pydantic reports each on its own.
        problems = [
            Problem(path, ", or ".join(dict.fromkeys(problem.message for problem in found)), found[0].value)
            for path, found in sorted(told.items())
        ]
        raise EstimateError(problems, source=f"settings of '{method.name}'") from error


_MAX_PROBLEMS = 100
"""More wrong settings are not told: to find what each was meant to be takes time."""


def _problem_of(entry: Any, method: Estimator) -> Problem:
    keys = [str(key) for key in entry["loc"]]
    path = ".".join(key for key in keys if not key.startswith(_UNION_TYPES) and key not in _UNION_MEMBERS)
    message, value = entry["msg"].removeprefix("Value error, "), entry.get("input")
    if entry["type"] == "extra_forbidden":
        import difflib

        known = sorted(method.settings.model_fields)
        near = difflib.get_close_matches(keys[-1], known, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else f"; known: {', '.join(known) or 'none'}"
        message = f"unknown setting of '{method.name}'{hint}"
    return Problem(path, message[:1].lower() + message[1:], value)


# What pydantic calls the members of a union, in the places of what is wrong.
_UNION_TYPES = ("literal[", "function-", "tuple[", "list[", "nullable[")
_UNION_MEMBERS = ("int", "float", "str", "constrained-int", "constrained-float", "constrained-str")
