"""The sampled pixels on which convention mismatches are tested, their positions, and the acquisition parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import read_intrinsics
from scenetruth.scoring.alignment import align, check_alignable, select_pixels
from scenetruth.scoring.error_pairs import compute_pixel_coordinates, find_valid_pixels

__all__ = [
    "POSITION_HYPOTHESES",
    "AcquisitionParameters",
    "MismatchSamples",
    "PositionHypothesis",
    "SampleGrid",
    "SamplePositions",
    "fit_factor",
    "lengths",
    "read_mismatch_samples",
    "weighted_median",
]


Map = NDArray[np.float64]


def weighted_median(values: Map, weights: Map) -> float:
    """Return the weighted median; NaN where the weights sum to zero.

    >>> weighted_median(np.array([5.0, 1.0, 2.0]), np.array([1.0, 1.0, 3.0]))
    2.0
    """
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    if not (below.size and below[-1] > 0):
        return float("nan")
    return float(values[order[np.searchsorted(below, 0.5 * below[-1])]])


def lengths(vectors: Map) -> Map:
    """Return the lengths of vectors, shape (component, n)."""
    if len(vectors) == 1:
        return np.asarray(np.abs(vectors[0]))
    return np.asarray(np.sqrt(np.einsum("cn,cn->n", vectors, vectors)))


def fit_factor(found: Map, expected: Map) -> float:
    """Return the factor a that minimises the sum of ``abs(found - a expected)``; NaN where all expected are zero."""
    there = expected != 0
    expected = expected[there]
    return weighted_median(found[there] / expected, np.abs(expected))


@dataclass(frozen=True)
class AcquisitionParameters:
    """The acquisition parameters that mismatches of scale and meaning depend on.

    ``positions``: Number of stage positions, or None if the truth does not specify it.
    ``step_px``, ``width_px``: Pixel distance and width of the map, in camera px.
    """

    focal_length_px: float
    baseline_mm: float
    frame_interval_s: float
    positions: int | None
    step_px: float
    width_px: float


def read_acquisition_parameters(estimate: xr.Dataset, truth: xr.Dataset) -> AcquisitionParameters:
    """Read the parameters of an estimate and its full truth."""
    camera = read_intrinsics(truth)
    _, step_px = compute_pixel_coordinates(estimate).step_px
    return AcquisitionParameters(
        focal_length_px=camera.focal_length_px,
        baseline_mm=camera.baseline_mm,
        frame_interval_s=camera.frame_interval_s,
        positions=truth.sizes.get("s"),
        step_px=step_px,
        width_px=step_px * estimate.sizes["x"],
    )


Indices = NDArray[np.intp]


@dataclass(frozen=True)
class SamplePositions:
    """Array indices of sampled pixels, shape (n,); ``frame`` is that of a `SampleGrid`, negative if missing."""

    frame: Indices
    y: Indices
    x: Indices

    def shifted(self, down: int = 0, right: int = 0) -> SamplePositions:
        """Return the positions shifted by whole pixels."""
        return replace(self, y=self.y + down, x=self.x + right)


@dataclass(frozen=True)
class SampleGrid:
    """Size of the maps, and for each frame the index of the next, the previous and the time-reversed frame, or -1."""

    rows: int
    columns: int
    following: Indices
    preceding: Indices
    opposite: Indices


@dataclass(frozen=True)
class PositionHypothesis:
    """A mismatch of position; ``source`` returns the true positions of the values, or None where not applicable."""

    kind: str
    message: str
    source: Callable[[SamplePositions, SampleGrid], SamplePositions | None]


def _upside_down(places: SamplePositions, grid: SampleGrid) -> SamplePositions:
    return replace(places, y=grid.rows - 1 - places.y)


def _mirrored(places: SamplePositions, grid: SampleGrid) -> SamplePositions:
    return replace(places, x=grid.columns - 1 - places.x)


def _turned(places: SamplePositions, grid: SampleGrid) -> SamplePositions:
    return _mirrored(_upside_down(places, grid), grid)


def _transposed(places: SamplePositions, grid: SampleGrid) -> SamplePositions | None:
    return replace(places, y=places.x, x=places.y) if grid.rows == grid.columns else None


def _frames(places: SamplePositions, frames: Indices) -> SamplePositions | None:
    moved = frames[places.frame]
    return None if np.array_equal(moved, places.frame) else replace(places, frame=moved)


def _reversed(places: SamplePositions, grid: SampleGrid) -> SamplePositions | None:
    return _frames(places, grid.opposite)


def _next(places: SamplePositions, grid: SampleGrid) -> SamplePositions | None:
    return _frames(places, grid.following)


def _previous(places: SamplePositions, grid: SampleGrid) -> SamplePositions | None:
    return _frames(places, grid.preceding)


POSITION_HYPOTHESES = (
    PositionHypothesis(
        "rows_upside_down",
        "the maps of {quantity} are upside down: flip them, array[..., ::-1, :]; row 0 is at the top",
        _upside_down,
    ),
    PositionHypothesis(
        "columns_mirrored",
        "the maps of {quantity} are mirrored: flip them, array[..., ::-1]; column 0 is at the left",
        _mirrored,
    ),
    PositionHypothesis(
        "maps_turned",
        "the maps of {quantity} are rotated by 180 degrees: flip both axes, array[..., ::-1, ::-1]",
        _turned,
    ),
    PositionHypothesis(
        "maps_transposed",
        "rows and columns of {quantity} are exchanged: transpose the maps, np.swapaxes(array, -2, -1)",
        _transposed,
    ),
    PositionHypothesis(
        "frames_reversed",
        "the frames of {quantity} are in reverse order: the earliest comes first",
        _reversed,
    ),
    PositionHypothesis(
        "frame_after",
        "{quantity} is shifted by one frame: the map of t + 1 is given for t; specify the frames with t=",
        _next,
    ),
    PositionHypothesis(
        "frame_before",
        "{quantity} is shifted by one frame: the map of t - 1 is given for t; specify the frames with t=",
        _previous,
    ),
)
"""All mismatches of position by frames and whole maps, in order of preference."""


Mask = NDArray[np.bool_]

MISMATCH_VARIABLES = ("depth", "disparity", "flow", "velocity")
"""The variables that are tested for mismatches."""

_STATUSES = ("status", "status_disparity", "status_motion")
_NEEDED = (*MISMATCH_VARIABLES, "mixed", "boundary_distance")

_FRAMES = 3
"""Maximum number of frames that are evaluated; a mismatch affects all frames."""
_EDGE_PX = 4.0
"""Closer to discontinuities, windows mix surfaces and derivatives of the truth are not those of a surface."""


@dataclass(frozen=True)
class MismatchSamples:
    """The maps of one quantity.

    ``estimate``: Shape (component, t, y, x); NaN where invalid.
    ``truth``: Shape (component, frame, y, x), with the frames of the estimate first; NaN where there is no surface.
    ``rays``: Length of the ray of every pixel, scaled to Z = 1; shape (y, x).
    ``smooth``: True where no discontinuity of the true surface is near, shape (t, y, x).
    """

    quantity: str
    facts: AcquisitionParameters
    estimate: Map
    truth: Map
    grid: SampleGrid
    rays: Map
    smooth: Mask

    def estimate_at(self, places: SamplePositions) -> Map:
        """Return the estimate's values, shape (component, n)."""
        return np.asarray(self.estimate[:, places.frame, places.y, places.x])

    def truth_at(self, places: SamplePositions) -> Map:
        """Return the true values, shape (component, n); NaN where there is no such frame."""
        values = np.asarray(self.truth[:, places.frame, places.y, places.x])
        values[:, places.frame < 0] = np.nan
        return values

    def drawn(self, count: int, *, inner: bool = False) -> SamplePositions:
        """Return at most ``count`` evenly spread pixels where estimate and truth are valid."""
        frames = self.estimate.shape[1]
        known = np.asarray(np.isfinite(self.estimate).all(axis=0))
        known &= np.isfinite(self.truth[:, :frames]).all(axis=0)
        if inner:
            known &= self.smooth
            known[:, [0, -1]] = known[:, :, [0, -1]] = False
        flat = np.flatnonzero(known)
        if len(flat) > count:
            flat = flat[np.linspace(0, len(flat) - 1, count).astype(np.intp)]
        return SamplePositions(*np.unravel_index(flat, known.shape))


