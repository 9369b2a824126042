"""Formats of whole fields: surfaces for ParaView (VTU), and all maps with their units in HDF5."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal
from xml.etree import ElementTree

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.exporters.export_source import ExportSource
from scenetruth.exporters.format_base import ExportFormat
from scenetruth.exporters.image_files import image_name
from scenetruth.exporters.surface_points import STRAINS, PointOptions, PointTotals, SurfaceFrame
from scenetruth.schema import read_intrinsics

if TYPE_CHECKING:
    import h5py

__all__ = ["Hdf5", "Vtu"]

_FURTHER = {"depth_std": "mm", "growth_rate": "1/frame", "growth_rate_std": "1/frame"}
_MAX_SLOPE_DEG = 80.0


class Vtu(PointOptions):
    """Surfaces as unstructured grids of VTK for ParaView, one file for every frame of the reference camera.

    ``s+0_t+0.vtu``: quadrilaterals between every ``step``-th pixel with valid depth and motion; points in the world,
    mm. Point data, with units in their names: ``displacement [mm]`` to the next frame, ``exx [1]``, ``eyy [1]``,
    ``exy [1]``, ``e1 [1]``, ``e2 [1]``, ``angle [deg]``, ``pixel [px]``, and if available their standard deviations
    (``exx_std [1]``, ``displacement_std [mm]``), ``depth_std [mm]``, ``growth_rate [1/frame]``. Strain is NaN where too
    few neighbours are valid. ``surface.pvd`` lists the files with their times in seconds: ParaView opens it as a series
    in time. No quadrilateral connects surfaces at a depth step of more than 80°, or two objects of a truth. Numbers are
    float64. A frame without a point has no file. Lost: images, other cameras.
    """

    kind: Literal["vtu"] = "vtu"
    """Name of the format."""
    summary: ClassVar[str] = "surfaces with displacements and strains as .vtu (ParaView)"
    packages: ClassVar[tuple[str, ...]] = ("meshio",)

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one file for every frame."""
        import meshio

        totals, settings, written = PointTotals(), self.strain_settings(), []
        for t, frame in self.frames(source):
            totals.add(frame, settings)
            if not frame.known.any():
                continue
            data = {"displacement [mm]": frame.moved[:, frame.known].T}
            moved_std = frame.moved_std()
            if moved_std is not None:
                data["displacement_std [mm]"] = moved_std[:, frame.known].T
            data |= {f"{name} [1]": frame.strain(name)[frame.known] for name in STRAINS}
            data["angle [deg]"] = np.degrees(frame.strain("angle")[frame.known])
            stated = [f"{name}_std" for name in STRAINS if f"{name}_std" in frame.maps]
            data |= {f"{name} [1]": frame.strain(name)[frame.known] for name in stated}
            columns, rows = frame.pixels()
            data["pixel [px]"] = np.stack([columns, rows, np.zeros_like(rows)])[:, frame.known].T
            data |= {
                f"{name} [{unit}]": frame.map(name)[frame.known]
                for name, unit in _FURTHER.items()
                if name in source.maps
            }
            cells = _quadrilaterals(frame, source)
            points = np.ascontiguousarray(frame.points[:, frame.known].T)
            # Surfaces without a quadrilateral are points: meshio cannot read files without cells.
            blocks = [("quad", cells)] if len(cells) else [("vertex", np.arange(len(points))[:, None])]
            mesh = meshio.Mesh(
                points, blocks, point_data={name: np.ascontiguousarray(each) for name, each in data.items()}
            )
            mesh.write(folder / f"{image_name(0, t)}.vtu", file_format="vtu")
            written.append(t)
        _write_series(source, written, folder)
        empty = [t for t in source.frames if t not in written]
        none = [f"no files for the frames {empty}: none of their pixels has valid depth and motion"] if empty else []
        return [*self.notes(source, totals), *none]


