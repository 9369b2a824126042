"""Reading of data sets: a sequence of samples whose images and maps are loaded when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, cast, overload

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from scenetruth.dataset.catalogue import describe_remedy, load_scores, read_catalogue
from scenetruth.dataset.fingerprint import DatasetFingerprint, open_sampler, read_fingerprint
from scenetruth.dataset.layout import RECORDING, SCENE, TRUTH, DatasetFolder, compute_shard_number, extract_sample
from scenetruth.dataset.sampler import HELD_OUT
from scenetruth.dataset.samples import SampleStore
from scenetruth.dataset.training_data import (
    MAPS,
    FlowPairs,
    StereoPairs,
    TensorsOf,
    check_maps,
    import_torch,
    list_maps,
)
from scenetruth.errors import ArgumentError, Problem, RecipeError, StoreError
from scenetruth.pipeline import RunDirectory
from scenetruth.scene import Scene, load_scene
from scenetruth.storage import load_store, open_store

if TYPE_CHECKING:
    import pandas as pd

    from scenetruth.dataset.recipe_model import RecipeModel
    from scenetruth.exporters.export_source import FlowKind

__all__ = ["Sample", "SceneDataset", "open_dataset"]


_VALUE = "value."


@dataclass(frozen=True)
class Sample:
    """One sample of a data set; ``shard`` is the tar file that contains it, None if it has its own directory."""

    number: int
    folder: DatasetFolder
    shard: Path | None
    row: dict[str, Any] = field(repr=False)

    @property
    def run(self) -> RunDirectory:
        """Its run directory."""
        if self.shard is not None:
            raise StoreError(self.shard, "contains many samples; this sample has no directory of its own")
        return RunDirectory(self.folder.sample(self.number))

    @property
    def values(self) -> dict[str, Any]:
        """Drawn values by path or name."""
        return {key.removeprefix(_VALUE): value for key, value in self.row.items() if key.startswith(_VALUE)}

    @cached_property
    def recording(self) -> xr.Dataset:
        """The recording; images are loaded on access, or all together from a tar file."""
        return self._opened(RECORDING, "recording")

    @cached_property
    def truth(self) -> xr.Dataset:
        """The truth; maps are loaded on access, or all together from a tar file."""
        return self._opened(TRUTH, "truth")

    @property
    def scene(self) -> Scene:
        """The scene."""
        if self.shard is None:
            return load_scene(self.folder.sample(self.number) / SCENE)
        with extract_sample(self.shard, self.number) as files:
            return load_scene(files / SCENE)

    def estimate(self, method: str | None = None) -> xr.Dataset:
        """Return the estimate of a method, computed by ``scenetruth dataset estimate``."""
        run = self.run
        return open_store(run.paths(method or run.own_method).estimate, kind="estimate")

    def _opened(self, name: str, kind: Literal["recording", "truth"]) -> xr.Dataset:
        if self.shard is None:
            return open_store(self.folder.sample(self.number) / name, kind=kind)
        with extract_sample(self.shard, self.number) as files:
            return load_store(files / name, kind=kind)


def stack_lazily(
    variable: str, of: Literal["recording", "truth"], samples: Sequence[Sample], source: Path
) -> xr.DataArray:
    """Return a variable of all samples as one lazy array; see `SceneDataset.stack`."""
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
    """Lazy array of one variable of many samples."""

    def __init__(self, variable: str, of: str, samples: Sequence[Sample], source: Path, like: xr.DataArray) -> None:
        self._variable, self._of, self._samples, self._source = variable, of, samples, source
        self.shape, self.dtype = (len(samples), *like.shape), np.dtype(like.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        """Return the values of an xarray selection."""
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
            raise StoreError(self._source, f"{message}{self.shape[1:]}: select samples of equal shape first")
        return np.asarray(found.isel({found.dims[axis]: one for axis, one in inside.items()}).values)


class SceneDataset(Sequence[Any]):
    """The samples of a data set, in the order of their numbers.

    A sequence with a length, indices and slices that can be pickled, as required for a map-style data set of PyTorch.

    ``transform``: Function applied to every sample that is accessed by index; default: none.
    """

    def __init__(
        self, folder: DatasetFolder, catalogue: pd.DataFrame, transform: Callable[[Sample], Any] | None = None
    ) -> None:
        self.folder, self.catalogue, self._transform = folder, catalogue, transform

    def __repr__(self) -> str:
        return f"SceneDataset({str(self.folder.path)!r}, {len(self)} samples)"

    def __len__(self) -> int:
        return len(self.catalogue)

    @overload
    def __getitem__(self, index: SupportsIndex) -> Any: ...

    @overload
    def __getitem__(self, index: slice) -> SceneDataset: ...

    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        """Return a sample after the transform, or the samples of a slice."""
        if isinstance(index, slice):
            return SceneDataset(self.folder, self.catalogue.iloc[index], self._transform)
        sample = self.sample(index)
        return sample if self._transform is None else self._transform(sample)

    def __iter__(self) -> Iterator[Any]:
        return (self[index] for index in range(len(self)))

    def sample(self, index: SupportsIndex) -> Sample:
        """Return a sample by index; negative indices count from the end."""
        place = range(len(self))[int(index)]
        row: dict[str, Any] = {str(key): value for key, value in self.catalogue.iloc[place].to_dict().items()}
        number = int(row["sample"])
        shard = self.folder.shard(compute_shard_number(number, self._recipe.samples_per_shard))
        # A directory whose tar file exists is about to be removed.
        return Sample(number, self.folder, shard if shard.exists() else None, row)

    def select(self, query: str) -> SceneDataset:
        r"""Return the samples that match a query of the catalogue."""
        try:
            found = self.catalogue.query(query)
        except Exception as error:  # pandas raises exceptions of several classes
            message = f"is an invalid query: {error}; columns: {', '.join(map(str, self.catalogue.columns[:60]))}"
            raise RecipeError([Problem("query", message, query)]) from error
        return SceneDataset(self.folder, cast("pd.DataFrame", found), self._transform)

    def split(self, name: str) -> SceneDataset:
        """Return the samples of a split of the recipe; an unfinished data set may have none."""
        recipe = self._recipe
        known = [*recipe.splits, *([HELD_OUT] if recipe.hold_out else [])]
        if name not in known:
            message = f"must be one of {', '.join(known)}" if known else "does not exist: the recipe has no splits"
            raise ArgumentError([Problem("name", message, name)], source=f"splits of {self.folder.path}")
        return SceneDataset(self.folder, self.catalogue[self.catalogue["split"] == name], self._transform)

    def stack(self, variable: str, of: Literal["recording", "truth"] = "truth") -> xr.DataArray:
        """Return a variable of all samples as one array whose samples are loaded on access."""
        return stack_lazily(variable, of, [self.sample(index) for index in range(len(self))], self.folder.path)

    def to_torch(self, maps: str | Sequence[str] = MAPS) -> SceneDataset:
        """Return the data set with samples as mappings of PyTorch tensors, for ``torch.utils.data.DataLoader``.

        ``image``: float32, full scale 1, shape (s, t, channel, y, x); ``maps``: variables of the truth, NaN where there
        is no value; ``sample``: its number. Samples of equal shape form batches without a ``collate_fn``.
        """
        import_torch()
        names = check_maps(self.sample(0), maps) if len(self) else list_maps(maps)
        return SceneDataset(self.folder, self.catalogue, TensorsOf(names))

    def flow_pairs(self, frame: int = 0, camera: int = 0, motion: FlowKind = "finite") -> FlowPairs:
        """Return two successive images of every sample with their flow; see `FlowPairs`."""
        return FlowPairs(self, frame, camera, motion)

    def stereo_pairs(self, left: int = 0, frame: int = 0) -> StereoPairs:
        """Return the images of two neighbouring cameras of every sample with their disparity; see `StereoPairs`."""
        return StereoPairs(self, left, frame)

    @cached_property
    def identity(self) -> DatasetFingerprint:
        """Fingerprint of the data set."""
        return read_fingerprint(self.folder)

    @cached_property
    def _recipe(self) -> RecipeModel:
        return open_sampler(self.folder).recipe


def open_dataset(dataset: str | Path, *, transform: Callable[[Sample], Any] | None = None) -> SceneDataset:
    """Open a data set of ``scenetruth dataset run``; it may be incomplete.

    Parameters
    ----------
    dataset
        Directory of the data set.
    transform
        Function applied to every sample that is accessed by index, for example to return a pair of arrays.

    Returns
    -------
    SceneDataset
        The samples in the catalogue, with the scores of methods: ``score.METHOD.interior.depth.rmse``.

    Raises
    ------
    StoreError
        If there is no data set, it has no samples yet, or it is damaged.

    See Also
    --------
    run_dataset : Generate a data set.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 30, "height": 25, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 2, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> far = {"objects.0.pose.position_mm.2": {"kind": "sequence", "values": [90, 100, 110]}}
    >>> recipe = st.Recipe.from_dict({"name": "walls", "base": plain, "samples": 3, "distributions": far})
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.run_dataset(recipe, output=f"{folder}/walls")
    ...     near = st.open_dataset(f"{folder}/walls").select("depth_max_mm < 105")
    ...     print(len(near), near[0].values, near.stack("depth").max("sample").values[0, 12, 15])
    2 {'objects.0.pose.position_mm.2': 90.0} 100.0
    """
    places = DatasetFolder(dataset)
    identity, sampler = read_fingerprint(places), open_sampler(places)
    catalogue = read_catalogue(places, sampler).to_pandas()
    if not len(catalogue):
        store = SampleStore.of(places, sampler, identity)
        present = store.present(range(identity.count))
        store.refuse_empty(present)
        message = f"has {len(present):,} samples, and none of them in its catalogue"
        remedy = f"a run adds new samples every minute; if none is in progress, {describe_remedy(places)}"
        raise StoreError(places.path, f"{message}; {remedy}")
    for method, scores in load_scores(places).items():
        catalogue = catalogue.join(scores.add_prefix(f"score.{method}."), on="sample")
    return SceneDataset(places, catalogue, transform)
