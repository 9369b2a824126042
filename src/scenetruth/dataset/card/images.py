"""Small versions of a data set's own images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.dataset.folder import DatasetFolder
from scenetruth.dataset.pages.contact_sheet import THUMBNAIL_PX
from scenetruth.dataset.reading.sequence import SceneDataset
from scenetruth.progress import Progress

if TYPE_CHECKING:
    import pyarrow

__all__ = ["small_images"]


def small_images(
    folder: DatasetFolder, table: pyarrow.Table, places: Sequence[int], progress: Progress | None = None
) -> list[NDArray[np.float32]]:
    """Return the images of the reference camera at t = 0, small, from 0 to 1 of full scale.

    Parameters
    ----------
    folder, table
        The data set and its catalogue.
    places
        Rows of the catalogue.
    progress
        Called with (what, done, total).
    """
    dataset = SceneDataset(folder, table.select(["sample"]).to_pandas())
    found = []
    for done, place in enumerate(places):
        if progress is not None:
            progress("images", done, len(places))
        found.append(_small(dataset.sample(place).recording))
    if progress is not None:
        progress("images", len(places), len(places))
    return found


def _small(recording: xr.Dataset) -> NDArray[np.float32]:
    """Return one image: means over pixels, with the shape of a thumbnail."""
    from PIL import Image

    image = recording["image"]
    # Of all the images, only this one is read.
    image = image.sel({name: 0 for name in ("s_y", "s", "t") if name in image.dims})
    values = np.asarray(image, dtype=np.float32) / np.float32(recording.attrs.get("full_scale", 1.0))
    height, width = values.shape
    share = min(THUMBNAIL_PX / max(width, height), 1.0)
    size = max(round(width * share), 1), max(round(height * share), 1)
    return np.asarray(Image.fromarray(values).resize(size, Image.Resampling.BOX))
