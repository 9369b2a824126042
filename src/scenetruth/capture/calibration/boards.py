"""Calibration boards: ChArUco, checkerboard, and symmetric or asymmetric grids of dots."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from scenetruth.capture.board_artwork import DotPlace, marker_problem
from scenetruth.capture.calibration.rig_model import CalibrationTarget
from scenetruth.discovery import kind_in_lower_case
from scenetruth.validated_model import FrozenModel, NonNegative, Positive

__all__ = ["Board", "CharucoBoard", "Checkerboard", "DotGrid"]

Array = NDArray[np.float64]

_Count = Annotated[int, Field(ge=2, le=100)]


class _Tolerances(FrozenModel):
    """Tolerances of a board."""

    scale_std: NonNegative = 1e-3
    """Standard deviation of the relative scale: 1e-3 for a print, 1e-4 for a measured board."""
    warp_mm: NonNegative = 0.02
    """Standard deviation of the flatness error in mm: 0.02 for glass, 0.2 for paper on a board."""

    @property
    def points_mm(self) -> Array:
        """Points (u, v, 0) of the board about its centre, row by row, v downwards; shape (n, 3)."""
        raise NotImplementedError

    @property
    def target(self) -> CalibrationTarget:
        """Tolerances and size of the board as a target of the bundle adjustment."""
        half = float(np.abs(self.points_mm).max())
        return CalibrationTarget(half_width_mm=half, scale_std=self.scale_std, warp_mm=self.warp_mm)


def _grid(columns: int, rows: int, spacing_mm: float) -> Array:
    u, v = np.meshgrid(
        (np.arange(columns) - (columns - 1) / 2) * spacing_mm, (np.arange(rows) - (rows - 1) / 2) * spacing_mm
    )
    return np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])


class CharucoBoard(_Tolerances):
    """Checkerboard with ArUco markers in its white squares; parts of it are sufficient."""

    kind: Literal["charuco"]
    """``charuco``."""
    squares: tuple[_Count, _Count]
    """Number of squares (columns, rows)."""
    square_mm: Positive
    """Side of a square in mm."""
    marker_mm: Positive
    """Side of a marker in mm, less than that of a square."""
    dictionary: str = "4X4_250"
    """Marker dictionary of OpenCV without ``DICT_``."""
    legacy: bool = False
    """Pattern of OpenCV before 4.6, whose first square is white for an even number of rows."""

    @model_validator(mode="after")
    def _marker_inside(self) -> CharucoBoard:
        if self.marker_mm >= self.square_mm:
            msg = f"marker_mm must be less than square_mm ({self.square_mm:g}); got {self.marker_mm:g}"
            raise ValueError(msg)
        return self

    @property
    def points_mm(self) -> Array:
        """Inner corners about the centre, row by row; shape (n, 3)."""
        return _grid(self.squares[0] - 1, self.squares[1] - 1, self.square_mm)

    @property
    def gap(self) -> float:
        """Distance of the markers from the edges of their squares, in squares."""
        return (1 - self.marker_mm / self.square_mm) / 2


class Checkerboard(_Tolerances):
    """Checkerboard without markers; all inner corners must be visible."""

    kind: Literal["checkerboard"]
    """``checkerboard``."""
    squares: tuple[_Count, _Count]
    """Number of squares (columns, rows); one even and one odd number make the orientation unique."""
    square_mm: Positive
    """Side of a square in mm."""

    @model_validator(mode="after")
    def _enough(self) -> Checkerboard:
        if min(self.squares) < 4:
            msg = f"squares must be at least 4 x 4, which have 3 x 3 inner corners; got {self.squares}"
            raise ValueError(msg)
        return self

    @property
    def points_mm(self) -> Array:
        """Inner corners about the centre, row by row; shape (n, 3)."""
        return _grid(self.squares[0] - 1, self.squares[1] - 1, self.square_mm)

    @property
    def gap(self) -> float:
        """Free distance from the edges of the squares, in squares; there are no markers."""
        return 1.0


class DotGrid(_Tolerances):
    """Grid of round dots; all dots must be visible, unless three of them are hollow."""

    kind: Literal["dots", "asymmetric_dots"]
    """``dots``: a rectangular grid; ``asymmetric_dots``: every second row is shifted by half the spacing."""
    dots: tuple[_Count, _Count]
    """Number of dots (per row, rows)."""
    spacing_mm: Positive
    """Distance in mm between the dots of a row; rows of an asymmetric grid have half of it."""
    diameter_mm: Positive
    """Diameter of the dots in mm."""
    dark: bool = True
    """Dark dots on a bright ground; false for bright dots."""
    markers: tuple[DotPlace, DotPlace, DotPlace] | None = None
    """Hollow dots (column, row), from 0 at the upper left: one, another in its row, and another in its column."""

    @model_validator(mode="after")
    def _apart(self) -> DotGrid:
        nearest = self.spacing_mm / (np.sqrt(2) if self.kind == "asymmetric_dots" else 1)
        if self.diameter_mm > 0.8 * nearest:
            msg = f"diameter_mm must be at most 0.8 of the distance of the dots ({nearest:g}); got {self.diameter_mm:g}"
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _markers_on_the_grid(self) -> DotGrid:
        if self.markers is None:
            return self
        problem = marker_problem(self.kind, self.dots, self.markers)
        if problem:
            msg = f"markers {problem}"
            raise ValueError(msg)
        return self

    @property
    def points_mm(self) -> Array:
        """Centres of the dots about the centre of the board, row by row; shape (n, 3)."""
        columns, rows = self.dots
        if self.kind == "dots":
            return _grid(columns, rows, self.spacing_mm)
        # The order of OpenCV: odd rows are shifted by half the spacing.
        row, column = (each.ravel() for each in np.mgrid[:rows, :columns])
        points = np.column_stack([(2 * column + row % 2) * self.spacing_mm / 2, row * self.spacing_mm / 2, 0.0 * row])
        return np.asarray(points - (points.max(axis=0) + points.min(axis=0)) / 2)


Board = Annotated[
    CharucoBoard | Checkerboard | DotGrid, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)
]
"""A board, by its ``kind``."""
