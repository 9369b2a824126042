"""Every map as a named channel of OpenEXR files, one file for each camera and frame.

``s+0_t+0.exr`` holds ``Y`` (grey image, full scale 1; colours are ``R``, ``G``, ``B``) and one channel for every
component of every map that the data set has: ``depth.Z``, ``disparity.V``, ``flow.x``, ``flow.y``, ``velocity.X``,
``normal.X``, ``growth_rate.V``, ... in the units and with the signs of the data sets; the header's attribute
``units`` tells them as JSON. Scalars other than depth are called V. ``flow`` and ``velocity`` are instantaneous (per
frame); ``flow_next`` and ``displacement_next`` are finite. Disparity and flow count in pixels of the camera, as the
attributes ``first_column_px``, ``first_row_px`` and ``step_px`` do, also where a recording was thinned out. Rows run
from the top down, vectors along X right, Y down, Z forward. Numbers are float32, NaN where nothing is known.
``object_id`` and ``face_id`` are unsigned integers, one more than in the truth: 0 is no surface. Masks are 0 or 1.
Lost: digits beyond float32 (6e-8 of the value), and variables that are no maps of the image's own pixels
(``visible``, poses, times).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.export.base import ExportFormat
from scenetruth.export.raster import image_name
from scenetruth.export.source import Source
from scenetruth.schema import COMPONENTS, intrinsics_of, pixel_grid_of

__all__ = ["Exr"]

_IDS = ("object_id", "face_id")
_MAP = ("t", "y", "x")


class Exr(ExportFormat):
    """Every map as a named channel of OpenEXR files."""

    kind: Literal["exr"] = "exr"
    """Name of the format."""
    layers: tuple[str, ...] = ()
    """Maps to write; all that there are if none is named."""
    compression: Literal["zip", "none"] = "zip"
    """``zip``: without loss; ``none``."""
    summary: ClassVar[str] = "every map as named channels of OpenEXR files"
    packages: ClassVar[tuple[str, ...]] = ("OpenEXR",)

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give the maps that are not there."""
        there = _maps_of(source)
        for name in self.layers:
            if name not in there:
                yield Problem("layers", f"names no map of these data sets; they have {', '.join(there)}", name)

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write one file for each image that has maps."""
        import OpenEXR

        names = list(self.layers) or _maps_of(source)
        compression = OpenEXR.ZIP_COMPRESSION if self.compression == "zip" else OpenEXR.NO_COMPRESSION
        header = {"compression": compression, "type": OpenEXR.scanlineimage, **_attributes(source, names)}
        for s in source.views:
            for t in source.frames:
                image = source.image(s, t)
                parts = [image] if image.ndim == 2 else list(np.moveaxis(image, -1, 0))
                labels = ("R", "G", "B") if len(parts) == 3 else ("Y",)
                channels = {label: part.astype(np.float32) for label, part in zip(labels, parts, strict=False)}
                for name in names:
                    channels |= _channels(name, source, s, t)
                with OpenEXR.File(header, channels) as file:
                    file.write(str(folder / f"{image_name(s, t)}.exr"))
        return []


def _maps_of(source: Source) -> list[str]:
    """Return the names of all variables that tell of the pixels of every image with maps."""
    lead = ("s", *_MAP) if len(source.views) > 1 else _MAP
    # What images show of the reference's t = 0 is told at the reference's pixels.
    items = ((str(name), item) for name, item in source.maps.data_vars.items() if name != "visible")
    return [name for name, item in items if tuple(dim for dim in item.dims if dim not in COMPONENTS) == lead]


def _channels(name: str, source: Source, s: int, t: int) -> dict[str, NDArray[Any]]:
    values = source.raw(name, s, t)
    if name in _IDS:
        values = (values.astype(np.int64) + 1).astype(np.uint32)
    elif values.dtype.kind in "biu":
        values = values.astype(np.uint32)
    else:
        values = values.astype(np.float32)
    if values.ndim == 2:
        return {f"{name}.{'Z' if name == 'depth' else 'V'}": np.ascontiguousarray(values)}
    (dim,) = (str(dim) for dim in source.maps[name].dims if dim in COMPONENTS)
    labels = COMPONENTS[dim]
    return {f"{name}.{label}": np.ascontiguousarray(part) for label, part in zip(labels, values, strict=True)}


def _attributes(source: Source, names: list[str]) -> dict[str, Any]:
    own, grid = intrinsics_of(source.recording), pixel_grid_of(source.recording)
    return {
        # In an order of its own: stores have another than data sets in memory.
        "units": json.dumps({name: str(source.maps[name].attrs.get("units", "1")) for name in sorted(names)}),
        "focal_length_px": own.focal_length_px,
        "principal_point_x_px": own.principal_point_px[0],
        "principal_point_y_px": own.principal_point_px[1],
        "first_column_px": grid.first_x,
        "first_row_px": grid.first_y,
        "step_px": grid.step_px,
    }
