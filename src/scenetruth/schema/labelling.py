"""Names, coordinates and units for plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from scenetruth.indexing import centred_indices
from scenetruth.schema.attributes import Intrinsics
from scenetruth.schema.variables import COMPONENTS, COORDINATES, FORMAT_VERSION, VARIABLES, Variable

__all__ = ["label"]


def label(
    kind: str,
    arrays: Mapping[str, ArrayLike],
    intrinsics: Intrinsics,
    *,
    t: ArrayLike,
    s: ArrayLike | None = None,
    stage_x_mm: ArrayLike | None = None,
    stage_y_mm: ArrayLike | None = None,
    x: ArrayLike | None = None,
    y: ArrayLike | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Put names, coordinates and units on plain arrays.

    Parameters
    ----------
    kind
        ``"recording"``, ``"truth"`` or ``"estimate"``: which table of `VARIABLES` holds.
    arrays
        The arrays by name. An array with one dimension more than its table says has ``s`` before ``t``; an image then
        has ``channel`` behind ``x``. Whatever has ``s`` has ``s_y`` before it if ``stage_y_mm`` is given.
    intrinsics
        Focal length, principal point, baseline, frame interval.
    t, s
        The frame and camera indices, 0 the reference.
    stage_x_mm
        The camera's position for every s; ``baseline_mm * s`` if not given.
    stage_y_mm
        The position of every row of a grid of cameras; the cameras stand in one row if not given.
    x, y
        Pixel indices of the columns and rows; all pixels from 0 on if not given. The intrinsics hold for these indices.
    attrs
        More attributes.

    Returns
    -------
    xarray.Dataset
        With ``units`` and ``long_name`` on every variable and coordinate.
    """
    variables: dict[str, xr.Variable] = {}
    for name, array in arrays.items():
        entry = VARIABLES[kind][name]
        values = np.asarray(array)
        dims = _dims_of(kind, entry, values.ndim, rows=stage_y_mm is not None)
        variables[name] = xr.Variable(
            dims, values, {"units": entry.units, "long_name": entry.long_name, **(entry.attrs or {})}
        )
    sizes = {dim: size for variable in variables.values() for dim, size in variable.sizes.items()}
    # Coordinates are copies: what a caller changes later is not ours, and the other way round.
    frames = np.array(t, dtype=np.int64)
    coordinates: dict[str, tuple[str, ArrayLike]] = {
        "t": ("t", frames),
        "time_s": ("t", frames * intrinsics.frame_interval_s),
        "y": ("y", np.arange(sizes["y"]) if y is None else np.array(y)),
        "x": ("x", np.arange(sizes["x"]) if x is None else np.array(x)),
    }
    if "s" in sizes:
        steps = centred_indices(sizes["s"]) if s is None else np.array(s, dtype=np.int64)
        positions = intrinsics.baseline_mm * steps if stage_x_mm is None else np.array(stage_x_mm, dtype=np.float64)
        coordinates |= {"s": ("s", steps), "stage_x_mm": ("s", positions)}
    if "s_y" in sizes:
        below = np.array(stage_y_mm, dtype=np.float64)
        coordinates |= {"s_y": ("s_y", centred_indices(sizes["s_y"])), "stage_y_mm": ("s_y", below)}
    for name, names in COMPONENTS.items():
        if name in sizes:
            coordinates[name] = (name, names)
    if "rank" in sizes:
        coordinates["rank"] = ("rank", np.arange(1, sizes["rank"] + 1))
    dataset = xr.Dataset(
        variables,
        coords={
            name: xr.Variable(dim, values, {"units": COORDINATES[name][0], "long_name": COORDINATES[name][1]})
            for name, (dim, values) in coordinates.items()
        },
    )
    dataset.attrs = {
        "scenetruth": kind,
        "format_version": FORMAT_VERSION,
        **intrinsics.to_attrs(),
        **(attrs or {}),
    }
    return dataset


def _dims_of(kind: str, entry: Variable, count: int, *, rows: bool) -> tuple[str, ...]:
    """Return the names of an array's dimensions, from how many it has."""
    dims = entry.dims
    if rows and "s" in dims:
        at = dims.index("s")
        dims = (*dims[:at], "s_y", *dims[at:])
    if count == len(dims):
        return dims
    if kind == "recording":
        return (*dims, "channel")
    at = dims.index("t")
    return (*dims[:at], *(("s_y", "s") if rows else ("s",)), *dims[at:])
