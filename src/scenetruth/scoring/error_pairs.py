"""Pairs of estimated and true values of a quantity, and the image and world coordinates of their pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import STATUS_FALLBACK, STATUS_VALID, VARIABLES, Intrinsics, read_intrinsics
from scenetruth.scoring.quantities import QUANTITIES

__all__ = [
    "EstimateTruthPair",
    "EstimateTruthPairs",
    "PixelCoordinates",
    "compute_pixel_coordinates",
    "compute_surface_points",
    "find_valid_pixels",
    "has_common_std",
    "has_quantity",
    "has_std",
    "list_quantities",
    "percent_per_hour",
    "read_common_std",
    "read_pair",
    "read_quantity",
    "read_std",
    "stacked",
]


Map = NDArray[np.float64]


@dataclass(frozen=True)
class PixelCoordinates:
    """Rows ``y`` and columns ``x`` of a map in px of the full image; steps may differ, unlike in a `PixelGrid`."""

    y: Map
    x: Map

    @property
    def step_px(self) -> tuple[float, float]:
        """Distances between neighbouring pixels of the map, along y and along x, in px of the full image."""
        return _step(self.y), _step(self.x)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper border of the map, in px of the full image."""
        (height, width) = (0.5 * step for step in self.step_px)
        x, y = self.x, self.y
        return float(x[0] - width), float(x[-1] + width), float(y[-1] + height), float(y[0] - height)


def compute_pixel_coordinates(dataset: xr.Dataset) -> PixelCoordinates:
    """Return the pixel coordinates y and x of a data set, by default counted from 0."""
    y, x = (
        np.asarray(dataset[dim].values if dim in dataset.coords else np.arange(dataset.sizes[dim]), dtype=np.float64)
        for dim in ("y", "x")
    )
    return PixelCoordinates(y, x)


def compute_surface_points(depth: Map, intrinsics: Intrinsics, grid: PixelCoordinates | None = None) -> Map:
    """Return the surface points X, Y, Z in mm, camera frame, shape (3, y, x), from depth in mm, shape (y, x)."""
    c_x, c_y = intrinsics.principal_point_px
    y, x = (np.arange(size, dtype=np.float64) for size in depth.shape) if grid is None else (grid.y, grid.x)
    scale = depth / intrinsics.focal_length_px
    return np.stack([(x[None, :] - c_x) * scale, (y[:, None] - c_y) * scale, depth])


def _step(places: Map) -> float:
    return float(np.median(np.abs(np.diff(places)))) if places.size > 1 else 1.0


def _compute_slope(normal: Map) -> Map:
    # The slope of a face seen edge-on is infinite.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-normal[:2] / normal[2])


def _compute_mean(principal: Map) -> Map:
    return np.asarray(principal.mean(axis=0))


def _compute_product(principal: Map) -> Map:
    return np.asarray(principal[0] * principal[1])


_FOLLOWS: Mapping[str, tuple[str, Callable[[Map], Map]]] = {
    "slope": ("normal", _compute_slope),
    "mean_curvature": ("curvature", _compute_mean),
    "gaussian_curvature": ("curvature", _compute_product),
}
"""Variables that can be computed from another variable of a truth."""


def list_quantities(dataset: xr.Dataset) -> tuple[str, ...]:
    """Return the scalar quantities of `QUANTITIES` whose variable is in a data set, in the order of the table."""
    return tuple(
        name for name, entry in QUANTITIES.items() if entry.variable in dataset and entry.error == "difference"
    )


def has_quantity(truth: xr.Dataset, name: str) -> bool:
    """Return whether a truth has a quantity, a key of `QUANTITIES`, or the variable from which it is computed."""
    variable = QUANTITIES[name].variable
    return variable in truth or (variable in _FOLLOWS and _FOLLOWS[variable][0] in truth)


def read_quantity(dataset: xr.Dataset, name: str) -> Map:
    """Return a quantity in its units, growth in %/h; float64, shape (t, y, x), vectors (component, t, y, x)."""
    entry = QUANTITIES[name]
    if entry.variable in dataset:
        values = _read(dataset, entry.variable, entry.component)
    else:
        source, follow = _FOLLOWS[entry.variable]
        values = follow(_read(dataset, source, None))
        values = values if entry.component is None else values[entry.component]
    return percent_per_hour(read_intrinsics(dataset)) * values if entry.units == "%/h" else values


def read_std(estimate: xr.Dataset, name: str) -> Map | None:
    """Return the stated standard deviation of a quantity, in its units, float64, shape (t, y, x); None if missing."""
    return _read_std(estimate, name, "_std") if has_std(estimate, name) else None


def read_common_std(estimate: xr.Dataset, name: str) -> Map | None:
    """Return the part of a stated standard deviation that pixels have in common, as `read_std`; None if missing."""
    return _read_std(estimate, name, "_std_common") if has_common_std(estimate, name) else None


