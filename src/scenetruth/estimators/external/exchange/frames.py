"""The images of a recording one frame at a time, with the pixels that must not be used."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem

__all__ = ["each_frame", "single_row"]


def single_row(recording: xr.Dataset) -> xr.Dataset:
    """Return a recording without the dimension ``s_y``; grids are refused.

    Raises
    ------
    EstimateError
        If the cameras stand in several rows.
    """
    if "s_y" not in recording["image"].dims:
        return recording
    if recording.sizes["s_y"] > 1:
        message = "a grid cannot be written as a whole: take one row, recording.sel(s_y=0)"
        raise EstimateError([Problem("stage.rows", message, recording.sizes["s_y"])])
    return recording.isel(s_y=0)


def each_frame(recording: xr.Dataset) -> Iterator[tuple[NDArray[Any], NDArray[np.bool_]]]:
    """Yield images and masks, frame by frame, so that of an opened recording only one is in memory.

    Parameters
    ----------
    recording
        A checked recording of one row of cameras.

    Yields
    ------
    tuple
        Images of shape (s, y, x[, channel]), and whether a pixel must not be used, shape (s, y, x): masked, or with a
        value that is not finite.

    Examples
    --------
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> [image.shape for image, bad in each_frame(recording)]
    [(2, 30, 40), (2, 30, 40), (2, 30, 40)]
    """
    images, mask = recording["image"], recording.get("mask")
    for place in range(images.sizes["t"]):
        values = images.isel(t=place).values
        bad = np.zeros(values.shape[:3], dtype=np.bool_)
        if values.dtype.kind == "f":
            missing = ~np.isfinite(values)
            bad |= missing.any(axis=-1) if missing.ndim == 4 else missing
        if mask is not None:
            # Without s, it is the same for all cameras.
            bad |= (mask.isel(t=place) if "t" in mask.dims else mask).values
        yield values, bad
