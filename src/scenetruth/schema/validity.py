"""Status, validity and reason for invalidity of every pixel of an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.lazy_exports import lazy_module
from scenetruth.schema.variables import (
    REASONS,
    STATUS_FALLBACK,
    STATUS_INVALID,
    STATUS_NORMAL,
    STATUS_VALID,
    VARIABLES,
)

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = [
    "STATUS_SOURCES",
    "VALIDITY_MAPS",
    "complete_validity",
    "compute_validity",
    "excluded_pixels",
    "lower_status",
    "status_of_quantity",
    "validity_variable",
]

Flags = NDArray[np.uint8]

VALIDITY_MAPS = ("status", "valid", "invalid_reason")
"""Variables that every estimate has."""

STATUS_SOURCES = {"status_disparity": ("disparity", "depth"), "status_motion": ("flow", "velocity")}
"""Quantities that define a status not supplied by the method; the first available quantity is used."""

# From the lowest status to the highest.
_ORDER = (STATUS_INVALID, STATUS_FALLBACK, STATUS_NORMAL, STATUS_VALID)
_RANKS = np.argsort(_ORDER).astype(np.uint8)
_NOT_DETERMINED, _AMBIGUOUS, _MASKED = (REASONS.index(name) for name in ("not_determined", "ambiguous_match", "masked"))


def lower_status(*maps: NDArray[Any]) -> Flags:
    """Return the lowest status per pixel in the order invalid, fallback, normal component only, valid.

    >>> lower_status(np.array([2, 3, 2]), np.array([1, 2, 0])).tolist()
    [1, 3, 0]
    """
    ranks = [_RANKS[np.nan_to_num(values).astype(np.intp)] for values in maps]
    return np.array(_ORDER, dtype=np.uint8)[np.minimum.reduce(ranks)]


def status_of_quantity(values: NDArray[Any], *, components: bool) -> Flags:
    """Return valid where a quantity (all components, first dimension) is finite, and invalid elsewhere."""
    finite = np.isfinite(values)
    return np.where(finite.all(axis=0) if components else finite, STATUS_VALID, STATUS_INVALID).astype(np.uint8)


def compute_validity(maps: Mapping[str, NDArray[Any]], excluded: NDArray[np.bool_] | None = None) -> dict[str, Any]:
    """Return the status, validity and reason for invalidity of every pixel.

    >>> found = compute_validity({"depth": np.array([1.0, np.nan, np.nan])}, np.array([True, True, False]))
    >>> found["status"].tolist(), found["valid"].tolist(), [REASONS[code] for code in found["invalid_reason"]]
    ([2, 0, 0], [True, False, False], ['none', 'masked', 'not_determined'])
    """
    if "status" in maps:
        status = lower_status(maps["status"])
    else:
        parts = []
        for name, quantities in STATUS_SOURCES.items():
            given = next((quantity for quantity in quantities if quantity in maps), None)
            if name in maps:
                parts.append(maps[name])
            elif given is not None:
                parts.append(status_of_quantity(maps[given], components=_has_components(given)))
        status = lower_status(*parts)
    valid = status == STATUS_VALID
    reason = np.where(status == STATUS_NORMAL, _AMBIGUOUS, _NOT_DETERMINED)
    if "invalid_reason" in maps:
        stated = np.nan_to_num(maps["invalid_reason"])
        reason = np.where(stated > 0, stated, reason)
    if excluded is not None:
        reason = np.where(excluded, _MASKED, reason)
    return {"status": status, "valid": valid, "invalid_reason": np.where(valid, 0, reason).astype(np.uint8)}


def complete_validity(estimate: xr.Dataset, recording: xr.Dataset) -> xr.Dataset:
    """Return an estimate with the variables of `VALIDITY_MAPS` added, see `compute_validity`."""
    names = [name for name in ("status", "invalid_reason", *STATUS_SOURCES) if name in estimate]
    names += [name for quantities in STATUS_SOURCES.values() for name in quantities if name in estimate]
    found = compute_validity(
        {name: estimate[name].values for name in names}, excluded_pixels(recording, estimate["t"].values)
    )
    return estimate.assign({name: validity_variable(name, values) for name, values in found.items()})


def validity_variable(name: str, values: NDArray[Any]) -> xr.Variable:
    """Return a map with the dimensions and attributes of its variable."""
    entry = VARIABLES["estimate"][name]
    attrs = {"units": entry.units, "long_name": entry.long_name, **(entry.attrs or {})}
    return xr.Variable(entry.dims, values, attrs, fastpath=True)


def excluded_pixels(recording: xr.Dataset, t: ArrayLike) -> NDArray[np.bool_] | None:
    """Return the exclusion mask of the reference camera, shape (t, y, x), or None without a mask."""
    if "exclusion_mask" not in recording:
        return None
    frames = np.atleast_1d(np.asarray(t))
    mask = recording["exclusion_mask"]
    for dim in ("s_y", "s"):
        if dim in mask.dims:
            places = recording[dim].values
            mask = mask.isel({dim: int(np.argmin(np.abs(places)))})
    values = mask.sel(t=frames).values if "t" in mask.dims else mask.values[None]
    return np.asarray(np.broadcast_to(values, (len(frames), *values.shape[-2:])))


def _has_components(name: str) -> bool:
    return len(VARIABLES["estimate"][name].dims) > len(VARIABLES["estimate"]["depth"].dims)
