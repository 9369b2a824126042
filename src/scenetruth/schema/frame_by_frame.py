"""Estimates of many frames, made by `make_estimate` one frame at a time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.schema.attributes import intrinsics_of
from scenetruth.schema.estimate import make_estimate
from scenetruth.schema.filling import Put, blank_map
from scenetruth.schema.labelling import label
from scenetruth.schema.pixels import pixel_grid_of
from scenetruth.schema.three_d_motion import depth_of_disparity, depth_rate_at
from scenetruth.schema.variables import COMPONENTS, VARIABLES

__all__ = ["blank_estimate", "depth_rate_of", "put_each", "put_estimate"]

Map = NDArray[np.float64]


def blank_estimate(given: Iterable[str], *, like: xr.Dataset, t: ArrayLike) -> xr.Dataset:
    """Return an estimate with blank maps, of all variables that `make_estimate` makes of some quantities.

    Parameters
    ----------
    given
        Names of the arrays that `make_estimate` is to be given for every frame, such as ``"disparity"``.
    like
        The recording.
    t
        The frames of the estimate.

    Examples
    --------
    >>> from scenetruth.schema import make_recording
    >>> recording = make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> blank = blank_estimate(["disparity"], like=recording, t=[0, 1])
    >>> sorted(blank.data_vars), blank["depth"].shape
    (['depth', 'disparity', 'kind', 'kind_disparity'], (2, 30, 40))
    """
    # Which variables follow does not depend on how many pixels there are.
    corner = like.isel(y=slice(0, 2), x=slice(0, 2))
    size = (1, corner.sizes["y"], corner.sizes["x"])
    unknown: dict[str, Any] = {name: np.full((*_components(name), *size), np.nan) for name in given}
    made = make_estimate(like=corner, t=like["t"].values[:1], **unknown)
    frames = np.atleast_1d(np.asarray(t))
    sizes = {**made.sizes, "t": len(frames), "y": like.sizes["y"], "x": like.sizes["x"]}
    return label(
        "estimate",
        {str(name): blank_map(item.dtype, [sizes[dim] for dim in item.dims]) for name, item in made.data_vars.items()},
        intrinsics_of(like),
        t=frames,
        **{name: like[name].values for name in ("x", "y") if name in like.coords},
        attrs={key: value for key, value in made.attrs.items() if key != "estimate_hash"},
    )


def put_estimate(found: xr.Dataset, first: int, put: Put) -> None:
    """Put the maps of an estimate of successive frames into one of more frames.

    Parameters
    ----------
    found
        The estimate of some frames.
    first
        Place of its first frame along t in the other.
    put
        Takes the maps.
    """
    for name, item in found.data_vars.items():
        for frame in range(found.sizes["t"]):
            put(str(name), {"t": first + frame}, item.isel(t=frame).values)


def put_each(name: str, arrays: Iterable[Map], put: Put, *, like: xr.Dataset) -> None:
    """Put what `make_estimate` makes of one quantity, frame after frame, from the recording's first on.

    Parameters
    ----------
    name
        Name of the quantity, such as ``"disparity"``.
    arrays
        Its arrays, one for each frame.
    put
        Takes the maps.
    like
        The recording.
    """
    times = like["t"].values
    for place, values in enumerate(arrays):
        given: dict[str, Any] = {name: values}
        put_estimate(make_estimate(like=like, t=times[place], **given), place, put)


def depth_rate_of(disparities: Mapping[int, Map], flow: Map, *, like: xr.Dataset) -> Map:
    """Return the rate of depth in a frame, as `make_estimate` takes it from neighbouring frames.

    Parameters
    ----------
    disparities
        Disparity in px per step in the frame (0), and in that before (-1) and behind it (1), as far as there are such.
    flow
        (dx/dt, dy/dt) in px per frame, shape (2, y, x).
    like
        The recording.

    Returns
    -------
    numpy.ndarray
        dZ/dt in mm per frame, shape (y, x); NaN where no neighbour shows the point.
    """
    intrinsics = intrinsics_of(like)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        depths = {step: depth_of_disparity(disparity, intrinsics) for step, disparity in disparities.items()}
        grid = pixel_grid_of(like).positions(like.sizes["y"], like.sizes["x"])
        return depth_rate_at(depths.pop(0), flow, depths, grid)


def _components(name: str) -> list[int]:
    """Return the sizes that an array has before t."""
    entry = VARIABLES["estimate"].get(name)
    return [] if entry is None else [len(COMPONENTS[dim]) for dim in entry.dims if dim in COMPONENTS]
