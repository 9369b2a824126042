"""Plain functions as methods: their keyword parameters are the settings."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

import xarray as xr
from pydantic import Field, create_model

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.protocol import Method, MethodSettings
from scenetruth.progress import Progress
from scenetruth.schema import make_estimate

__all__ = ["FunctionMethod"]


class FunctionMethod(Method):
    """A function of a recording as a method.

    Parameters
    ----------
    function
        Called with the recording, with ``progress`` if it has a parameter of that name, and with its other parameters
        as settings, validated by their annotations. It returns an estimate, or a mapping of plain arrays, the arguments
        of `scenetruth.make_estimate`. If it has attributes ``gives`` or ``needs``, they are the method's.
    name
        What it is called.

    Raises
    ------
    TypeError
        If the function takes no recording, or any number of parameters.
    """

    def __init__(self, function: Callable[..., Any], name: str) -> None:
        self.name = name
        self.function = function
        parameters = list(inspect.signature(function).parameters.values())
        if not parameters:
            msg = "takes no recording"
            raise TypeError(msg)
        rest = parameters[1:]
        endless = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        if any(item.kind in endless for item in rest):
            msg = "takes any number of parameters: name each setting, so that it can be validated"
            raise TypeError(msg)
        hints = _hints_of(function)
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
        """Call the function."""
        given = {name: getattr(settings, name) for name in type(settings).model_fields}
        if self._takes_progress:
            given["progress"] = progress
        found = self.function(recording, **given)
        if isinstance(found, Mapping) and not isinstance(found, xr.Dataset):
            _refuse_strange(found)
            return make_estimate(like=recording, **found)
        return found  # type: ignore[no-any-return]  # whatever it is, it is checked where methods are called


def _refuse_strange(found: Mapping[Any, Any]) -> None:
    """Refuse what a function returns under names that no estimate has."""
    parameters = inspect.signature(make_estimate).parameters.values()
    known = [one.name for one in parameters if one.kind is one.KEYWORD_ONLY and one.name != "like"]
    problems = []
    for name in found:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else "."
            problems.append(Problem(str(name), f"is nothing that an estimate holds{hint} Known: {', '.join(known)}"))
    if problems:
        raise EstimateError(problems)


def _hints_of(function: Callable[..., Any]) -> dict[str, Any]:
    try:
        return get_type_hints(function)
    except Exception:  # annotations may name what exists only for type checkers
        return {}
