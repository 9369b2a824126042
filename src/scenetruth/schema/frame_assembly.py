"""Incremental assembly of data sets, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from scenetruth.lazy_exports import lazy_module
from scenetruth.schema.attributes import read_intrinsics
from scenetruth.schema.estimates import assemble_estimate
from scenetruth.schema.pixel_grid import compute_pixel_grid
from scenetruth.schema.scene_flow import depth_from_disparity, depth_rate_at
from scenetruth.schema.variables import COMPONENTS, VARIABLES, label

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["IncrementalDataset", "Put", "blank_estimate", "blank_map", "compute_depth_rate", "put_each", "put_estimate"]


Put = Callable[[str, Mapping[str, int], NDArray[Any]], None]
"""Sink for an image or map: variable, index along the leading dimensions, and values, not to be modified afterwards."""


def blank_map(dtype: DTypeLike, shape: Sequence[int]) -> NDArray[Any]:
    """Return a read-only array of zeros that occupies no memory.

    >>> blank_map(np.uint8, (2, 3)).tolist()
    [[0, 0, 0], [0, 0, 0]]
    """
    return np.broadcast_to(np.zeros((), dtype=dtype), tuple(shape))


class IncrementalDataset:
    """A data set in memory whose blank maps (`blank_map`) are filled map by map.

    >>> filling = IncrementalDataset(xr.Dataset({"depth": (("t", "y", "x"), blank_map(float, (2, 1, 2)))}))
    >>> for t in (0, 1):
    ...     filling.put("depth", {"t": t}, np.array([[1.0, 2.0 + t]]))
    >>> filling.dataset()["depth"].values.tolist()
    [[[1.0, 2.0]], [[1.0, 3.0]]]
    """

    def __init__(self, blank: xr.Dataset) -> None:
        self._blank = blank
        self._arrays: dict[str, NDArray[Any]] = {}

    def put(self, name: str, at: Mapping[str, int], values: NDArray[Any]) -> None:
        """Store values at an index, see `Put`."""
        variable = self._blank.variables[name]
        if name not in self._arrays:
            self._arrays[name] = np.empty(variable.shape, dtype=variable.dtype)
        place = tuple(at.get(str(dim), slice(None)) for dim in variable.dims)
        self._arrays[name][place] = values

    def dataset(self) -> xr.Dataset:
        """Return the filled data set, which shares the arrays."""
        # Unlike with `assign`, nothing is aligned and merged. For arrays outside of variables, xarray imports Dask.
        data = {str(name): self._blank.variables[name] for name in self._blank.data_vars}
        for name, values in self._arrays.items():
            data[name] = xr.Variable(data[name].dims, values, fastpath=True)
        return self._blank.copy(data=data)


Map = NDArray[np.float64]


def blank_estimate(given: Iterable[str], *, recording: xr.Dataset, t: ArrayLike) -> xr.Dataset:
    """Return an estimate with blank maps for all variables that `make_estimate` derives from the given quantities.

    >>> from scenetruth.schema import make_recording
    >>> recording = make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> blank = blank_estimate(["disparity"], recording=recording, t=[0, 1])
    >>> sorted(blank.data_vars), blank["depth"].shape
    (['depth', 'disparity', 'invalid_reason', 'status', 'status_disparity', 'valid'], (2, 30, 40))
    """
    # The set of derived variables does not depend on the image size.
    corner = recording.isel(y=slice(0, 2), x=slice(0, 2))
    size = (1, corner.sizes["y"], corner.sizes["x"])
    unknown: dict[str, Any] = {name: np.full((*_components(name), *size), np.nan) for name in given}
    made = assemble_estimate(recording=corner, t=recording["t"].values[:1], **unknown)
    frames = np.atleast_1d(np.asarray(t))
    sizes = {**made.sizes, "t": len(frames), "y": recording.sizes["y"], "x": recording.sizes["x"]}
    return label(
        "estimate",
        {str(name): blank_map(item.dtype, [sizes[dim] for dim in item.dims]) for name, item in made.data_vars.items()},
        read_intrinsics(recording),
        t=frames,
        **{name: recording[name].values for name in ("x", "y") if name in recording.coords},
        attrs={key: value for key, value in made.attrs.items() if key != "estimate_hash"},
    )


def put_estimate(found: xr.Dataset, first: int, put: Put) -> None:
    """Store the maps of an estimate from frame index ``first`` on."""
    for name, item in found.data_vars.items():
        for frame in range(found.sizes["t"]):
            put(str(name), {"t": first + frame}, item.isel(t=frame).values)


def put_each(name: str, arrays: Iterable[Map], put: Put, *, recording: xr.Dataset) -> None:
    """Store the variables that `make_estimate` derives from one quantity, frame by frame from the first frame."""
    times = recording["t"].values
    for place, values in enumerate(arrays):
        given: dict[str, Any] = {name: values}
        put_estimate(assemble_estimate(recording=recording, t=times[place], **given), place, put)


def compute_depth_rate(disparities: Mapping[int, Map], flow: Map, *, recording: xr.Dataset) -> Map:
    """Return dZ/dt in mm per frame from the neighbouring frames, as in `make_estimate`; NaN where none shows the point.

    ``disparities``: Disparity in px per step of the frame (0) and, if available, of the previous (-1) and next (1).
    ``flow``: (dx/dt, dy/dt) in px per frame, shape (2, y, x).
    """
    intrinsics = read_intrinsics(recording)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        depths = {step: depth_from_disparity(disparity, intrinsics) for step, disparity in disparities.items()}
        grid = compute_pixel_grid(recording).positions(recording.sizes["y"], recording.sizes["x"])
        return depth_rate_at(depths.pop(0), flow, depths, grid)


def _components(name: str) -> list[int]:
    """Return the sizes of the dimensions before t."""
    entry = VARIABLES["estimate"].get(name)
    return [] if entry is None else [len(COMPONENTS[dim]) for dim in entry.dims if dim in COMPONENTS]
