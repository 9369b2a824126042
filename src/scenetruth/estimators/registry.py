"""All methods by name: those in ``estimators/methods``, those of installed plug-ins, and plain functions."""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.own_code import place_of

if TYPE_CHECKING:
    from scenetruth.estimators.protocol import Estimator

__all__ = ["DEFAULT_METHOD", "ENTRY_POINTS", "MethodEntry", "find_method", "method_entries", "offered"]

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
    """Let a method that was made just now be found by its name, in this process, until the block ends.

    Parameters
    ----------
    method
        The method; its name must not be that of one that is installed.

    Raises
    ------
    EstimateError
        If it is.
    """
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
        told = f"it called sys.exit({error.code!r})" if isinstance(error, SystemExit) else _told(error)
        raise _refused(f"cannot be imported as module:function: {told}", path) from error


def _told(error: BaseException) -> str:
    place = place_of(error)
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
    from scenetruth.estimators.function import FunctionMethod
    from scenetruth.estimators.protocol import RESERVED_SETTINGS, Estimator
    from scenetruth.model import FrozenModel

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
