"""Formats of images and maps, one file for each image or map: OpenEXR, .flo, NumPy, PFM, PNG, TIFF."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.exporters.export_source import CameraPair, ExportSource
from scenetruth.exporters.format_base import ExportFormat, FlowOptions, PairOptions, PictureOptions
from scenetruth.exporters.image_files import image_name, write_flo, write_pfm, write_picture
from scenetruth.schema import COMPONENTS, compute_pixel_grid, read_intrinsics
from scenetruth.storage import write_images

__all__ = ["Exr", "Flo", "Npz", "Pfm", "Png", "Tiff"]


_IDS = ("object_id", "face_id")
_MAP = ("t", "y", "x")


class Exr(ExportFormat):
    """Every map as a named channel of OpenEXR files, one file for each camera and frame.

    ``s+0_t+0.exr`` holds ``Y`` (grey image, full scale 1; colours are ``R``, ``G``, ``B``) and one channel for every
    component of every map that the data set has: ``depth.Z``, ``disparity.V``, ``flow.x``, ``flow.y``, ``velocity.X``,
    ``normal.X``, ``growth_rate.V``, ... in the units and with the signs of the data sets; the header's attribute
    ``units`` tells them as JSON. Scalars other than depth are called V. ``flow`` and ``velocity`` are instantaneous
    (per frame); ``flow_next`` and ``displacement_next`` are finite. Disparity and flow count in pixels of the camera,
    as the attributes ``first_column_px``, ``first_row_px`` and ``step_px`` do, also where a recording was thinned out.
    Rows run from the top down, vectors along X right, Y down, Z forward. Numbers are float32, NaN where nothing is
    known. ``object_id`` and ``face_id`` are unsigned integers, one more than in the truth: 0 is no surface. Masks are 0
    or 1. Lost: digits beyond float32 (6e-8 of the value), and variables that are no maps of the image's own pixels
    (``visible``, poses, times).
    """

    kind: Literal["exr"] = "exr"
    """Name of the format."""
    layers: tuple[str, ...] = ()
    """Maps to write; all that there are if none is named."""
    compression: Literal["zip", "none"] = "zip"
    """``zip``: without loss; ``none``."""
    summary: ClassVar[str] = "every map as named channels of OpenEXR files"
    packages: ClassVar[tuple[str, ...]] = ("OpenEXR",)

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Give the maps that are not there."""
        there = _list_maps(source)
        for name in self.layers:
            if name not in there:
                yield Problem("layers", f"names no map of these data sets; they have {', '.join(there)}", name)

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one file for each image that has maps."""
        import OpenEXR

        names = list(self.layers) or _list_maps(source)
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


def _list_maps(source: ExportSource) -> list[str]:
    """Return the names of all variables that tell of the pixels of every image with maps."""
    lead = ("s", *_MAP) if len(source.views) > 1 else _MAP
    # What images show of the reference's t = 0 is told at the reference's pixels.
    items = ((str(name), item) for name, item in source.maps.data_vars.items() if name != "visible")
    return [name for name, item in items if tuple(dim for dim in item.dims if dim not in COMPONENTS) == lead]


def _channels(name: str, source: ExportSource, s: int, t: int) -> dict[str, NDArray[Any]]:
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


def _attributes(source: ExportSource, names: list[str]) -> dict[str, Any]:
    own, grid = read_intrinsics(source.recording), compute_pixel_grid(source.recording)
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


class Flo(FlowOptions, PictureOptions):
    """Optical flow as Middlebury's .flo, with the images.

    ``images/s+0_t+0.png``, ``flow/s+0_t+0.flo`` for every camera with maps. A .flo file holds the tag 202021.25, width,
    height, then u and v of every pixel as float32, rows from the top down, all little endian. u is positive to the
    right, v downwards, in px: pixel (x, y) of frame t is at (x + u, y + v) in frame t + 1. 1e10 for both where no
    surface is seen. Points that are hidden in the next frame, or outside of it, have their flow all the same. The last
    frame has no file. Lost: depth and motion in depth, digits beyond float32 (6e-8 of the value). With ``flow:
    instantaneous``, values are dx/dt per frame instead of displacements.
    """

    kind: Literal["flo"] = "flo"
    """Name of the format."""
    summary: ClassVar[str] = "optical flow as .flo (Middlebury), with the images"

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write images and flow."""
        for s in source.views:
            for t in source.pairs_of_frames:
                for frame in (t, t + 1):
                    write_picture(
                        folder / "images" / f"{image_name(s, frame)}.png", source.image(s, frame), self.image_bits
                    )
                write_flo(folder / "flow" / f"{image_name(s, t)}.flo", source.flow(s, t, self.flow))
        return self.flow_notes()


