"""The quantities that are scored: their names, units, symbols, and where a data set keeps them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import KIND_FULL, VARIABLES

__all__ = [
    "ENDPOINT",
    "GROWTH_QUANTITIES",
    "OUTLIERS",
    "QUANTITIES",
    "QUANTITY_GROUPS",
    "Pair",
    "Pairs",
    "Quantity",
    "full_pixels",
    "has_std",
    "quantities_of",
    "read_quantity",
    "read_std",
    "stacked",
    "title_of",
    "units_of",
]

Map = NDArray[np.float64]

ENDPOINT = "velocity_endpoint"
"""Name of the Euclidean distance between the estimated and the true velocity."""

OUTLIERS = "outliers"
"""Name of the rates of outliers."""


GROWTH_QUANTITIES: Mapping[str, str] = {
    "growth_rate": "Growth rate",
    "growth_rate_windowed": "Growth rate, windowed",
}
"""The titles of the two scores of the growth rate: against the truth of every pixel, and against the truth seen through
the estimate's window."""


@dataclass(frozen=True)
class Quantity:
    """A scalar map of a data set.

    Parameters
    ----------
    variable
        The variable of the data set that holds it.
    component
        Index along the variable's first dimension, or None for a scalar variable.
    units
        Its units, in plain text.
    symbol
        Its symbol, in plain text.
    title
        What it is, in words.
    """

    variable: str
    component: int | None
    units: str
    symbol: str
    title: str


QUANTITIES: Mapping[str, Quantity] = {
    "depth": Quantity("depth", None, "mm", "Z", "Depth"),
    "disparity": Quantity("disparity", None, "px/step", "d", "Disparity"),
    "velocity_x": Quantity("velocity", 0, "mm/frame", "U_X", "Velocity in X"),
    "velocity_y": Quantity("velocity", 1, "mm/frame", "U_Y", "Velocity in Y"),
    "velocity_z": Quantity("velocity", 2, "mm/frame", "U_Z", "Velocity in Z"),
    "flow_x": Quantity("flow", 0, "px/frame", "dx/dt", "Optical flow in x"),
    "flow_y": Quantity("flow", 1, "px/frame", "dy/dt", "Optical flow in y"),
}
"""The scalar quantities by name, in the order in which they are reported."""

QUANTITY_GROUPS: Mapping[str, tuple[str, ...]] = {
    "depth": ("depth",),
    "disparity": ("disparity",),
    "velocity": ("velocity_x", "velocity_y", "velocity_z", ENDPOINT),
    "flow": ("flow_x", "flow_y"),
    "growth": tuple(GROWTH_QUANTITIES),
}
"""What is scored, and the names under which a score has its errors: all of them or none."""

_KINDS = {
    "depth": ("kind_disparity",),
    "disparity": ("kind_disparity",),
    "flow": ("kind_motion",),
    "velocity": ("kind_disparity", "kind_motion"),
}
"""What must be full for a variable to be known: a velocity needs both the flow and the depth."""


def title_of(name: str) -> str:
    """Return what a scored quantity is, in words."""
    if name == ENDPOINT:
        return "Velocity endpoint"
    if name == OUTLIERS:
        return "Outliers"
    return GROWTH_QUANTITIES.get(name) or QUANTITIES[name].title


def quantities_of(dataset: xr.Dataset) -> tuple[str, ...]:
    """Return those names of `QUANTITIES` whose variable a data set has, in the order of the table."""
    return tuple(name for name, entry in QUANTITIES.items() if entry.variable in dataset)


def units_of(name: str) -> str:
    """Return the units of a scored quantity's errors, in plain text; ``"1"`` for rates."""
    if name == ENDPOINT:
        return QUANTITIES["velocity_z"].units
    if name in GROWTH_QUANTITIES:
        return "%/h"
    return QUANTITIES[name].units if name in QUANTITIES else "1"


def read_quantity(dataset: xr.Dataset, name: str) -> Map:
    """Read one scalar quantity of a truth or an estimate.

    Parameters
    ----------
    dataset
        A truth of one camera, or an estimate.
    name
        A key of `QUANTITIES`.

    Returns
    -------
    numpy.ndarray
        float64, shape (t, y, x), in the quantity's units; NaN where there is none.
    """
    entry = QUANTITIES[name]
    return _read(dataset, entry.variable, entry.component)


def read_std(estimate: xr.Dataset, name: str) -> Map | None:
    """Read the standard deviation that an estimate states for one scalar quantity.

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
    entry = QUANTITIES[name]
    return _read(estimate, f"{entry.variable}_std", entry.component) if has_std(estimate, name) else None


def has_std(estimate: xr.Dataset, name: str) -> bool:
    """Return whether an estimate states the standard deviation of a scalar quantity, a key of `QUANTITIES`."""
    variable = f"{QUANTITIES[name].variable}_std"
    # Only the agreed variables have been checked to have the quantity's dimensions.
    return variable in estimate and variable in VARIABLES["estimate"]


def full_pixels(estimate: xr.Dataset, variable: str) -> NDArray[np.bool_]:
    """Return where an estimate claims to know a variable.

    Depth and disparity are known where ``kind_disparity`` is full, flow where ``kind_motion`` is full, and velocity
    where both are. Where the estimate lacks one of the two, ``kind`` takes its place; without ``kind``, every pixel
    counts as known.

    Parameters
    ----------
    estimate
        An estimate.
    variable
        ``"depth"``, ``"disparity"``, ``"flow"`` or ``"velocity"``.

    Returns
    -------
    numpy.ndarray
        bool, shape (t, y, x).
    """
    full = np.ones([estimate.sizes[dim] for dim in ("t", "y", "x")], dtype=bool)
    for name in {kind if kind in estimate else "kind" for kind in _KINDS[variable]} & set(estimate):
        full &= estimate[name].values == KIND_FULL
    return full


@dataclass(frozen=True)
class Pair:
    """What is compared of one scalar quantity; all arrays have the same shape.

    Parameters
    ----------
    estimate, truth
        The two maps, in the same units; NaN where there is none.
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
        One of `quantities_of` the estimate.
    """
    return Pair(
        read_quantity(estimate, name),
        read_quantity(truth, name),
        full_pixels(estimate, QUANTITIES[name].variable),
        read_std(estimate, name),
    )


class Pairs(Mapping[str, Pair]):
    """The quantities of an estimate and their truth, by the names of `quantities_of`; read when they are looked up.

    Parameters
    ----------
    estimate, truth
        Aligned data sets.
    further
        More quantities, behind these.
    """

    def __init__(self, estimate: xr.Dataset, truth: xr.Dataset, further: Mapping[str, Pair] | None = None) -> None:
        self._estimate, self._truth = estimate, truth
        self._further = further or {}
        self._names = quantities_of(estimate)

    def __getitem__(self, name: str) -> Pair:
        return read_pair(self._estimate, self._truth, name) if name in self._names else self._further[name]

    def __iter__(self) -> Iterator[str]:
        yield from self._names
        yield from self._further

    def __len__(self) -> int:
        return len(self._names) + len(self._further)

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
