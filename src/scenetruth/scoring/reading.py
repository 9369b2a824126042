"""Reading the quantities that are scored from an estimate and from its truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import KIND_FULL, VARIABLES, Intrinsics, intrinsics_of
from scenetruth.scoring.quantities import QUANTITIES

__all__ = [
    "Pair",
    "Pairs",
    "full_pixels",
    "has_std",
    "percent_per_hour",
    "quantities_of",
    "read_pair",
    "read_quantity",
    "read_std",
    "stacked",
    "tells",
]

Map = NDArray[np.float64]


def _slope_of(normal: Map) -> Map:
    # Of a face seen edge-on the slope is infinite.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-normal[:2] / normal[2])


def _mean_of(principal: Map) -> Map:
    return np.asarray(principal.mean(axis=0))


def _product_of(principal: Map) -> Map:
    return np.asarray(principal[0] * principal[1])


_FOLLOWS: Mapping[str, tuple[str, Callable[[Map], Map]]] = {
    "slope": ("normal", _slope_of),
    "mean_curvature": ("curvature", _mean_of),
    "gaussian_curvature": ("curvature", _product_of),
}
"""Variables that follow from another one, which a truth may have instead."""


def quantities_of(dataset: xr.Dataset) -> tuple[str, ...]:
    """Return those scalars of `QUANTITIES` whose variable a data set has, in the order of the table."""
    return tuple(
        name for name, entry in QUANTITIES.items() if entry.variable in dataset and entry.error == "difference"
    )


def tells(truth: xr.Dataset, name: str) -> bool:
    """Return whether a truth has a quantity, a key of `QUANTITIES`, or what it follows from."""
    variable = QUANTITIES[name].variable
    return variable in truth or (variable in _FOLLOWS and _FOLLOWS[variable][0] in truth)


def read_quantity(dataset: xr.Dataset, name: str) -> Map:
    """Read one quantity of a truth or an estimate.

    Parameters
    ----------
    dataset
        A truth of one camera, or an estimate.
    name
        A key of `QUANTITIES`.

    Returns
    -------
    numpy.ndarray
        float64, shape (t, y, x), of whole vectors (component, t, y, x); NaN where there is none. Growth is in % per
        hour, all else in the units of the variable.
    """
    entry = QUANTITIES[name]
    if entry.variable in dataset:
        values = _read(dataset, entry.variable, entry.component)
    else:
        source, follow = _FOLLOWS[entry.variable]
        values = follow(_read(dataset, source, None))
        values = values if entry.component is None else values[entry.component]
    return percent_per_hour(intrinsics_of(dataset)) * values if entry.units == "%/h" else values


def read_std(estimate: xr.Dataset, name: str) -> Map | None:
    """Read the standard deviation that an estimate states for one quantity.

    Parameters
    ----------
    estimate
        An estimate.
    name
        A key of `QUANTITIES`.

    Returns
    -------
    numpy.ndarray or None
        float64, shape (t, y, x), in the quantity's units, NaN where there is none; None where the estimate has no
        standard deviation of this quantity.
    """
    if not has_std(estimate, name):
        return None
    entry = QUANTITIES[name]
    values = _read(estimate, f"{entry.variable}_std", entry.component)
    if entry.units == "%/h":
        return percent_per_hour(intrinsics_of(estimate)) * values
    # Angles are stored in radians.
    return np.degrees(values) if entry.units == "°" else values


def has_std(estimate: xr.Dataset, name: str) -> bool:
    """Return whether an estimate states the standard deviation of a quantity, a key of `QUANTITIES`."""
    variable = f"{QUANTITIES[name].variable}_std"
    # Only the agreed variables have been checked to have the quantity's dimensions. A distance has none.
    return variable in estimate and variable in VARIABLES["estimate"] and QUANTITIES[name].error != "distance"


def percent_per_hour(intrinsics: Intrinsics) -> float:
    """Return the factor from 1/frame to % per hour."""
    return 100.0 * 3600.0 / intrinsics.frame_interval_s


def full_pixels(estimate: xr.Dataset, variable: str) -> NDArray[np.bool_]:
    """Return where an estimate claims to know a variable.

    Depth, disparity and the shape of the surface are known where ``kind_disparity`` is full, flow where
    ``kind_motion`` is full, velocity, growth and rotation where both are. Where the estimate lacks one of the two,
    ``kind`` takes its place; without ``kind``, every pixel counts as known.

    Parameters
    ----------
    estimate
        An estimate.
    variable
        The variable of one of `QUANTITIES`.

    Returns
    -------
    numpy.ndarray
        bool, shape (t, y, x).
    """
    needs = next(entry.needs for entry in QUANTITIES.values() if entry.variable == variable)
    kinds = [f"kind_{need}" for need in needs]
    full = np.ones([estimate.sizes[dim] for dim in ("t", "y", "x")], dtype=bool)
    for name in {kind if kind in estimate else "kind" for kind in kinds} & set(estimate):
        full &= estimate[name].values == KIND_FULL
    return full


@dataclass(frozen=True)
class Pair:
    """What is compared of one quantity; all arrays have the same shape.

    Parameters
    ----------
    estimate, truth
        The two maps, in the same units; NaN where there is none. Of vectors, the components come first.
    full
        Where the estimate claims to know the quantity; everywhere if None.
    std
        The standard deviation that the estimate states, or None.
    """

    estimate: Map
    truth: Map
    full: NDArray[np.bool_] | None = None
    std: Map | None = None

    def at(self, region: NDArray[np.bool_]) -> Pair:
        """Return the values in a region, as one row."""
        return Pair(
            self.estimate[region],
            self.truth[region],
            None if self.full is None else self.full[region],
            None if self.std is None else self.std[region],
        )


def read_pair(estimate: xr.Dataset, truth: xr.Dataset, name: str) -> Pair:
    """Read one quantity of an estimate, and its truth, as arrays of the shape (t, y, x).

    Parameters
    ----------
    estimate, truth
        Aligned data sets.
    name
        A key of `QUANTITIES` that the estimate has and the truth tells.
    """
    return Pair(
        read_quantity(estimate, name),
        read_quantity(truth, name),
        full_pixels(estimate, QUANTITIES[name].variable),
        read_std(estimate, name),
    )


class Pairs(Mapping[str, Pair]):
    """The quantities of an estimate that its truth tells, by the keys of `QUANTITIES`; read when they are looked up.

    Parameters
    ----------
    estimate, truth
        Aligned data sets.
    further
        More quantities, of which the estimate itself has none.
    """

    def __init__(self, estimate: xr.Dataset, truth: xr.Dataset, further: Mapping[str, Pair] | None = None) -> None:
        self._estimate, self._truth = estimate, truth
        self._further = further or {}
        self._names = tuple(
            name for name, entry in QUANTITIES.items() if entry.variable in estimate and tells(truth, name)
        )

    def __getitem__(self, name: str) -> Pair:
        return read_pair(self._estimate, self._truth, name) if name in self._names else self._further[name]

    def __iter__(self) -> Iterator[str]:
        # In the order of the table.
        yield from (name for name in QUANTITIES if name in self)

    def __len__(self) -> int:
        return len({*self._names, *self._further})

    def __contains__(self, name: object) -> bool:
        return name in self._names or name in self._further


def stacked(pairs: Mapping[str, Pair], names: Sequence[str]) -> Pair:
    """Return several quantities as vectors: estimate and truth of the shape (component, ...), known where all are."""
    some = [pairs[name] for name in names]
    known = [pair.full for pair in some if pair.full is not None]
    return Pair(
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
