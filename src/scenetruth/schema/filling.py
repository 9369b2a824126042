"""Data sets that are filled image by image."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

__all__ = ["Filling", "Put", "blank_map"]

Put = Callable[[str, Mapping[str, int], NDArray[Any]], None]
"""Takes an image or a map: the variable, the place along its leading dimensions from 0 on, the values. The values must
not be changed afterwards."""


def blank_map(dtype: DTypeLike, shape: Sequence[int]) -> NDArray[Any]:
    """Return an array that takes no memory: all of its values are one, a zero that cannot be written to.

    Examples
    --------
    >>> blank_map(np.uint8, (2, 3)).tolist()
    [[0, 0, 0], [0, 0, 0]]
    """
    return np.broadcast_to(np.zeros((), dtype=dtype), tuple(shape))


class Filling:
    """A data set in memory whose maps are put in one by one.

    Parameters
    ----------
    blank
        The data set with blank maps (`blank_map`); its other variables stay as they are.

    Examples
    --------
    >>> filling = Filling(xr.Dataset({"depth": (("t", "y", "x"), blank_map(float, (2, 1, 2)))}))
    >>> for t in (0, 1):
    ...     filling.put("depth", {"t": t}, np.array([[1.0, 2.0 + t]]))
    >>> filling.dataset()["depth"].values.tolist()
    [[[1.0, 2.0]], [[1.0, 3.0]]]
    """

    def __init__(self, blank: xr.Dataset) -> None:
        self._blank = blank
        self._arrays: dict[str, NDArray[Any]] = {}

    def put(self, name: str, at: Mapping[str, int], values: NDArray[Any]) -> None:
        """Put values in their place; see `Put`."""
        variable = self._blank.variables[name]
        if name not in self._arrays:
            self._arrays[name] = np.empty(variable.shape, dtype=variable.dtype)
        place = tuple(at.get(str(dim), slice(None)) for dim in variable.dims)
        self._arrays[name][place] = values

    def dataset(self) -> xr.Dataset:
        """Return the filled data set; it shares the arrays."""
        variables = {name: self._blank.variables[name] for name in self._arrays}
        return self._blank.assign(
            {name: (item.dims, self._arrays[name], item.attrs) for name, item in variables.items()}
        )
