"""One sample of a data set, whose images and maps are read when they are used."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import xarray as xr

from scenetruth.dataset.folder import RECORDING, SCENE, TRUTH, DatasetFolder
from scenetruth.dataset.shards import extracted
from scenetruth.errors import StoreError
from scenetruth.pipeline import RunFolder
from scenetruth.scene import Scene, load_scene
from scenetruth.storage import load, open_store

__all__ = ["Sample"]

_VALUE = "value."


@dataclass(frozen=True)
class Sample:
    """One sample of a data set.

    Parameters
    ----------
    number
        Its number in the data set.
    folder
        The data set.
    shard
        The tar file that holds it; None if it has a folder of its own.
    row
        What the catalogue tells of it.
    """

    number: int
    folder: DatasetFolder
    shard: Path | None
    row: dict[str, Any] = field(repr=False)

    @property
    def run(self) -> RunFolder:
        """Its folder, which is that of a run.

        Raises
        ------
        StoreError
            If it lies in a tar file.
        """
        if self.shard is not None:
            raise StoreError(self.shard, "holds many samples; this one has no folder of its own")
        return RunFolder(self.folder.sample(self.number))

    @property
    def values(self) -> dict[str, Any]:
        """What was drawn, by path or name."""
        return {key.removeprefix(_VALUE): value for key, value in self.row.items() if key.startswith(_VALUE)}

    @cached_property
    def recording(self) -> xr.Dataset:
        """The recording; images are read when they are used, of a tar file all at once."""
        return self._opened(RECORDING, "recording")

    @cached_property
    def truth(self) -> xr.Dataset:
        """The truth; maps are read when they are used, of a tar file all at once."""
        return self._opened(TRUTH, "truth")

    @property
    def scene(self) -> Scene:
        """The scene."""
        if self.shard is None:
            return load_scene(self.folder.sample(self.number) / SCENE)
        with extracted(self.shard, self.number) as files:
            return load_scene(files / SCENE)

    def estimate(self, method: str | None = None) -> xr.Dataset:
        """Return the estimate of a method, made by ``scenetruth dataset estimate``.

        Parameters
        ----------
        method
            The method; that of the scene if not given.

        Raises
        ------
        StoreError
            If there is none.
        """
        run = self.run
        return open_store(run.of(method or run.own_method).estimate, "estimate")

    def _opened(self, name: str, kind: Literal["recording", "truth"]) -> xr.Dataset:
        if self.shard is None:
            return open_store(self.folder.sample(self.number) / name, kind)
        with extracted(self.shard, self.number) as files:
            return load(files / name, kind)
