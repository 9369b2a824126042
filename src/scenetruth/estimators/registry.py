"""Registry of built-in, plugin and function methods by name, and selection of a method with its settings."""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
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
from pydantic_core import CoreSchema, ErrorDetails

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.protocol import Estimator
from scenetruth.estimators.user_code import locate_exception
from scenetruth.plain_data import plain_problems
from scenetruth.validated_model import FrozenModel
from scenetruth.validation_problems import list_problems, suggest_word

__all__ = [
    "DEFAULT_METHOD",
    "MethodChoice",
    "MethodEntry",
    "choose",
    "find_method",
    "list_methods",
    "name_problems",
    "offered",
    "validate_settings",
]


DEFAULT_METHOD = "structure_tensor"
"""Method used unless one is specified."""
ENTRY_POINTS = "scenetruth.estimators"
"""Group of entry points under which packages provide methods."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_DOTTED = re.compile(r"[\w.]{1,200}")


@dataclass(frozen=True)
class MethodEntry:
    """An installed method, which may or may not be loadable.

    Parameters
    ----------
    name
        Name of the method.
    origin
        Provider: ``scenetruth``, or a distribution and its version.
    problem
        Reason why the method cannot be used; empty if none has been detected. Errors in its code appear only when it
        is loaded.
    load
        Load the method: returns an object that is an `Estimator`, or creates one.

    See Also
    --------
    scenetruth.estimators.list_methods : Entries of all installed methods.
    scenetruth.estimators.find_method : Load and validate a method.

    Examples
    --------
    >>> from scenetruth.estimators import list_methods
    >>> entry = next(entry for entry in list_methods() if entry.name == "plane_sweep")
    >>> entry.origin, entry.problem, sorted(entry.load().gives)
    ('scenetruth', '', ['depth', 'disparity'])
    """

    name: str
    origin: str
    problem: str
    load: Callable[[], Any]


def list_methods() -> list[MethodEntry]:
    """Return the entries of all installed methods without loading them, built-in methods first, sorted by name.

    Returns
    -------
    list of MethodEntry
        One entry for each method, including those that cannot be loaded.

    See Also
    --------
    scenetruth.estimators.find_method : Load a method by its name.

    Examples
    --------
    >>> names = [entry.name for entry in list_methods() if not entry.problem]
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
    """Return a method from its name, import path or object.

    Parameters
    ----------
    name
        Name of an installed method; ``module:function`` for a function or method object; or such an object itself.

    Returns
    -------
    Estimator
        The method.

    Raises
    ------
    EstimateError
        If the method does not exist, cannot be loaded, or does not comply with `Estimator`.

    See Also
    --------
    scenetruth.estimators.list_methods : List all installed methods.
    scenetruth.estimators.validate_settings : Create the settings of a method from plain values.

    Examples
    --------
    >>> method = find_method("plane_sweep")
    >>> sorted(method.gives), str(method.needs)
    (['depth', 'disparity'], '2 cameras')

    A function is also a method; its parameters are the settings:

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
        return _made(_load_attribute(name), name)
    # A plugin cannot override a built-in method, whose name therefore needs no search of the installed packages.
    entries = [entry for entry in _own_entries() if entry.name == name]
    entries = entries or [entry for entry in list_methods() if entry.name == name]
    if not entries:
        if hint := _file_hint(name):
            raise _refused(hint, name)
        known = sorted({entry.name for entry in list_methods()})
        hint = suggest_word(name, known) or "."
        raise _refused(f"no such method{hint} Installed: {', '.join(known)}", name)
    entry = entries[0]
    if entry.problem:
        raise _refused(entry.problem, name)
    try:
        found = entry.load()
    except Exception as error:  # the code of a plugin may raise anything
        message = f"cannot be loaded from {entry.origin}: {type(error).__name__}: {error}"
        raise _refused(message, name) from error
    return _made(found, name)


_OFFERED: dict[str, Estimator] = {}


@contextmanager
def offered(method: Estimator) -> Iterator[None]:
    """Make a new method available by name in this process until the block ends."""
    if method.name in _OFFERED or method.name in {entry.name for entry in list_methods()}:
        raise _refused("is the name of an existing method; choose another name", method.name)
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
        return "its name must be lower-case letters, digits and underscores, beginning with a letter"
    if name in taken:
        return "its name is that of a built-in method; the plugin must choose another name"
    if names.count(name) > 1:
        return "several installed plugins have this name; uninstall all but one"
    return ""


def _load_attribute(path: str) -> Any:
    module, _, attribute = path.partition(":")
    if module.endswith(".py"):
        raise _refused(f"names a file, not a module; omit .py: {_derive_module_name(module)}:{attribute}", path)
    try:
        with _searched(os.getcwd()):
            return getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:  # a user module may raise anything
        text = f"it called sys.exit({error.code!r})" if isinstance(error, SystemExit) else _describe_exception(error)
        raise _refused(f"cannot be imported as module:function: {text}", path) from error


def _describe_exception(error: BaseException) -> str:
    place = locate_exception(error)
    return f"{type(error).__name__}: {error}" + (f" ({place})" if place else "")


def _file_hint(name: str) -> str:
    """Return the correct notation for a module of the current folder; empty if the name matches none."""
    dotted = _DOTTED.fullmatch(name) is not None
    if not name.endswith(".py") and not (dotted and Path(f"{name.replace('.', '/')}.py").is_file()):
        return ""
    module = _derive_module_name(name) if name.endswith(".py") else name
    return f"no such method; specify a function with its module: {module}:FUNCTION"


def _derive_module_name(file: str) -> str:
    """Return the import name of the module in a file, relative to the current folder."""
    path = Path(file).with_suffix("")
    if path.is_absolute() and path.is_relative_to(Path.cwd()):
        path = path.relative_to(Path.cwd())
    return path.name if path.is_absolute() or ".." in path.parts else ".".join(path.parts)


@contextmanager
def _searched(folder: str) -> Iterator[None]:
    """Add a folder to the module search path, as ``python -m`` adds the current folder."""
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def _made(found: Any, name: str) -> Estimator:
    """Return a loaded object as a method: unchanged, instantiated from its class, or wrapped if it is a function."""
    from scenetruth.estimators.protocol import RESERVED_SETTINGS, Estimator
    from scenetruth.estimators.user_code import FunctionMethod
    from scenetruth.validated_model import FrozenModel

    try:
        if isinstance(found, type):
            found = found()
        elif callable(found) and not hasattr(found, "estimate"):
            found = FunctionMethod(found, name)
    except (Exception, SystemExit) as error:  # the code of a plugin may raise anything
        raise _refused(f"cannot be instantiated: {type(error).__name__}: {error}", name) from error
    wrong = []
    if not isinstance(found, Estimator):
        needed = ("name", "settings", "gives", "needs", "requirements", "estimate")
        missing = ", ".join(part for part in needed if not hasattr(found, part))
        wrong.append(f"is not a method: missing {missing}")
    elif not (isinstance(found.settings, type) and issubclass(found.settings, FrozenModel)):
        wrong.append("its settings must be a model derived from scenetruth.estimators.MethodSettings")
    else:
        shadows = sorted(RESERVED_SETTINGS & set(found.settings.model_fields))
        if shadows:
            wrong.append(f"its settings have reserved names: {', '.join(shadows)}; rename them")
    if not wrong and found.name != name:
        wrong.append(f"has the name '{found.name}', which must equal the name of its entry point")
    if wrong:
        raise _refused("; ".join(wrong), name)
    return cast("Estimator", found)


def _refused(message: str, name: str) -> EstimateError:
    return EstimateError([Problem("method", message, name)])


def name_problems(name: object) -> list[Problem]:
    """Return the problems of the name of a method, which names its estimates and files.

    >>> print(*name_problems("My program"))
    name: must be lower-case letters, digits and underscores, beginning with a letter (got 'My program')
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        message = "must be lower-case letters, digits and underscores, beginning with a letter"
        return [Problem("name", message, name)]
    if name in {entry.name for entry in list_methods()}:
        return [Problem("name", "is that of an installed method; choose another name", name)]
    return []


