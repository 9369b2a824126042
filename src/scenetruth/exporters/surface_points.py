"""Points of a surface with displacements and strains: what tables and fields have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, field_validator

from scenetruth.errors import Problem
from scenetruth.exporters.camera_geometry import compute_pose, point_problems, points_in_world, project
from scenetruth.exporters.export_source import ExportSource
from scenetruth.exporters.format_base import ExportFormat
from scenetruth.exporters.image_files import image_name

if TYPE_CHECKING:
    from scenetruth.strain import StrainSettings

__all__ = ["STRAINS", "PointOptions", "PointTable", "PointTotals", "SurfaceFrame"]

Array = NDArray[np.float64]

STRAINS = ("exx", "eyy", "exy", "e1", "e2")
"""Components and principal values of strain."""


class SurfaceFrame:
    """Points on a lattice of pixels of a frame, with displacements and strains.

    ``points``, ``moved``: Positions and displacements in the world, mm, shape (3, y, x); ``known`` where both are
    finite. ``maps``: The strain data set of the frame. ``home``: Frame of the points. ``later``: Frame to which the
    displacements lead, if points are tracked.
    """

    def __init__(
        self, source: ExportSource, home: int, maps: xr.Dataset, *, y_up: bool, later: int | None = None
    ) -> None:
        self.maps = maps
        self._source, self._t, self._y_up, self._later = source, home, y_up, later
        self._rows, self._columns = (
            np.searchsorted(np.asarray(source.maps[dim].values), self.maps[dim].values) for dim in ("y", "x")
        )
        pose = compute_pose(source, 0, home)
        self.points = self._turned(self._at_points(points_in_world(source, 0, home)))
        self.moved = self._turned(np.einsum("ij,jyx->iyx", pose.axes, self.maps["displacement"].values))
        self.known = np.isfinite(self.points).all(axis=0) & np.isfinite(self.moved).all(axis=0)

    def _at_points(self, values: Array) -> Array:
        """Return a map of all pixels at the points."""
        return np.asarray(values[..., self._rows[:, None], self._columns])

    def _turned(self, vectors: Array) -> Array:
        """Return vectors of the world along the chosen axes."""
        sign = np.array([1.0, -1.0, -1.0]) if self._y_up else np.ones(3)
        # Avoid -0.0.
        return np.asarray(sign[:, None, None] * vectors + 0.0)

    def strain(self, name: str) -> Array:
        """Return a map of strain, NaN where it is not stated; with Y upwards, shear and angle have the other sign."""
        if name not in self.maps:
            return np.full(self.known.shape, np.nan)
        values = np.asarray(self.maps[name].values, dtype=np.float64)
        return np.asarray(-values + 0.0 if self._y_up and name in ("exy", "angle") else values)

    def map(self, name: str) -> Array:
        """Return a map of the source at the points, components first; NaN if it has none."""
        if name not in self._source.maps:
            return np.full(self.known.shape, np.nan)
        return self._at_points(self._source.map(name, 0, self._t))

    def pixels(self) -> tuple[Array, Array]:
        """Return the columns and rows of the points, in px of the camera."""
        x, y = (np.asarray(self.maps[dim].values, dtype=np.float64) for dim in ("x", "y"))
        columns, rows = np.meshgrid(x, y)
        return columns, rows

    def sigma(self) -> Array:
        """Return the standard deviation of disparity in px: 0 for a truth, NaN if it is not stated."""
        return np.zeros(self.known.shape) if self._source.is_truth else np.abs(self.map("disparity_std"))

    def moved_std(self) -> Array | None:
        """Return the standard deviations of the displacements along their axes, mm; None if they are not stated.

        Errors of the components count as independent of each other. Sums over several frames are not stated.
        """
        if self._later is not None or self._source.is_truth or "velocity_std" not in self._source.maps:
            return None
        axes = compute_pose(self._source, 0, self._t).axes
        return np.asarray(np.sqrt(np.einsum("ij,jyx->iyx", axes**2, self.map("velocity_std") ** 2)))

    def image_motion(self) -> Array:
        """Return the displacements in the image, px, shape (2, y, x)."""
        if self._later is not None:
            ends = self._turned(self.points + self.moved).reshape(3, -1)
            pixels = project(self._source, ends, compute_pose(self._source, 0, self._later))
            start = np.stack(np.meshgrid(self._columns, self._rows)).reshape(2, -1)
            return np.asarray(self._source.step_px * (pixels - start)).reshape(2, *self.known.shape)
        name = "flow_next" if "flow_next" in self._source.maps else "flow"
        values = self.map(name)
        return values if values.ndim == 3 else np.stack([values, values])


@dataclass
class PointTotals:
    """What the notes of an export state.

    ``points``: Number of written points. ``gauge_px``: Length of the strain gauge. ``missing``: Why no point of a frame
    has strain. ``strained``: Whether a point has strain.
    """

    points: int = 0
    gauge_px: float = 0.0
    missing: str = ""
    strained: bool = False

    def add(self, frame: SurfaceFrame, settings: StrainSettings) -> None:
        """Add a frame."""
        from scenetruth.strain import describe_missing_strain

        self.points += int(frame.known.sum())
        self.gauge_px = float(frame.maps.attrs["gauge_length_px"])
        missing = describe_missing_strain(frame.maps["invalid_reason"].values, settings)
        self.missing, self.strained = self.missing or missing, self.strained or not missing


class PointOptions(ExportFormat):
    """Options of formats with strain: its gauge, and the axes."""

    measure: Literal["green_lagrange", "hencky", "engineering"] = "green_lagrange"
    """The strain tensor."""
    window: Annotated[int, Field(ge=3, le=1001)] = 11
    """Points along each side of the strain window; an odd number."""
    step: Annotated[int, Field(ge=1, le=1001)] = 4
    """Distance of the points in pixels of the maps."""
    order: Literal[1, 2] = 1
    """Order of the polynomial of the strain window."""
    weights: Literal["uniform", "gaussian"] = "uniform"
    """Weights of the strain window."""
    since: int | None = None
    """Frame of the reference configuration of all frames, whose points are tracked; null: each frame is its own, with
    displacements to the next one."""
    axes: Literal["camera", "y_up"] = "camera"
    """``camera``: X right, Y down, Z forward; ``y_up``: X right, Y up, Z towards the camera."""

    @field_validator("window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = "must be an odd number"
            raise ValueError(msg)
        return value

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements of displacements."""
        yield from super().problems(source)
        yield from point_problems(source)
        if "depth" not in source.maps:
            yield Problem("depth", "is missing; strain is computed from depth and motion")
        if "displacement_next" not in source.maps and "velocity" not in source.maps:
            yield Problem("velocity", "is missing; displacements need it, or a complete truth")
        elif self.since is not None and "velocity" not in source.maps:
            yield Problem("velocity", "is missing; it is integrated from the frame of reference")
        if self.since is not None and self.since not in source.frames:
            yield Problem("since", f"must be one of the frames {source.frames}", self.since)
        elif self.since is not None and len(source.frames) < 2:
            yield Problem("since", "needs two or more frames with maps; estimate further frames", self.since)

    def strain_settings(self) -> StrainSettings:
        """Return the settings of the strain."""
        from scenetruth.strain import StrainSettings

        names = ("measure", "window", "step", "order", "weights")
        return StrainSettings(**{name: getattr(self, name) for name in names})

    def frames(self, source: ExportSource) -> Iterator[tuple[int, SurfaceFrame]]:
        """Yield all frames of the reference camera with their points."""
        from scenetruth.strain import compute_strain

        settings = self.strain_settings()
        y_up = self.axes == "y_up"
        if self.since is None:
            for t in source.frames:
                maps = compute_strain(source.maps.sel(t=[t]), settings=settings).isel(t=0)
                yield t, SurfaceFrame(source, t, maps, y_up=y_up)
            return
        strain = compute_strain(source.maps.sel(t=source.frames), settings=settings, since=self.since)
        for n, t in enumerate(source.frames):
            yield t, SurfaceFrame(source, self.since, strain.isel(t=n), y_up=y_up, later=t)

    def notes(self, source: ExportSource, totals: PointTotals) -> list[str]:
        """Return the notes of an export."""
        if self.since is not None:
            motion = f"from frame {self.since} to frame t, integrated from velocities"
        elif "displacement_next" in source.maps:
            motion = "from frame t to t + 1"
        else:
            motion = "the velocity at frame t over one frame, not a finite displacement"
        axes = "X right, Y down, Z forward" if self.axes == "camera" else "X right, Y up, Z towards the camera"
        gauge = f"strain gauge {totals.gauge_px:.3g} px"
        found = [f"{totals.points} points; U, V, W: {motion}; {gauge}; axes: {axes}"]
        if not totals.strained:
            found.append(totals.missing)
        if self.since is None and len(source.frames) > 1:
            found.append("displacements from one frame of reference, as programs for image correlation state: since=T")
        return found if len(source.views) == 1 else [*found, "only the points of the reference camera (s = 0)"]


class PointTable(PointOptions):
    """A table of points for every frame of the reference camera."""

    ending: ClassVar[str] = "csv"
    missing: ClassVar[str] = "NaN"
    """What stands for a number that does not exist; the functions of NumPy and MATLAB for tables read it."""
    every_point: ClassVar[bool] = False
    """Whether points without a result have a line."""

    @abstractmethod
    def columns(self, frame: SurfaceFrame, source: ExportSource) -> Mapping[str, NDArray[Any]]:
        """Return the columns by their names, maps (y, x)."""

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one file for every frame."""
        import pandas as pd

        totals, settings = PointTotals(), self.strain_settings()
        for t, frame in self.frames(source):
            totals.add(frame, settings)
            lines = np.ones_like(frame.known) if self.every_point else frame.known
            table = pd.DataFrame({name: values[lines] for name, values in self.columns(frame, source).items()})
            file = folder / f"{image_name(0, t)}.{self.ending}"
            table.to_csv(file, index=False, lineterminator="\n", na_rep=self.missing)
        return self.notes(source, totals)
