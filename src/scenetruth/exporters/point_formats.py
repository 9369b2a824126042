"""Tables of surface points with displacements and strains, in the columns of programs for digital image correlation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.exporters.export_source import ExportSource
from scenetruth.exporters.image_files import image_name
from scenetruth.exporters.surface_points import STRAINS, PointTable, SurfaceFrame

__all__ = ["DicePoints", "MatchidPoints", "PointCsv", "Vic3dPoints"]

_MEASURES = {"green_lagrange": "Lagrange", "hencky": "Hencky", "engineering": "engr."}
"""Names of the strain tensors in the headings of VIC-3D."""

_SUCCESSFUL, _FAILED = 4, 8
"""Status flags of DICe: INITIALIZE_SUCCESSFUL, which its own files have, and CORRELATION_FAILED."""


class PointCsv(PointTable):
    """Surface points of the reference camera as tables of comma-separated values, with the unit in every heading.

    ``s+0_t+0.csv``: one line for every ``step``-th pixel with valid depth and motion: pixel ``x [px]``, ``y [px]``;
    point ``X [mm]``, ``Y [mm]``, ``Z [mm]`` in the world; displacement ``U [mm]``, ``V [mm]``, ``W [mm]`` to the next
    frame; strain ``exx [1]``, ``eyy [1]``, ``exy [1]`` (the shear of the tensor) in the tangent plane, principal
    strains ``e1 [1]``, ``e2 [1]`` and ``angle [deg]`` of the first; displacements and strains with ``_std`` where
    stated; ``depth_std [mm]``. Strain is empty where too few neighbours are valid. Lost: images, normals, points of
    other cameras.
    """

    kind: Literal["point_csv"] = "point_csv"
    """Name of the format."""
    missing: ClassVar[str] = ""
    summary: ClassVar[str] = "points, displacements and strains as .csv with units"

    def columns(self, frame: SurfaceFrame, source: ExportSource) -> Mapping[str, NDArray[Any]]:
        """Return the columns."""
        columns, rows = frame.pixels()
        found = {"x [px]": columns, "y [px]": rows}
        found |= {f"{name} [mm]": values for name, values in zip("XYZ", frame.points, strict=True)}
        found |= {f"{name} [mm]": values for name, values in zip("UVW", frame.moved, strict=True)}
        moved_std = frame.moved_std()
        if moved_std is not None:
            found |= {f"{name}_std [mm]": values for name, values in zip("UVW", moved_std, strict=True)}
        found |= {f"{name} [1]": frame.strain(name) for name in STRAINS}
        found["angle [deg]"] = np.degrees(frame.strain("angle"))
        stated = [name for name in STRAINS if f"{name}_std" in frame.maps]
        found |= {f"{name}_std [1]": frame.strain(f"{name}_std") for name in stated}
        if "depth_std" in source.maps:
            found["depth_std [mm]"] = frame.map("depth_std")
        return found


class Vic3dPoints(PointTable):
    """Surface points in the columns of CSV files that VIC-3D exports, read by name.

    ``s+0_t+0.csv``: ``X [mm]``, ``Y [mm]``, ``Z [mm]``, ``U [mm]``, ``V [mm]``, ``W [mm]``; ``exx [1] - Lagrange`` and
    so on for ``eyy``, ``exy``, ``e1``, ``e2``, with the measure in the name; ``gamma [deg]``, the angle of the first
    principal strain; ``sigma [pixel]``, the standard deviation of disparity in px, 0 for a truth and NaN if an
    estimate does not state it; ``x [pixel]``, ``y [pixel]``, and the displacement in the image ``u [pixel]``,
    ``v [pixel]``. Displacements lead to the next frame unless ``since`` is set. Lost: as for ``point_csv``, and
    standard deviations of strain.
    """

    kind: Literal["vic3d"] = "vic3d"
    """Name of the format."""
    summary: ClassVar[str] = "points, displacements and strains in the columns of VIC-3D"

    def columns(self, frame: SurfaceFrame, source: ExportSource) -> Mapping[str, NDArray[Any]]:
        """Return the columns."""
        columns, rows = frame.pixels()
        flow = frame.image_motion()
        found = {f"{name} [mm]": values for name, values in zip("XYZ", frame.points, strict=True)}
        found |= {f"{name} [mm]": values for name, values in zip("UVW", frame.moved, strict=True)}
        found |= {f"{name} [1] - {_MEASURES[self.measure]}": frame.strain(name) for name in STRAINS}
        found["gamma [deg]"] = np.degrees(frame.strain("angle"))
        found["sigma [pixel]"] = frame.sigma()
        return found | {"x [pixel]": columns, "y [pixel]": rows, "u [pixel]": flow[0], "v [pixel]": flow[1]}


class DicePoints(PointTable):
    """Surface points in the columns of the text files of DICe (Sandia), read by name.

    ``DICe_solution_0.txt`` and so on (``00`` to ``11`` of 12 frames), comma-separated: ``SUBSET_ID``,
    ``COORDINATE_X``, ``COORDINATE_Y`` in px, ``DISPLACEMENT_X``, ``DISPLACEMENT_Y`` in px to the next frame; ``SIGMA``,
    the standard deviation of disparity in px (0 for a truth); ``GAMMA``, ``BETA``, ``UNCERTAINTY``, which are NaN;
    ``STATUS_FLAG``, 4 (INITIALIZE_SUCCESSFUL); Green-Lagrange strain ``VSG_STRAIN_XX``, ``VSG_STRAIN_YY``,
    ``VSG_STRAIN_XY``; ``MODEL_COORDINATES_X``, ``_Y``, ``_Z`` and ``MODEL_DISPLACEMENT_X``, ``_Y``, ``_Z`` in mm, in
    the world. All files have the same subsets in the same lines; those without a result have ``SIGMA`` -1,
    ``STATUS_FLAG`` 8 (CORRELATION_FAILED) and NaN. Lost: as for ``vic3d``, and principal strains.
    """

    kind: Literal["dice"] = "dice"
    """Name of the format."""
    measure: Literal["green_lagrange"] = "green_lagrange"
    """The strain tensor of DICe."""
    every_point: ClassVar[bool] = True
    summary: ClassVar[str] = "points, displacements and strains in the columns of DICe"

    def columns(self, frame: SurfaceFrame, source: ExportSource) -> Mapping[str, NDArray[Any]]:
        """Return the columns."""
        columns, rows = frame.pixels()
        flow, empty = frame.image_motion(), np.full(columns.shape, np.nan)
        found: dict[str, NDArray[Any]] = {
            "SUBSET_ID": np.arange(columns.size).reshape(columns.shape),
            "COORDINATE_X": columns,
            "COORDINATE_Y": rows,
            "DISPLACEMENT_X": np.where(frame.known, flow[0], np.nan),
            "DISPLACEMENT_Y": np.where(frame.known, flow[1], np.nan),
            "SIGMA": np.where(frame.known, frame.sigma(), -1.0),
            "GAMMA": empty,
            "BETA": empty,
            "STATUS_FLAG": np.where(frame.known, _SUCCESSFUL, _FAILED),
            "UNCERTAINTY": empty,
        }
        found |= {f"VSG_STRAIN_{name[1:].upper()}": frame.strain(name) for name in STRAINS[:3]}
        for what, values in (("COORDINATES", frame.points), ("DISPLACEMENT", frame.moved)):
            known = np.where(frame.known, values, np.nan)
            found |= {f"MODEL_{what}_{axis}": each for axis, each in zip("XYZ", known, strict=True)}
        return found

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one file for every frame, numbered from 0, with as many digits as the number of frames."""
        notes = super().write(source, folder)
        digits = len(str(len(source.frames)))
        for number, t in enumerate(source.frames):
            (folder / f"{image_name(0, t)}.csv").rename(folder / f"DICe_solution_{number:0{digits}}.txt")
        return notes