def read_mismatch_samples(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[MismatchSamples]:
    """Yield the samples of each quantity, from selected frames of an estimate."""
    check_alignable(estimate, truth)
    count = estimate.sizes["t"]
    held = [name for name in MISMATCH_VARIABLES if name in estimate]
    if not (held and count):
        return
    chosen = np.unique(np.linspace(0, count - 1, min(count, _FRAMES)).round().astype(int))
    few = estimate[[*held, *(name for name in _STATUSES if name in estimate)]].isel(t=chosen)
    facts = read_acquisition_parameters(few, truth)
    needed = truth[[name for name in _NEEDED if name in truth]]
    _, exact = align(few, needed)
    beside, grid = _neighbouring_frames(estimate, truth, chosen)
    others = needed.sel({dim: 0 for dim in ("s_y", "s") if dim in needed.dims}).sel(t=beside)
    others = select_pixels(others, few)
    smooth = exact["boundary_distance"].transpose("t", "y", "x").values > _EDGE_PX
    rays = _rays(few)
    for name in held:
        found = _maps(few[name])
        found[:, ~find_valid_pixels(few, name)] = np.nan
        maps = np.concatenate([_maps(exact[name]), _maps(others[name])], axis=1) if beside else _maps(exact[name])
        yield MismatchSamples(name, facts, found, maps, grid, rays, smooth)


def _neighbouring_frames(
    estimate: xr.Dataset, truth: xr.Dataset, chosen: NDArray[np.intp]
) -> tuple[list[int], SampleGrid]:
    """Return the additional frames of the truth that are needed, and the order of all frames."""
    times = [int(t) for t in estimate["t"].values]
    there = {int(t) for t in truth["t"].values}
    own = [times[place] for place in chosen]
    opposite = [times[-1 - place] for place in chosen]
    wanted = {*opposite, *(t + 1 for t in own), *(t - 1 for t in own)}
    beside = sorted((wanted & there) - set(own))
    at = {t: place for place, t in enumerate([*own, *beside])}
    following, preceding, across = (
        np.array([at.get(t, -1) for t in some], dtype=np.intp)
        for some in ([t + 1 for t in own], [t - 1 for t in own], opposite)
    )
    return beside, SampleGrid(estimate.sizes["y"], estimate.sizes["x"], following, preceding, across)


def _maps(array: xr.DataArray) -> Map:
    """Return maps of the shape (component, t, y, x); NaN where not finite."""
    values = np.array(array.transpose(..., "t", "y", "x").values, dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    return values if values.ndim == 4 else values[np.newaxis]


def _rays(dataset: xr.Dataset) -> Map:
    camera, pixels = read_intrinsics(dataset), compute_pixel_coordinates(dataset)
    c_x, c_y = camera.principal_point_px
    x, y = (pixels.x - c_x) / camera.focal_length_px, (pixels.y - c_y) / camera.focal_length_px
    return np.asarray(np.sqrt(1 + x**2 + y[:, np.newaxis] ** 2))