class Npz(ExportFormat):
    """Everything as plain NumPy archives.

    ``recording.npz`` and ``truth.npz`` (or ``estimate.npz``) hold every variable and coordinate under its name, as it
    is in the data sets: units, signs, NaN for unknown, instantaneous ``flow`` and ``velocity``, finite ``flow_next``
    and ``displacement_next`` if the truth is complete, also of the last frame. ``meta`` is a text, JSON: ``dims``,
    ``units`` and ``long_name`` of every variable, and the attributes of the data set (focal length, principal point,
    baseline, hashes). Nothing is lost; there are no checksums, and no image is read without all of its variable.
    """

    kind: Literal["npz"] = "npz"
    """Name of the format."""
    compress: bool = True
    """Compress the arrays."""
    summary: ClassVar[str] = "every variable of recording and truth (or estimate) as plain .npz, with units"

    def write(self, source: ExportSource, folder: Path) -> list[str]:
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


class Pfm(PairOptions, PictureOptions):
    """Disparity and depth as PFM, in the layout of Middlebury's stereo sets, one folder for each frame.

    ``t+0/im0.png``, ``im1.png`` (left and right image), ``disp0.pfm``, ``depth0.pfm``, with a truth of all cameras also
    ``disp1.pfm``, ``depth1.pfm``, and ``calib.txt``. PFM is float32 with rows from the bottom up; the negative scale
    -1.0 says little endian. Disparity is positive: pixel (x, y) of the left image is at (x - d, y) in the right one,
    pixel (x, y) of the right image at (x + d, y) in the left one. Depth is Z in mm along the optical axis, and Z =
    baseline f / (d + doffs) with doffs 0 and the baseline in mm. +inf where no surface is seen; points that the other
    camera does not see have their disparity. ``calib.txt`` counts pixel centres as integers; ndisp is one more than the
    largest disparity, rounded up. Lost: motion, the other cameras, digits beyond float32 (6e-8 of the value).
    """

    kind: Literal["pfm"] = "pfm"
    """Name of the format."""
    summary: ClassVar[str] = "disparity and depth of a left-right pair as .pfm, with images and calib.txt (Middlebury)"

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one folder for each frame."""
        pair = self.pair_of(source)
        for t in source.frames:
            place = folder / f"t{t:+d}"
            for number, s in enumerate((pair.left, pair.right)):
                write_picture(place / f"im{number}.png", source.image(s, t), self.image_bits)
                if s not in source.views:
                    continue
                depth = source.depth(s, t)
                disparity = source.disparity(depth, pair)
                write_pfm(place / f"disp{number}.pfm", disparity)
                write_pfm(place / f"depth{number}.pfm", depth)
                if number == 0:
                    (place / "calib.txt").write_text(_calibration(source, pair, disparity), encoding="ascii")
        return self.pair_notes(source)


def _calibration(source: ExportSource, pair: CameraPair, disparity: NDArray[np.float64]) -> str:
    own = source.intrinsics
    f, (c_x, c_y) = own.focal_length_px, own.principal_point_px
    matrix = f"[{f!r} 0 {c_x!r}; 0 {f!r} {c_y!r}; 0 0 1]"
    height, width = source.size
    known = disparity[np.isfinite(disparity)]
    least, most = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    lines = {
        "cam0": matrix,
        "cam1": matrix,
        "doffs": 0,
        "baseline": pair.baseline_mm,
        "width": width,
        "height": height,
        "ndisp": math.ceil(most) + 1,
        "isint": 0,
        "vmin": least,
        "vmax": most,
        "dyavg": 0,
        "dymax": 0,
    }
    return "".join(f"{name}={value}\n" for name, value in lines.items())


class Png(ExportFormat):
    """Images as 16-bit PNG: ``images/s+0_t+0.png`` for every camera and frame.

    65535 is full scale, rows run from the top down. Digital numbers of up to 16 bits follow exactly: round(value /
    65535 x full scale). Lost: everything but the images, values beyond full scale, of linear images steps below 1.5e-5.
    """

    kind: Literal["png"] = "png"
    """Name of the format."""
    summary: ClassVar[str] = "images as 16-bit PNG"

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Give what keeps images from being written."""
        if source.has_colours:
            yield Problem("image", "has colours, and PNG files of 16 bits are written of grey images; take tiff")

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write every image."""
        write_images(source.recording, folder / "images", "png")
        return []


class Tiff(ExportFormat):
    """Images as float TIFF: ``images/s+0_t+0.tiff`` for every camera and frame.

    Float32 with 1 for full scale, rows from the top down; colours have their channels last. Digital numbers of up to 16
    bits follow exactly: round(value x full scale). Lost: everything but the images.
    """

    kind: Literal["tiff"] = "tiff"
    """Name of the format."""
    summary: ClassVar[str] = "images as float32 TIFF"

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write every image."""
        write_images(source.recording, folder / "images", "tiff")
        return []
