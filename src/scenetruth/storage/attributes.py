"""Attributes of data sets in the form in which stores keep them: plain JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import Problem, RecordingError

__all__ = ["AUXILIARY", "plain_attributes"]

AUXILIARY = "coordinates"
"""Attribute of a store that names the coordinates which are no dimensions, as CF conventions and xarray spell it."""


def plain_attributes(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    """Return the attributes of a data set and of its variables as plain values.

    Parameters
    ----------
    dataset
        The data set.

    Returns
    -------
    dict
        By name of the variable; those of the data set itself under the empty name.

    Raises
    ------
    RecordingError
        With every attribute that JSON cannot hold, and every variable whose values are neither numbers nor text.
    """
    problems: list[Problem] = []
    found = {"": _plain(dataset.attrs, "attrs", problems)}
    for name, variable in dataset.variables.items():
        found[str(name)] = _plain(variable.attrs, f"{name}.attrs", problems)
        if variable.dtype.kind not in "biufU":
            message = "holds values that are neither numbers nor text; a store cannot keep them"
            problems.append(Problem(str(name), message, str(variable.dtype)))
    if problems:
        raise RecordingError(problems, source="data set to save")
    auxiliary = sorted(str(name) for name in dataset.coords if name not in dataset.dims)
    if auxiliary:
        found[""][AUXILIARY] = " ".join(auxiliary)
    return found


def _plain(attrs: Mapping[Any, Any], where: str, problems: list[Problem]) -> dict[str, Any]:
    plain = {}
    for name, value in attrs.items():
        try:
            plain[str(name)] = _plain_value(value)
        except (TypeError, ValueError) as error:
            message = f"cannot be stored: {error}; give it as text"
            problems.append(Problem(f"{where}.{name}", message, type(value).__name__))
    return plain


def _plain_value(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return _plain_value(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        msg = "JSON has no NaN and no infinity"
        raise ValueError(msg)
    if isinstance(value, str | int | float | bool | None):
        return value
    if isinstance(value, list | tuple):
        return [_plain_value(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _plain_value(item) for name, item in value.items()}
    msg = f"{type(value).__name__} is no plain value"
    raise TypeError(msg)
