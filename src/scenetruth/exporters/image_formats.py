"""Formats with one file per image or map: OpenEXR, .flo, NumPy, PFM, PNG, TIFF."""

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
_EXR_COLOURS = {"red": "R", "green": "G", "blue": "B"}


class Exr(ExportFormat):
    """Every map as a named channel of OpenEXR files, one file per camera and frame.

    ``s+0_t+0.exr`` contains ``Y`` (grey image, full scale 1; colours are ``R``, ``G``, ``B``, and other bands have
    their names) and one channel per component of every map: ``depth.Z``, ``disparity.V``, ``flow.x``, ``flow.y``,
    ``velocity.X``, ``normal.X``, ``growth_rate.V``, ... with the units and signs of the data sets; the header attribute
    ``units`` lists the units as JSON. Scalars other than depth are called V. ``flow`` and ``velocity`` are
    instantaneous (per frame); ``flow_next`` and ``displacement_next`` are finite. Disparity, flow and the attributes
    ``first_column_px``, ``first_row_px`` and ``step_px`` are in pixels of the camera, also for a subsampled recording.
    Rows run from the top down, vectors along
    X right, Y down, Z forward. Numbers are float32, NaN where invalid. ``object_id`` and ``face_id`` are unsigned
    integers, one more than in the truth: 0 is no surface. Masks are 0 or 1. Lost: digits beyond float32 (6e-8 of the
    value), and variables that are not maps of the pixels of the image (``visible``, poses, times).
    """

    kind: Literal["exr"] = "exr"
    """Name of the format."""
    layers: tuple[str, ...] = ()
    """Maps to write; default: all."""
    compression: Literal["zip", "none"] = "zip"
    """``zip``: lossless; ``none``."""
    summary: ClassVar[str] = "every map as named channels of OpenEXR files"
    packages: ClassVar[tuple[str, ...]] = ("OpenEXR",)

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing maps."""
        there = _list_maps(source)
        for name in self.layers:
            if name not in there:
                yield Problem("layers", f"is not a map of the data; available maps are {', '.join(there)}", name)

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one file per image with maps."""
        import OpenEXR

        names = list(self.layers) or _list_maps(source)
        compression = OpenEXR.ZIP_COMPRESSION if self.compression == "zip" else OpenEXR.NO_COMPRESSION
        header = {"compression": compression, "type": OpenEXR.scanlineimage, **_attributes(source, names)}
        for s in source.views:
            for t in source.frames:
                image = source.image(s, t)
                parts = [image] if image.ndim == 2 else list(np.moveaxis(image, -1, 0))
                labels = [_EXR_COLOURS.get(name, name) for name in source.channels] or ["Y"]
                channels = {label: part.astype(np.float32) for label, part in zip(labels, parts, strict=True)}
                for name in names:
                    channels |= _channels(name, source, s, t)
                with OpenEXR.File(header, channels) as file:
                    file.write(str(folder / f"{image_name(s, t)}.exr"))
        return []


def _list_maps(source: ExportSource) -> list[str]:
    """Return the names of the maps that refer to the pixels of every image with maps."""
    lead = ("s", *_MAP) if len(source.views) > 1 else _MAP
    # Visibility of the points at t = 0 refers to pixels of the reference camera.
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
        # Sorted, because the order in stores differs from that in memory.
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

    ``images/s+0_t+0.png``, ``flow/s+0_t+0.flo`` for every camera with maps. A .flo file contains the tag 202021.25,
    width, height, then u and v of every pixel as float32, rows from the top down, little endian. u is positive to the
    right, v downwards, in px: pixel (x, y) of frame t moves to (x + u, y + v) in frame t + 1. 1e10 for both where no
    surface is visible. Points that are occluded in the next frame, or outside it, have values. The last frame has no
    file. Lost: depth and motion in depth, digits beyond float32 (6e-8 of the value). With ``flow: instantaneous``,
    values are dx/dt per frame instead of displacements.
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
    """All data as plain NumPy archives.

    ``recording.npz`` and ``truth.npz`` (or ``estimate.npz``) contain every variable and coordinate by name, as in the
    data sets: units, signs, NaN for invalid, instantaneous ``flow`` and ``velocity``, finite ``flow_next`` and
    ``displacement_next`` for a complete truth, also of the last frame. ``meta`` is a JSON text: ``dims``, ``units`` and
    ``long_name`` of every variable, and the attributes of the data set (focal length, principal point, baseline,
    hashes). Nothing is lost; there are no checksums, and an image cannot be read without its whole variable.
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
    with zipfile.ZipFile(file, "w", compression) as archive:
        # Sorted, because the order in stores differs from that in memory.
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
    """Disparity and depth as PFM, in the layout of Middlebury's stereo sets, one directory per frame.

    ``t+0/im0.png``, ``im1.png`` (left and right image), ``disp0.pfm``, ``depth0.pfm``, with a truth of all cameras also
    ``disp1.pfm``, ``depth1.pfm``, and ``calib.txt``. PFM is float32 with rows from the bottom up; the negative scale
    -1.0 denotes little endian. Disparity is positive: pixel (x, y) of the left image corresponds to (x - d, y) in the
    right image, pixel (x, y) of the right image to (x + d, y) in the left image. Depth is Z in mm along the optical
    axis, and Z = baseline f / (d + doffs) with doffs 0 and the baseline in mm. +inf where no surface is visible; points
    that are occluded in the other image have values. ``calib.txt`` uses integer pixel centres; ndisp is one more than
    the largest disparity, rounded up. Lost: motion, the other cameras, digits beyond float32 (6e-8 of the value).
    """

    kind: Literal["pfm"] = "pfm"
    """Name of the format."""
    summary: ClassVar[str] = "disparity and depth of a left-right pair as .pfm, with images and calib.txt (Middlebury)"

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one directory per frame."""
        pair = self.get_pair(source)
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

    65535 is full scale, rows run from the top down. Digital numbers of up to 16 bits are recovered exactly: round(value
    / 65535 x full scale). Lost: everything except images, values beyond full scale, for linear images steps below
    1.5e-5.
    """

    kind: Literal["png"] = "png"
    """Name of the format."""
    summary: ClassVar[str] = "images as 16-bit PNG"

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the reasons why images cannot be written."""
        if source.has_colours:
            yield Problem("image", "has colours, but only grey images are written as 16-bit PNG; use tiff")

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write every image."""
        write_images(source.recording, folder / "images", "png")
        return []


class Tiff(ExportFormat):
    """Images as float TIFF: ``images/s+0_t+0.tiff`` for every camera and frame.

    Float32 with 1 for full scale, rows from the top down; colours have their channels last. Digital numbers of up to 16
    bits are recovered exactly: round(value x full scale). Lost: everything except images.
    """

    kind: Literal["tiff"] = "tiff"
    """Name of the format."""
    summary: ClassVar[str] = "images as float32 TIFF"

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write every image."""
        write_images(source.recording, folder / "images", "tiff")
        return []