class MethodChoice(BaseModel):
    """A method and its settings; in a file, both are fields of the same mapping.

    ``module:function`` is rejected: files import no code but that of installed methods.

    >>> choice = MethodChoice.model_validate({"method": "structure_tensor", "window_sigma_px": 4})
    >>> choice.settings.window_sigma_px, choice.model_dump()["window_taps_px"]
    (4.0, 25)
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str
    """Name of the method: see `scenetruth list methods`."""
    settings: FrozenModel
    """Settings of the method."""

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
        """Return one object schema for every method that can be loaded."""
        variants = []
        for entry in list_methods():
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
    """Return a JSON Schema with inlined definitions of nested models, because its $defs cannot be kept."""
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
        # A recursive model is expanded once.
        return {**({"type": "object"} if name in within else spelled(definitions[name], (*within, name))), **rest}

    return dict(spelled(schema))


def choose(given: Any, *, from_file: bool = False) -> MethodChoice:
    """Return a validated method choice from the fields of a scene file."""
    if isinstance(given, MethodChoice):
        return given
    if not isinstance(given, Mapping):
        raise EstimateError([Problem("", "must be a mapping with a method and its settings", given)])
    fields = dict(given)
    method = fields.pop("method", DEFAULT_METHOD)
    if not isinstance(method, str):
        raise EstimateError([Problem("method", "must be the name of a method", method)])
    if from_file and ":" in method:
        message = f"is code, which files must not specify; use --method {method}, or install it as a plugin"
        raise EstimateError([Problem("method", message, method)])
    settings = validate_settings(find_method(method), fields)
    return MethodChoice.model_construct(method=method, settings=settings)


def validate_settings(method: Estimator, fields: Mapping[str, Any]) -> FrozenModel:
    """Return the validated settings of a method.

    Parameters
    ----------
    method
        The method.
    fields
        Settings by name, as plain values; default: the defaults of the method.

    Returns
    -------
    MethodSettings
        The settings, of the type ``method.settings``.

    Raises
    ------
    EstimateError
        Lists all settings that are unknown or invalid.

    See Also
    --------
    scenetruth.estimators.find_method : Load a method by its name.
    scenetruth.estimators.MethodSettings : Base class of settings models.

    Examples
    --------
    Settings that are not specified have their defaults; all errors are reported together:

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
        problems = list_problems(error, fields, model=method.settings, words=partial(_words, method))
        problems.sort(key=lambda problem: problem.path)
        raise EstimateError(problems, source=f"settings of '{method.name}'") from error


def _words(method: Estimator, entry: ErrorDetails, path: str) -> str | None:
    """Return the message for an unknown setting."""
    if entry["type"] != "extra_forbidden":
        return None
    known = sorted(method.settings.model_fields)
    hint = suggest_word(path, known) or f"; valid: {', '.join(known) or 'none'}"
    return f"unknown setting of '{method.name}'{hint}"
