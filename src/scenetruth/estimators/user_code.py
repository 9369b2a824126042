"""User-defined code: functions as methods, the files it depends on, and the location of exceptions."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from pydantic import Field, create_model

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.protocol import Method, MethodSettings
from scenetruth.lazy_exports import lazy_module
from scenetruth.progress import Progress
from scenetruth.schema import assemble_estimate, make_estimate
from scenetruth.validation_problems import suggest_word

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["FunctionMethod", "is_user_file", "list_imported", "locate_exception", "with_imported"]


_OURS = Path(__file__).resolve().parents[1]
_INSTALLED = {"site-packages", "dist-packages"}
_TYPED_IN = ("<stdin>", "<python-input", "<ipython")


def is_user_file(file: str | Path) -> bool:
    """Return whether a file belongs neither to scenetruth, nor to Python, nor to an installed package."""
    try:
        path = Path(file).resolve()
        if not path.is_file() or _INSTALLED.intersection(path.parts):
            return False
    except (OSError, ValueError):  # not a valid file name
        return False
    return not any(path.is_relative_to(folder) for folder in (_OURS, *_python()))


def locate_exception(error: BaseException) -> str:
    """Return the last line of user code that an exception passed through, ``mine.py:12 in helper``; empty if none."""
    text, step = "", error.__traceback__
    while step is not None:
        code = step.tb_frame.f_code
        if code.co_filename.startswith(_TYPED_IN) or is_user_file(code.co_filename):
            text = f"{_shown(code.co_filename)}:{step.tb_lineno} in {code.co_name}"
        step = step.tb_next
    return text


def with_imported(file: Path) -> list[Path]:
    """Return a file and all modules of the user that it imports, directly or indirectly, sorted."""
    first = file.resolve()
    found, left = {first}, [first]
    while left:
        for one in list_imported(left.pop()):
            if one not in found:
                found.add(one)
                left.append(one)
    return sorted(found)


def list_imported(file: Path) -> list[Path]:
    """Return the modules of the user that a Python file imports itself, also compiled modules and those elsewhere."""
    if file.suffix != ".py":
        return []
    # Module names of a package start at the parent of its outermost folder.
    root = next(folder for folder in file.parents if not (folder / "__init__.py").is_file())
    found = set[Path]()
    for level, parts in _read_imports(file):
        if level:
            folders = {file.parents[level - 1]} if level <= len(file.parents) else set()
        else:
            folders = {file.parent, root, *_find_module_folder(parts[0])}
        found.update(filter(is_user_file, _list_defining_files(list(parts), folders)))
    return sorted(found)


def _read_imports(file: Path) -> list[tuple[int, tuple[str, ...]]]:
    """Return the level and the dotted name of every import; a level above 0 is relative."""
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, ValueError, SyntaxError):  # reported when the file is run
        return []
    found: list[tuple[int, tuple[str, ...]]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(0, tuple(alias.name.split("."))) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = tuple(node.module.split(".")) if node.module else ()
            found += [(node.level, (*parts, alias.name)) for alias in node.names]
    return list(dict.fromkeys(found))


def _find_module_folder(name: str) -> Iterator[Path]:
    """Yield the folder that contains a module or package of the user on the search path of modules."""
    if name in sys.stdlib_module_names or name == _OURS.name:
        return
    try:
        spec = importlib.util.find_spec(name)  # which runs no code
    except (ImportError, ValueError, AttributeError):
        return
    if spec is not None and spec.origin is not None and is_user_file(spec.origin):
        origin = Path(spec.origin)
        yield origin.parents[1] if origin.stem == "__init__" else origin.parent


def _list_defining_files(parts: list[str], folders: set[Path]) -> Iterator[Path]:
    """Yield the existing files that define a dotted name: those of its packages and its own."""
    for folder in folders:
        for count in range(len(parts) + 1):
            base = folder.joinpath(*parts[:count])
            names = [base / "__init__.py", *([base.with_name(f"{base.name}.py")] if count else [])]
            names += [base.with_name(base.name + suffix) for suffix in EXTENSION_SUFFIXES] if count else []
            yield from (one.resolve() for one in names if one.is_file())


def _shown(name: str) -> str:
    path = Path(name)
    if path.is_absolute() and path.is_relative_to(Path.cwd()):
        return str(path.relative_to(Path.cwd()))
    return path.name


@cache
def _python() -> tuple[Path, ...]:
    paths = sysconfig.get_paths()
    names = ("stdlib", "platstdlib", "purelib", "platlib")
    return tuple(dict.fromkeys(Path(paths[name]).resolve() for name in names if name in paths))


class FunctionMethod(Method):
    """Wrapper that turns a function of a recording into a method.

    ``function``: Called with the recording, with ``progress`` if it has a parameter of that name, and with its other
      parameters as settings, validated by their annotations. It returns an estimate, or a mapping of plain arrays, the
      arguments of `scenetruth.make_estimate`. Its attributes ``gives`` and ``needs``, if any, are those of the method.
    """

    def __init__(self, function: Callable[..., Any], name: str) -> None:
        self.name = name
        self.function = function
        parameters = list(inspect.signature(function).parameters.values())
        if not parameters:
            msg = "has no parameter for the recording"
            raise TypeError(msg)
        rest = parameters[1:]
        endless = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        if any(item.kind in endless for item in rest):
            msg = "has variadic parameters; name each setting, so that it can be validated"
            raise TypeError(msg)
        hints = _get_type_hints(function)
        self._takes_progress = any(item.name == "progress" for item in rest)
        fields: dict[str, Any] = {
            item.name: (hints.get(item.name, Any), Field(... if item.default is item.empty else item.default))
            for item in rest
            if item.name != "progress"
        }
        self.settings = create_model("FunctionSettings", __base__=MethodSettings, **fields)
        self.gives = frozenset(getattr(function, "gives", ()))
        self.needs = getattr(function, "needs", Method.needs)

    def estimate(self, recording: xr.Dataset, settings: Any, progress: Progress | None) -> xr.Dataset:
        """Call the function and return its estimate."""
        given = {name: getattr(settings, name) for name in type(settings).model_fields}
        if self._takes_progress:
            given["progress"] = progress
        found = self.function(recording, **given)
        if isinstance(found, Mapping) and not isinstance(found, xr.Dataset):
            _reject_unknown_quantities(found)
            return assemble_estimate(recording=recording, **found)
        return found  # type: ignore[no-any-return]  # validated by the caller


def _reject_unknown_quantities(found: Mapping[Any, Any]) -> None:
    """Raise if a function returns quantities that do not exist in an estimate."""
    parameters = inspect.signature(make_estimate).parameters.values()
    known = [one.name for one in parameters if one.kind is one.KEYWORD_ONLY and one.name != "recording"]
    problems = []
    for name in found:
        if name not in known:
            hint = suggest_word(str(name), known) or "."
            problems.append(Problem(str(name), f"is not a quantity of an estimate{hint} Valid: {', '.join(known)}"))
    if problems:
        raise EstimateError(problems)


def _get_type_hints(function: Callable[..., Any]) -> dict[str, Any]:
    try:
        return get_type_hints(function)
    except Exception:  # annotations may refer to names that exist only for type checkers
        return {}
