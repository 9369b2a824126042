"""Everything as plain NumPy archives.

``recording.npz`` and ``truth.npz`` (or ``estimate.npz``) hold every variable and coordinate under its name, as it is
in the data sets: units, signs, NaN for unknown, instantaneous ``flow`` and ``velocity``, finite ``flow_next`` and
``displacement_next`` if the truth is complete, also of the last frame. ``meta`` is a text, JSON: ``dims``, ``units``
and ``long_name`` of every variable, and the attributes of the data set (focal length, principal point, baseline,
hashes). Nothing is lost; there are no checksums, and no image is read without all of its variable.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr

from scenetruth.export.base import ExportFormat
from scenetruth.export.source import Source

__all__ = ["Npz"]


class Npz(ExportFormat):
    """Everything as plain NumPy archives."""

    kind: Literal["npz"] = "npz"
    """Name of the format."""
    compress: bool = True
    """Compress the arrays."""
    summary: ClassVar[str] = "every variable of recording and truth (or estimate) as plain .npz, with units"

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write both data sets."""
        parts = {"recording": source.recording, "truth" if source.is_truth else "estimate": source.maps}
        for name, dataset in parts.items():
            _write(folder / f"{name}.npz", dataset, zipfile.ZIP_DEFLATED if self.compress else zipfile.ZIP_STORED)
        return []


def _write(file: Path, dataset: xr.Dataset, compression: int) -> None:
    """Write a data set one variable at a time: `numpy.savez` would hold all of them."""
    with zipfile.ZipFile(file, "w", compression) as archive:
        # In an order of its own: stores have another than data sets in memory.
        for name, item in [*_sorted(dataset.coords), *_sorted(dataset.data_vars)]:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(item.values), allow_pickle=False)
        with archive.open("meta.npy", "w") as stream:
            np.lib.format.write_array(stream, np.array(json.dumps(_meta(dataset), sort_keys=True)), allow_pickle=False)


def _sorted(variables: Mapping[Any, xr.DataArray]) -> list[tuple[str, xr.DataArray]]:
    return [(str(name), variables[name]) for name in sorted(variables, key=str)]


def _meta(dataset: xr.Dataset) -> dict[str, Any]:
    variables = {
        str(name): {
            "dims": list(map(str, item.dims)),
            "units": str(item.attrs.get("units", "1")),
            "long_name": str(item.attrs.get("long_name", name)),
        }
        for name, item in dataset.variables.items()
    }
    return {"variables": variables, "attributes": {str(name): _plain(value) for name, value in dataset.attrs.items()}}


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
