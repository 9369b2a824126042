"""Data sets read: a sequence of samples, whose images and maps are read when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, cast, overload

import xarray as xr

from scenetruth.dataset.catalogue.scores import scores_of
from scenetruth.dataset.catalogue.store import read_catalogue
from scenetruth.dataset.folder import DatasetFolder
from scenetruth.dataset.identity import Identity, open_sampler, read_identity
from scenetruth.dataset.reading.sample import Sample
from scenetruth.dataset.reading.stacking import stacked
from scenetruth.dataset.shards import shard_of
from scenetruth.errors import Problem, RecipeError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["SceneDataset", "open_dataset"]


class SceneDataset(Sequence[Any]):
    """The samples of a data set, in the order of their numbers.

    It has a length, is indexed and sliced, and can be pickled: what PyTorch calls a map-style data set.

    Parameters
    ----------
    folder
        The data set.
    catalogue
        Its samples, one row for each.
    transform
        What is made of every sample that is asked for by its index; the sample itself if not given.

    See Also
    --------
    open_dataset : Opens one.
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
        """Return a sample, or what the transform makes of it; of a slice, those samples."""
        if isinstance(index, slice):
            return SceneDataset(self.folder, self.catalogue.iloc[index], self._transform)
        sample = self.sample(index)
        return sample if self._transform is None else self._transform(sample)

    def __iter__(self) -> Iterator[Any]:
        return (self[index] for index in range(len(self)))

    def sample(self, index: SupportsIndex) -> Sample:
        """Return a sample by its place in the sequence, negative from the end.

        Raises
        ------
        IndexError
            If there is none.
        """
        place = range(len(self))[int(index)]
        row: dict[str, Any] = {str(key): value for key, value in self.catalogue.iloc[place].to_dict().items()}
        number = int(row["sample"])
        shard = self.folder.shard(shard_of(number, self._per_shard))
        # What still lies in a folder beside its tar file is about to be removed.
        return Sample(number, self.folder, shard if shard.exists() else None, row)

    def select(self, query: str) -> SceneDataset:
        r"""Return the samples that a query of the catalogue finds.

        Parameters
        ----------
        query
            As of `pandas.DataFrame.query`: ``"split == 'train' and depth_min_mm > 600"``; names with dots stand in
            backticks, ``"`value.objects.0.pose.position_mm.2` < 650"``.

        Raises
        ------
        RecipeError
            If it cannot be understood.
        """
        try:
            found = self.catalogue.query(query)
        except Exception as error:  # pandas raises many kinds
            message = f"cannot be understood: {error}; columns: {', '.join(map(str, self.catalogue.columns[:60]))}"
            raise RecipeError([Problem("query", message, query)]) from error
        return SceneDataset(self.folder, cast("pd.DataFrame", found), self._transform)

    def split(self, name: str) -> SceneDataset:
        """Return the samples of a split."""
        return SceneDataset(self.folder, self.catalogue[self.catalogue["split"] == name], self._transform)

    def stack(self, variable: str, of: Literal["recording", "truth"] = "truth") -> xr.DataArray:
        """Return a variable of all samples in one array, whose samples are read when they are used.

        Parameters
        ----------
        variable
            Its name, such as ``depth``.
        of
            Where it is.

        Returns
        -------
        xarray.DataArray
            With ``sample`` before its own dimensions; ``.chunk()`` makes a Dask array of it.

        Raises
        ------
        StoreError
            If there are no samples, no such variable, or shapes that differ.
        """
        return stacked(variable, of, [self.sample(index) for index in range(len(self))], self.folder.path)

    @cached_property
    def identity(self) -> Identity:
        """What the data set is."""
        return read_identity(self.folder)

    @cached_property
    def _per_shard(self) -> int:
        return open_sampler(self.folder).recipe.samples_per_shard


def open_dataset(folder: str | Path, *, transform: Callable[[Sample], Any] | None = None) -> SceneDataset:
    """Open a data set that ``scenetruth dataset run`` has made, or is making.

    Parameters
    ----------
    folder
        Its folder.
    transform
        What is made of every sample that is asked for by its index, such as a pair of arrays to learn from.

    Returns
    -------
    SceneDataset
        The samples that are in the catalogue, which has the scores of methods too: ``score.METHOD.interior.depth.rms``.

    Raises
    ------
    StoreError
        If there is no data set, or it is damaged.

    See Also
    --------
    run_dataset : Make a data set.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 30, "height": 25, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 2, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> far = {"objects.0.pose.position_mm.2": {"kind": "list", "values": [90, 100, 110]}}
    >>> recipe = st.recipe_from_plain({"name": "walls", "base": plain, "samples": 3, "vary": far})
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.run_dataset(recipe, f"{folder}/walls", workers=0)
    ...     near = st.open_dataset(f"{folder}/walls").select("depth_max_mm < 105")
    ...     print(len(near), near[0].values, near.stack("depth").max("sample").values[0, 12, 15])
    2 {'objects.0.pose.position_mm.2': 90.0} 100.0
    """
    places = DatasetFolder(folder)
    read_identity(places)
    catalogue = read_catalogue(places, open_sampler(places)).to_pandas()
    for method, scores in scores_of(places).items():
        catalogue = catalogue.join(scores.add_prefix(f"score.{method}."), on="sample")
    return SceneDataset(places, catalogue, transform)
