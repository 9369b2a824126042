"""Data sets as names, dimensions and attributes, without xarray, which takes half a second to import."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["DatasetOutline", "OutlineVariable", "with_indexes"]


@dataclass(frozen=True, eq=False)
class OutlineVariable:
    """Variable of an outline, with the attributes of an `xarray.Variable` that describe it."""

    dims: tuple[str, ...]
    values: NDArray[Any]
    attrs: dict[str, Any]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type."""
        return self.values.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """Size along each dimension."""
        return self.values.shape

    @property
    def ndim(self) -> int:
        """Number of dimensions."""
        return self.values.ndim

    @property
    def sizes(self) -> dict[str, int]:
        """Size by dimension."""
        return dict(zip(self.dims, self.values.shape, strict=True))


@dataclass(frozen=True, eq=False)
class DatasetOutline:
    """Variables, coordinates and attributes of a data set, with the names that an `xarray.Dataset` has for them.

    Stores are written from it, and validated.
    """

    data_vars: Mapping[Any, OutlineVariable]
    coords: Mapping[Any, OutlineVariable]
    attrs: dict[str, Any]

    @property
    def variables(self) -> dict[Any, OutlineVariable]:
        """Data variables and coordinates."""
        return {**self.data_vars, **self.coords}

    @property
    def sizes(self) -> dict[str, int]:
        """Size by dimension."""
        return {dim: size for variable in self.variables.values() for dim, size in variable.sizes.items()}

    dims = sizes

    def __contains__(self, name: object) -> bool:
        return name in self.data_vars or name in self.coords

    def __getitem__(self, name: Hashable) -> OutlineVariable:
        return self.variables[name]

    def assign(self, variables: Mapping[Any, tuple[Any, NDArray[Any], dict[Any, Any]]]) -> DatasetOutline:
        """Return an outline with other or further data variables."""
        return replace(self, data_vars={**self.data_vars, **{n: OutlineVariable(*v) for n, v in variables.items()}})

    def assign_attrs(self, attrs: Mapping[str, Any]) -> DatasetOutline:
        """Return an outline with other or further attributes."""
        return replace(self, attrs={**self.attrs, **attrs})

    def dataset(self) -> xr.Dataset:
        """Return the data set."""
        import xarray as xr

        dataset = xr.Dataset(_for_xarray(self.data_vars), coords=with_indexes(_for_xarray(self.coords)))
        dataset.attrs = self.attrs
        return dataset


def _for_xarray(variables: Mapping[Any, OutlineVariable]) -> dict[str, xr.Variable]:
    import xarray as xr

    return {name: xr.Variable(one.dims, one.values, one.attrs, fastpath=True) for name, one in variables.items()}


def with_indexes(variables: Mapping[str, xr.Variable]) -> xr.Coordinates:
    """Return coordinates with the indexes that xarray creates, which imports Dask for it, if that is installed.

    The import takes half a second of every process; Dask's arrays have no place in coordinates.
    """
    import pandas as pd
    import xarray as xr
    from xarray.indexes import PandasIndex

    found: dict[str, xr.Variable] = dict(variables)
    indexes = {}
    for name, variable in variables.items():
        if variable.dims == (name,):
            indexes[name] = PandasIndex(pd.Index(variable.values), name, coord_dtype=variable.dtype)
            found |= indexes[name].create_variables({name: variable})
    return xr.Coordinates(found, indexes)
