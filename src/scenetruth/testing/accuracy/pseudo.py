"""What a score tells of an estimate that was made up: how large a region is, what a bound comes to in it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.schema import intrinsics_of, label
from scenetruth.scoring import QUANTITIES, Quantity, score
from scenetruth.scoring.alignment import align
from scenetruth.scoring.reading import percent_per_hour, read_quantity
from scenetruth.testing.accuracy.limits import LimitError

__all__ = ["bound_in_region", "pixels_in_region"]

Map = NDArray[np.float64]


def pixels_in_region(
    estimate: xr.Dataset, truth: xr.Dataset, recording: xr.Dataset | None, region: str, settings: Mapping[str, Any]
) -> int:
    """Return how many pixels a region has over all frames of an estimate: those that a perfect one would be scored at.

    Parameters
    ----------
    estimate, truth, recording, region
        As of `assert_accuracy`.
    settings
        Of the score.
    """
    found, exact = align(estimate, truth)
    x, y = (found[name].values if name in found.coords else None for name in ("x", "y"))
    perfect = label("estimate", {"depth": exact["depth"].values}, intrinsics_of(found), t=found["t"].values, x=x, y=y)
    count = score(perfect, truth, recording, check=False, **settings).regions[region]["depth"]["count"]
    return int(count or 0)


def bound_in_region(
    bound: xr.Dataset,
    names: Collection[str],
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None,
    region: str,
    settings: Mapping[str, Any],
) -> dict[str, float | None]:
    """Return the rms of a bound over the pixels of a region at which an estimate is scored.

    Parameters
    ----------
    bound
        Standard deviations, ``depth_std`` and so on, with the dimensions and units of the estimate's variables.
    names
        The quantities, keys of `scenetruth.scoring.QUANTITIES`.
    estimate, truth, recording, region
        As of `assert_accuracy`.
    settings
        Of the score.

    Returns
    -------
    dict
        In the score's units; None where the bound is known at no pixel that is scored, or the estimate does not hold
        the quantity itself. Pixels where the bound is not known do not count.

    Raises
    ------
    LimitError
        If the bound does not hold what is asked for; lists what is wrong.
    """
    found, exact = align(estimate, truth)
    # An estimate that is wrong by one standard deviation everywhere has the rms of the standard deviations.
    wrong = found.copy()
    problems = []
    for name in names:
        entry = QUANTITIES[name]
        if entry.variable not in found:
            # Growth that windows find in depth and velocity has an error, but this is none of its own.
            continue
        try:
            std = _std_of(bound, entry, found)
        except ValueError as error:
            problems.append(Problem(f"bound.{entry.variable}_std", str(error)))
            continue
        factor = percent_per_hour(intrinsics_of(found)) if entry.units == "%/h" else 1.0
        values = np.array(wrong[entry.variable].values, dtype=np.float64)
        place = values if entry.component is None else values[entry.component]
        place[...] = np.where(np.isfinite(place), read_quantity(exact, name) / factor + std, np.nan)
        wrong[entry.variable] = wrong[entry.variable].copy(data=values)
    if problems:
        raise LimitError(list(dict.fromkeys(problems)))
    regions = score(wrong, truth, recording, check=False, **settings).regions[region]
    return {name: regions[name]["rms"] if QUANTITIES[name].variable in found else None for name in names}


def _std_of(bound: xr.Dataset, entry: Quantity, found: xr.Dataset) -> Map:
    """Return the standard deviations at the pixels of an estimate, NaN where there are none."""
    variable = f"{entry.variable}_std"
    if variable not in bound:
        msg = f"is missing; the bound has {', '.join(sorted(map(str, bound.data_vars)))}"
        raise ValueError(msg)
    array = bound[variable]
    vector = [dim for dim in array.dims if dim not in ("t", "y", "x")]
    if entry.component is not None and vector:
        array = array.isel({vector[0]: entry.component})
    if not set(array.dims) <= {"t", "y", "x"}:
        dims = ", ".join(map(str, bound[variable].dims))
        msg = f"must have the dimensions (t, y, x), a vector's component before them; it has ({dims})"
        raise ValueError(msg)
    for dim in ("t", "y", "x"):
        if dim in array.dims and dim in array.coords and dim in found.coords:
            array = array.reindex({dim: found[dim].values})
    shape = tuple(found.sizes[dim] for dim in ("t", "y", "x"))
    values = array.transpose(*(dim for dim in ("t", "y", "x") if dim in array.dims)).values
    return np.asarray(np.broadcast_to(np.asarray(values, dtype=np.float64), shape))