def _read_std(estimate: xr.Dataset, name: str, ending: str) -> Map:
    entry = QUANTITIES[name]
    values = _read(estimate, f"{entry.variable}{ending}", entry.component)
    if entry.units == "%/h":
        return percent_per_hour(read_intrinsics(estimate)) * values
    # Angles are stored in radians.
    return np.degrees(values) if entry.units == "°" else values


def has_std(estimate: xr.Dataset, name: str) -> bool:
    """Return whether an estimate states the standard deviation of a quantity, a key of `QUANTITIES`."""
    variable = f"{QUANTITIES[name].variable}_std"
    # Only the variables of the data model have been checked for their dimensions. A distance has no standard deviation.
    return variable in estimate and variable in VARIABLES["estimate"] and QUANTITIES[name].error != "distance"


def has_common_std(estimate: xr.Dataset, name: str) -> bool:
    """Return whether an estimate states the part of a standard deviation that pixels have in common."""
    return has_std(estimate, name) and f"{QUANTITIES[name].variable}_std_common" in estimate


def percent_per_hour(intrinsics: Intrinsics) -> float:
    """Return the factor from 1/frame to %/h."""
    return 100.0 * 3600.0 / intrinsics.frame_interval_s


def find_valid_pixels(estimate: xr.Dataset, variable: str, *, include_fallback: bool = False) -> NDArray[np.bool_]:
    """Return where an estimate of a variable is valid; bool, shape (t, y, x).

    ``status_disparity`` applies to depth, disparity and surface shape, ``status_motion`` to flow, and both to
    velocity, growth and rotation. A missing map is replaced by ``status``; without ``status`` all pixels are valid.
    ``include_fallback``: Whether fallback values count as valid.
    """
    needs = next(entry.needs for entry in QUANTITIES.values() if entry.variable == variable)
    statuses = [f"status_{need}" for need in needs]
    full = np.ones([estimate.sizes[dim] for dim in ("t", "y", "x")], dtype=bool)
    for name in {one if one in estimate else "status" for one in statuses} & set(estimate):
        status = estimate[name].values
        full &= (status == STATUS_VALID) | (include_fallback & (status == STATUS_FALLBACK))
    return full


@dataclass(frozen=True)
class EstimateTruthPair:
    """Estimated and true values of one quantity in the same units and shape, components first; NaN where undefined.

    ``full``: Where the estimate is valid; everywhere if None. ``std``: The stated standard deviation, or None.
    """

    estimate: Map
    truth: Map
    full: NDArray[np.bool_] | None = None
    std: Map | None = None

    def at(self, region: NDArray[np.bool_]) -> EstimateTruthPair:
        """Return the values in a region as one-dimensional arrays."""
        return EstimateTruthPair(
            self.estimate[region],
            self.truth[region],
            None if self.full is None else self.full[region],
            None if self.std is None else self.std[region],
        )


def read_pair(
    estimate: xr.Dataset, truth: xr.Dataset, name: str, *, include_fallback: bool = False
) -> EstimateTruthPair:
    """Return one quantity of an estimate and its truth as arrays of the shape (t, y, x)."""
    return EstimateTruthPair(
        read_quantity(estimate, name),
        read_quantity(truth, name),
        find_valid_pixels(estimate, QUANTITIES[name].variable, include_fallback=include_fallback),
        read_std(estimate, name),
    )


class EstimateTruthPairs(Mapping[str, EstimateTruthPair]):
    """Common quantities of aligned data sets, and ``further`` quantities, by keys of `QUANTITIES`; read on access."""

    def __init__(
        self,
        estimate: xr.Dataset,
        truth: xr.Dataset,
        further: Mapping[str, EstimateTruthPair] | None = None,
        *,
        include_fallback: bool = False,
    ) -> None:
        self._estimate, self._truth, self._include_fallback = estimate, truth, include_fallback
        self._further = further or {}
        self._names = tuple(
            name for name, entry in QUANTITIES.items() if entry.variable in estimate and has_quantity(truth, name)
        )

    def __getitem__(self, name: str) -> EstimateTruthPair:
        if name not in self._names:
            return self._further[name]
        return read_pair(self._estimate, self._truth, name, include_fallback=self._include_fallback)

    def __iter__(self) -> Iterator[str]:
        # In the order of the table.
        yield from (name for name in QUANTITIES if name in self)

    def __len__(self) -> int:
        return len({*self._names, *self._further})

    def __contains__(self, name: object) -> bool:
        return name in self._names or name in self._further


def stacked(pairs: Mapping[str, EstimateTruthPair], names: Sequence[str]) -> EstimateTruthPair:
    """Return several quantities as vectors of the shape (component, ...), valid where all components are valid."""
    some = [pairs[name] for name in names]
    known = [pair.full for pair in some if pair.full is not None]
    return EstimateTruthPair(
        np.stack([pair.estimate for pair in some]),
        np.stack([pair.truth for pair in some]),
        np.logical_and.reduce(known) if known else None,
    )


def _read(dataset: xr.Dataset, variable: str, component: int | None) -> Map:
    array = dataset[variable]
    if component is not None:
        array = array[component]
    values: Map = np.asarray(array.values, dtype=np.float64)
    return values