class MatchidPoints(PointTable):
    """Surface points in the columns of CSV files that MatchID exports, read by name.

    ``s+0_t+0.csv``: ``Coordinates.Image X [Pixel]``, ``Coordinates.Image Y [Pixel]``; ``coor.X [mm]``, ``coor.Y [mm]``,
    ``coor.Z [mm]``; ``disp.Horizontal Displacement U [mm]``, ``disp.Vertical Displacement V [mm]``,
    ``disp.Out-Of-Plane: W [mm]``; ``strain.Strain-global frame: Exx [ ]``, ``Eyy``, ``Exy``; ``strain.Maximum Principal
    Strain: EI [ ]``, ``strain.Minimum Principal Strain: EII [ ]``. Displacements lead to the next frame, not from the
    first one. Lost: as for ``vic3d``, and standard deviations.
    """

    kind: Literal["matchid"] = "matchid"
    """Name of the format."""
    summary: ClassVar[str] = "points, displacements and strains in the columns of MatchID"

    def columns(self, frame: SurfaceFrame, source: ExportSource) -> Mapping[str, NDArray[Any]]:
        """Return the columns."""
        columns, rows = frame.pixels()
        found = {"Coordinates.Image X [Pixel]": columns, "Coordinates.Image Y [Pixel]": rows}
        found |= {f"coor.{name} [mm]": values for name, values in zip("XYZ", frame.points, strict=True)}
        names = ("Horizontal Displacement U", "Vertical Displacement V", "Out-Of-Plane: W")
        found |= {f"disp.{name} [mm]": values for name, values in zip(names, frame.moved, strict=True)}
        found |= {f"strain.Strain-global frame: E{name[1:]} [ ]": frame.strain(name) for name in STRAINS[:3]}
        found["strain.Maximum Principal Strain: EI [ ]"] = frame.strain("e1")
        found["strain.Minimum Principal Strain: EII [ ]"] = frame.strain("e2")
        return found
