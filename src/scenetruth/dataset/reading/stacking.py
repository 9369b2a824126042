"""One variable of many samples as one array, read sample by sample when it is used."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from scenetruth.errors import StoreError

if TYPE_CHECKING:
    from scenetruth.dataset.reading.sample import Sample

__all__ = ["stacked"]


def stacked(variable: str, of: Literal["recording", "truth"], samples: Sequence[Sample], source: Path) -> xr.DataArray:
    """Return a variable of samples in one array; see `SceneDataset.stack`.

    Parameters
    ----------
    variable, of
        Name of the variable, and where it is.
    samples
        The samples.
    source
        The data set, for messages.
    """
    if not samples:
        raise StoreError(source, "has no samples to stack")
    first = getattr(samples[0], of)
    if variable not in first:
        raise StoreError(source, f"has no '{variable}' in its {of}; it has {', '.join(map(str, first.data_vars))}")
    like = first[variable]
    values = indexing.LazilyIndexedArray(_Stack(variable, of, samples, source, like))
    coords = {name: one for name, one in like.coords.items() if "sample" not in one.dims}
    coords["sample"] = xr.DataArray([sample.number for sample in samples], dims="sample")
    data = xr.Variable(("sample", *like.dims), values, dict(like.attrs), fastpath=True)
    return xr.DataArray(data, coords, name=variable)


class _Stack(BackendArray):
    """The values of one variable of many samples."""

    def __init__(self, variable: str, of: str, samples: Sequence[Sample], source: Path, like: xr.DataArray) -> None:
        self._variable, self._of, self._samples, self._source = variable, of, samples, source
        self.shape, self.dtype = (len(samples), *like.shape), np.dtype(like.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        """Read what a selection of xarray's asks for."""
        support = indexing.IndexingSupport.OUTER
        return np.asarray(indexing.explicit_indexing_adapter(key, self.shape, support, self._read))

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        first, *rest = key
        places = np.arange(self.shape[0])[first]
        inside = dict(zip(range(len(rest)), rest, strict=True))
        if np.ndim(places) == 0:
            return self._of_sample(int(places), inside)
        parts = [self._of_sample(int(place), inside) for place in places]
        return np.stack(parts) if parts else np.empty((0, *self.shape[1:]), self.dtype)

    def _of_sample(self, place: int, inside: dict[int, Any]) -> NDArray[Any]:
        sample = self._samples[place]
        found = getattr(sample, self._of)[self._variable]
        if found.shape != self.shape[1:]:
            message = f"sample {sample.number} has a '{self._variable}' of shape {found.shape}, and the first "
            raise StoreError(self._source, f"{message}{self.shape[1:]}: select samples that are alike first")
        return np.asarray(found.isel({found.dims[axis]: one for axis, one in inside.items()}).values)
