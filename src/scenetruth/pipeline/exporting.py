"""The folder of a run, written in a format of others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from scenetruth.errors import ExportError, Problem, StoreError
from scenetruth.export import Exported, choose_format, export_data
from scenetruth.pipeline.folder import RunFolder
from scenetruth.storage import open_store

__all__ = ["export_run"]


def export_run(
    folder: str | Path,
    out: str | Path,
    format: str,
    *,
    method: str | None = None,
    row: int | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Exported:
    """Write the recording of a run, and its truth or an estimate, in a format of others.

    Parameters
    ----------
    folder
        The folder of a run.
    out
        Folder to make.
    format
        Name of the format; see `export_formats` and ``docs/export.md``.
    method
        Write the estimate of this method; the truth if not given.
    row
        Of a grid of cameras, the row ``s_y``.
    overwrite
        Whether an earlier export may be replaced; what it did not write stays.
    **options
        Options of the format, such as ``left=0`` or ``flow="instantaneous"``.

    Returns
    -------
    Exported
        The files, and what a user should know of them. The same stands in the file ``export.json``.

    Raises
    ------
    ExportError
        If the format, its options or the data sets do not fit together; lists everything that is wrong.
    MismatchError
        If recording and maps are of different runs.
    StoreError
        If a store is missing or damaged, ``out`` exists and is not to be replaced, or it cannot be written.

    See Also
    --------
    export_data : The same for data sets in memory.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 2, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> estimate = st.make_estimate(depth=np.ones((2, 8, 8)), like=recording)
    >>> with TemporaryDirectory() as folder:
    ...     st.save(recording, f"{folder}/recording.zarr")
    ...     st.save(estimate, f"{folder}/estimate.zarr")
    ...     done = st.export_run(folder, f"{folder}/cameras", "opencv_yaml", method="structure_tensor")
    >>> done.files
    ('s+0.yml', 's+1.yml')
    """
    # What is wrong with the call is told before stores are opened.
    choose_format(format, options)
    run = RunFolder(folder)
    recording = open_store(run.recording, "recording")
    maps = _maps_of(run, method)
    if row is not None:
        maps = _row_of_maps(recording, maps, row, "truth" if method is None else "estimate")
        recording = recording.sel(s_y=row)
    return export_data(recording, maps, out, format, overwrite=overwrite, **options)


def _maps_of(run: RunFolder, method: str | None) -> xr.Dataset:
    if method is not None:
        return open_store(run.of(method).estimate, "estimate")
    if not run.truth.exists():
        remedy = "choose an estimate with --method NAME (method='NAME')"
        raise StoreError(run.truth, f"no such store: the run has no truth; {remedy}")
    return open_store(run.truth, "truth")


def _row_of_maps(recording: xr.Dataset, maps: xr.Dataset, row: int, what: str) -> xr.Dataset:
    rows = recording["s_y"].values.tolist() if "s_y" in recording["image"].dims else []
    if row not in rows:
        message = f"must be one of the rows {rows}" if rows else "is for grids of cameras; these stand in one row"
        raise ExportError([Problem("row", message, row)])
    # Maps of the reference camera alone are of its row, whatever else tells of all rows.
    if row != 0 and not any(
        "s_y" in item.dims and "x" in item.dims for name, item in maps.items() if name != "visible"
    ):
        raise ExportError([Problem("row", f"must be 0: the {what} is of that row alone", row)])
    return maps.sel(s_y=row) if "s_y" in maps.dims else maps