def _write_series(source: ExportSource, frames: list[int], folder: Path) -> None:
    """Write the list of the files of frames with their times, in ParaView's format."""
    interval = float(source.recording.attrs["frame_interval_s"])
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    files = ElementTree.SubElement(root, "Collection")
    for t in frames:
        ElementTree.SubElement(files, "DataSet", timestep=repr(t * interval), part="0", file=f"{image_name(0, t)}.vtu")
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(folder / "surface.pvd", encoding="utf-8", xml_declaration=True)


def _quadrilaterals(frame: SurfaceFrame, source: ExportSource) -> NDArray[np.int64]:
    """Return the corners of the quadrilaterals, as indices of the written points, shape (n, 4)."""
    number = np.cumsum(frame.known.ravel()).reshape(frame.known.shape) - 1
    depth = np.where(frame.known, frame.map("depth"), np.nan)
    step = float(frame.maps.attrs["step_px"])
    steepest = math.tan(math.radians(_MAX_SLOPE_DEG)) / read_intrinsics(source.maps).focal_length_px * step
    objects = frame.map("object_id") if "object_id" in source.maps else np.zeros(depth.shape)

    def joined(one: Any, other: Any) -> NDArray[np.bool_]:
        near = np.minimum(depth[one], depth[other])
        return np.asarray((np.abs(depth[one] - depth[other]) <= steepest * near) & (objects[one] == objects[other]))

    across = joined((slice(None), slice(-1)), (slice(None), slice(1, None)))
    down = joined((slice(-1), slice(None)), (slice(1, None), slice(None)))
    whole = across[:-1] & across[1:] & down[:, :-1] & down[:, 1:]
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    return np.stack([corner[whole] for corner in corners], axis=1).astype(np.int64)


class Hdf5(PointOptions):
    """All maps and their strain in one HDF5 file, with units and meanings as attributes.

    ``maps.h5``: group ``truth`` or ``estimate`` with all variables as datasets, in their stored types, and group
    ``strain`` with those of the strain at every ``step``-th pixel of the reference camera. Every dataset has the
    attributes ``units`` and ``long_name``, flags ``flag_values`` and ``flag_meanings``; its dimensions are labelled and
    have the coordinates (``t``, ``time_s``, ``y``, ``x``, ...) attached as HDF5 dimension scales. Attributes of groups
    are those of the data sets: camera, method, settings, gauge. ``images=true`` adds the group ``recording``.
    Vectors are along the axes of the camera, signs as in the data sets (``axes`` does not apply). Without motion there
    is no group ``strain``. Lost: checksums.
    """

    kind: Literal["hdf5"] = "hdf5"
    """Name of the format."""
    axes: Literal["camera"] = "camera"
    """X right, Y down, Z forward."""
    images: bool = False
    """Whether the recording is included."""
    summary: ClassVar[str] = "all maps, strain and units in one .h5 file"
    packages: ClassVar[tuple[str, ...]] = ("h5py",)

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield a frame of reference that does not exist; all maps can be written."""
        yield from ExportFormat.problems(self, source)
        if self.since is not None:
            yield from (problem for problem in super().problems(source) if problem.path in ("since", "velocity"))

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write the file."""
        import h5py

        totals, settings = PointTotals(), self.strain_settings()
        moving = "depth" in source.maps and {"velocity", "displacement_next"} & set(source.maps)
        with h5py.File(folder / "maps.h5", "w") as file:
            _write_group(file.create_group("truth" if source.is_truth else "estimate"), source.maps)
            if moving:
                group, described = file.create_group("strain"), []
                for n, (_, frame) in enumerate(self.frames(source)):
                    totals.add(frame, settings)
                    # The order of the axes of the data model: components first.
                    maps = frame.maps.expand_dims("t").transpose("component", "t", "y", "x")
                    described.append(maps.drop_vars(list(maps.data_vars)))
                    _write_frame(group, maps, n, len(source.frames))
                _write_group(group, _joined(described))
            if self.images:
                _write_group(file.create_group("recording"), source.recording)
        if not moving:
            return ["no strain: it needs depth and motion"]
        return [f"strain gauge {totals.gauge_px:.3g} px" if totals.strained else totals.missing]


