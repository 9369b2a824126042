"""What goes into a method cannot be changed by it, and what comes out is an estimate of that recording."""

from __future__ import annotations

from collections.abc import Set as AbstractSet

import numpy as np
import xarray as xr

from scenetruth.errors import Problem, RecordingError
from scenetruth.schema import VARIABLES, check_dataset

__all__ = ["is_in_memory", "own_arrays", "read_only", "returned_problems"]


def read_only(recording: xr.Dataset) -> xr.Dataset:
    """Return the same recording, with arrays that cannot be written to and containers of its own.

    What was opened and not loaded stays so: whoever reads it gets arrays of its own.
    """
    guarded = recording.copy(deep=False)
    indexes = {}
    for name, variable in guarded.variables.items():
        if not is_in_memory(variable):
            continue
        values = variable.values.view()
        values.flags.writeable = False
        if name not in guarded.xindexes:
            variable.data = values
        elif variable.dims == (name,) and variable.values.flags.writeable:
            # pandas before 3 hands out the values of an index as they are.
            indexes[name] = (variable.dims, values, variable.attrs, variable.encoding)
    return guarded.assign_coords(indexes)


def own_arrays(found: xr.Dataset, recording: xr.Dataset) -> xr.Dataset:
    """Return a data set that shares no memory with a recording, and whose arrays can be written to."""
    own = found.copy()
    others = [other.values for other in recording.variables.values() if is_in_memory(other)]
    for name, variable in own.variables.items():
        if name in own.xindexes:
            continue
        values = variable.values
        shared = any(np.may_share_memory(values, other) for other in others)
        if shared or not values.flags.writeable:
            variable.data = values.copy()
    return own


def is_in_memory(variable: xr.Variable) -> bool:
    """Return whether a variable's values are in memory, and need not be read from a store."""
    return bool(variable._in_memory)  # xarray has no public word for it


def returned_problems(found: object, recording: xr.Dataset, gives: AbstractSet[str]) -> list[Problem]:
    """Return what is wrong with what a method returned.

    Parameters
    ----------
    found
        What it returned.
    recording
        What it was given.
    gives
        What it promised to give.
    """
    if not isinstance(found, xr.Dataset):
        remedy = "is not an xarray.Dataset; make one with scenetruth.make_estimate(like=recording, ...)"
        return [Problem("", remedy, type(found).__name__)]
    problems = [
        Problem(name, "is promised by the method, but missing", sorted(map(str, found.data_vars)))
        for name in sorted(gives)
        if name not in found
    ]
    try:
        check_dataset(found, "estimate")
    except RecordingError as error:
        problems += error.problems
    for name, entry in VARIABLES["estimate"].items():
        if name not in found:
            continue
        variable = found.variables[name]
        units = variable.attrs.get("units")
        if units != entry.units:
            problems.append(Problem(f"{name}.units", f"must be '{entry.units}'", units))
        if name in _REAL and variable.dtype.kind != "f":
            problems.append(Problem(name, "must hold floats, NaN where nothing is known", str(variable.dtype)))
    for dim in ("t", "y", "x"):
        if dim not in found.coords or dim not in recording.coords:
            if dim not in found.coords:
                problems.append(Problem(dim, "is missing; an estimate has the coordinates of its recording"))
            continue
        extra = sorted(set(found.variables[dim].values.tolist()) - set(recording.variables[dim].values.tolist()))
        if extra:
            message = f"has {len(extra)} values that the recording has not"
            problems.append(Problem(dim, message, extra[:3]))
        elif dim != "t" and found.sizes[dim] != recording.sizes[dim]:
            problems.append(Problem(dim, f"must have the recording's {recording.sizes[dim]} pixels", found.sizes[dim]))
    return problems


_REAL = ("depth", "disparity", "flow", "velocity", "divergence", "depth_std", "disparity_std", "velocity_std")
