"""The mask of a recording: pixels that must not be used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import Problem
from scenetruth.schema.variables import VARIABLES

__all__ = ["mask_from", "mask_problems"]

_BOOLEANS = "must hold booleans, True where a pixel must not be used; compare, as in mask=values > 0"


def mask_from(values: Any, sizes: Mapping[str, int], problems: list[Problem]) -> xr.Variable | None:
    """Return a mask with the names of its dimensions, as a copy; None, with a problem noted, if it is none.

    Parameters
    ----------
    values
        An array of shape (y, x), all of ``sizes`` but t, or all of them, where those before y may be 1; or a DataArray
        of any dimensions of the images with y and x.
    sizes
        The sizes of the images by dimension, in their order.
    problems
        Where to note what is wrong.

    Examples
    --------
    >>> sizes = {"s": 2, "t": 9, "y": 3, "x": 4}
    >>> mask_from(np.zeros((2, 3, 4), dtype=bool), sizes, []).dims
    ('s', 'y', 'x')
    >>> mask_from(np.zeros((1, 9, 3, 4), dtype=bool), sizes, []).dims
    ('t', 'y', 'x')
    """
    every = tuple(sizes)
    entry = VARIABLES["recording"]["mask"]
    attrs = {"units": entry.units, "long_name": entry.long_name, **(entry.attrs or {})}
    if isinstance(values, xr.DataArray | xr.Variable):
        dims = tuple(dim for dim in every if dim in values.dims)
        unknown = sorted(str(dim) for dim in values.dims if dim not in every)
        if unknown or dims[-2:] != every[-2:]:
            problems.append(Problem("mask", f"must have the dimensions y and x, and of {every} any", values.dims))
            return None
        found = np.array(values.transpose(*dims).values)
    else:
        try:
            found = np.array(values)
        except ValueError as error:  # rows of different lengths
            problems.append(Problem("mask", f"cannot be made into an array: {' '.join(str(error).split())}"))
            return None
        forms = {2: every[-2:], len(every) - 1: tuple(dim for dim in every if dim != "t"), len(every): every}
        if found.ndim not in forms:
            shapes = ", ".join(f"({', '.join(form)})" for form in forms.values())
            problems.append(Problem("mask", f"must have one of the shapes {shapes}", found.shape))
            return None
        dims = forms[found.ndim]
        if found.ndim == len(every):
            # Along what has a single value for all, it is the same.
            same = [n for n, dim in enumerate(every[:-2]) if found.shape[n] == 1 and sizes[dim] > 1]
            found, dims = found.squeeze(tuple(same)), tuple(dim for n, dim in enumerate(every) if n not in same)
    if found.dtype != np.bool_:
        problems.append(Problem("mask", _BOOLEANS, str(found.dtype)))
        return None
    expected = tuple(sizes[dim] for dim in dims)
    if found.shape != expected:
        problems.append(Problem("mask", f"must have the shape {expected} of the images along {dims}", found.shape))
        return None
    return xr.Variable(dims, found, attrs)


def mask_problems(recording: xr.Dataset) -> list[Problem]:
    """Return what is wrong with the mask of a recording that has one.

    Parameters
    ----------
    recording
        A recording with the variable ``mask``.
    """
    mask = recording.variables["mask"]
    problems = []
    if mask.dtype != np.bool_:
        problems.append(Problem("mask", _BOOLEANS, str(mask.dtype)))
    image = recording.variables["image"].dims if "image" in recording else ("s_y", "s", "t", "y", "x")
    # A single image that was selected has no s and t any more.
    allowed = tuple(dim for dim in image if dim != "channel")
    if tuple(dim for dim in allowed if dim in mask.dims) != mask.dims or not {"y", "x"} <= set(mask.dims):
        message = f"must have the dimensions y and x, and any others of {allowed}, in this order"
        problems.append(Problem("mask", message, mask.dims))
    return problems