def _joined(frames: list[xr.Dataset]) -> xr.Dataset:
    """Return the coordinates of all frames, with the time of each, and the medians of their image scale and gauge."""
    times = [name for name in ("time_s",) if name in frames[0].coords]
    found = xr.concat(frames, "t", coords=times, compat="override", combine_attrs="drop_conflicts", join="exact")
    for name in ("gauge_length_mm", "mm_per_px"):
        stated = [frame.attrs[name] for frame in frames if name in frame.attrs]
        if stated:
            found.attrs[name] = float(np.median(stated))
    return found


def _write_group(group: h5py.Group, dataset: xr.Dataset) -> None:
    """Write a data set with its coordinates as dimension scales, also of the datasets that the group has."""
    for name, value in sorted(dataset.attrs.items()):
        group.attrs[str(name)] = value
    # The order of the variables of a data set does not affect the file.
    for name, item in sorted(dataset.variables.items(), key=lambda entry: str(entry[0])):
        made = _write_variable(group, str(name), item)
        if item.dims == (name,):
            made.make_scale(str(name))
    for name, made in group.items():
        for axis in made.dims:
            if axis.label in group and axis.label != name:
                axis.attach_scale(group[axis.label])


def _write_frame(group: h5py.Group, maps: xr.Dataset, n: int, count: int) -> None:
    """Write the maps of one of ``count`` frames; the first makes the datasets."""
    for name, item in sorted(maps.data_vars.items(), key=lambda entry: str(entry[0])):
        made = _create(group, str(name), item.variable, {**item.sizes, "t": count}) if n == 0 else group[str(name)]
        made[_select_frame(item.dims, n)] = _convert(item.variable.isel(t=0))


def _write_variable(group: h5py.Group, name: str, item: xr.Variable) -> h5py.Dataset:
    """Write a variable; maps frame by frame, because those of all frames may not fit into memory."""
    made = _create(group, name, item, item.sizes)
    if item.ndim > 1 and "t" in item.dims:
        for n in range(item.sizes["t"]):
            made[_select_frame(item.dims, n)] = _convert(item.isel(t=n))
    else:
        made[...] = _convert(item)
    return made


def _select_frame(dims: tuple[Any, ...], n: int) -> tuple[Any, ...]:
    return tuple(n if dim == "t" else slice(None) for dim in dims)


def _convert(item: xr.Variable) -> NDArray[Any]:
    """Return values in a type of HDF5: texts as objects, and truth values as numbers."""
    converted = {"U": np.dtype(object), "b": np.dtype(np.uint8)}.get(item.dtype.kind, item.dtype)
    return np.asarray(item.values).astype(converted, copy=False)


def _create(group: h5py.Group, name: str, item: xr.Variable, sizes: Mapping[Any, int]) -> h5py.Dataset:
    """Return a new dataset with the attributes of a variable and labels of its dimensions, one map in each chunk."""
    import h5py

    shape = tuple(sizes[dim] for dim in item.dims)
    dtype: Any = {"U": h5py.string_dtype(), "O": h5py.string_dtype(), "b": np.uint8}.get(item.dtype.kind, item.dtype)
    packed: dict[str, Any] = {}
    if item.ndim > 1 and item.dtype.kind not in "UO" and all(shape):
        first = item.dims.index("y") if "y" in item.dims else 1
        packed = {"compression": "gzip", "shuffle": True, "chunks": (1,) * first + shape[first:]}
    made = group.create_dataset(name, shape=shape, dtype=dtype, **packed)
    for key, value in item.attrs.items():
        made.attrs[str(key)] = value
    for axis, dim in enumerate(item.dims):
        made.dims[axis].label = str(dim)
    return made
