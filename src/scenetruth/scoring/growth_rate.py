"""The areal growth rate of a surface, from affine fits to depth and velocity in Gaussian windows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import read_intrinsics
from scenetruth.scoring.error_pairs import (
    EstimateTruthPair,
    compute_pixel_coordinates,
    compute_surface_points,
    find_valid_pixels,
    percent_per_hour,
)
from scenetruth.settings import ScoreSettings
from scenetruth.threads import in_order

__all__ = [
    "GrowthMaps",
    "compute_growth_maps",
    "compute_growth_pairs",
    "compute_growth_rate",
    "compute_windowed_growth",
    "has_growth_rate",
    "label_depth_segments",
]


Map = NDArray[np.float64]
Labels = NDArray[np.int32]


def label_depth_segments(
    depth: Map,
    focal_length_px: float,
    max_slope_deg: float = 80.0,
    *,
    objects: NDArray[np.generic] | None = None,
    step_px: tuple[float, float] = (1.0, 1.0),
) -> Labels:
    """Label the connected surface segments of a depth map (y, x) in mm: int32, 0, 1, ..., and -1 where undefined.

    Neighbouring pixels belong to one segment if their depths differ by at most tan(``max_slope_deg``) Z / f, with Z the
    smaller depth, and if they show the same object.

    ``objects``: Object index of every pixel, shape (y, x); default: a single object.
    ``step_px``: Distances between neighbouring pixels of the map, along y and along x, in px.
    """
    steepest = math.tan(math.radians(max_slope_deg)) / focal_length_px
    index = np.arange(depth.size).reshape(depth.shape)
    starts, ends = [], []
    sides = (((..., slice(-1)), (..., slice(1, None)), step_px[1]), (slice(-1), slice(1, None), step_px[0]))
    for one, other, step in sides:
        near, far = np.minimum(depth[one], depth[other]), np.maximum(depth[one], depth[other])
        # Comparisons with NaN are false, so missing pixels connect to nothing.
        joined = far - near <= steepest * step * near
        if objects is not None:
            joined &= objects[one] == objects[other]
        starts.append(index[one][joined])
        ends.append(index[other][joined])
    start, end = np.concatenate(starts), np.concatenate(ends)
    graph = coo_matrix((np.ones(start.size, dtype=np.int8), (start, end)), shape=(depth.size, depth.size))
    _, labels = connected_components(graph, directed=False)
    seen = np.isfinite(depth)
    numbers = np.full(depth.shape, -1, dtype=np.int32)
    numbers[seen] = np.unique(labels.reshape(depth.shape)[seen], return_inverse=True)[1].ravel()
    return numbers


Mask = NDArray[np.bool_]
Moments = tuple[Map, Map, Map]

_TRUNCATE = 3.0
"""Extent of the window in standard deviations. The fit of affine fields is exact for any weights."""
_BAND_PIXELS = 320_000  # pixels of a segment that are fitted together, in each of two threads
_FLAT = 1e-6
"""Minimum determinant of a window's covariance, in units of sigma^4, below which x and y are not separable."""


def compute_windowed_growth(
    points: Map, velocity: Map, patches: Labels, window_px: float | tuple[float, float], min_coverage: float = 0.5
) -> Map:
    """Return the areal growth rate of one frame in 1/frame, shape (y, x); NaN where the coverage is too small.

    ``points``, ``velocity``: Surface points in mm and their velocities in mm/frame, shape (3, y, x).
    ``patches``: Segment label of every pixel, negative outside; a window uses only the segment of its centre.
    """
    growth = np.full(patches.shape, np.nan)
    sigma_y, sigma_x = window_px if isinstance(window_px, tuple) else (window_px, window_px)
    window = _Window(_moments(sigma_y), _moments(sigma_x), _FLAT * (sigma_y * sigma_x) ** 2, min_coverage)
    # A segment with fewer pixels cannot reach the minimum coverage.
    least = min_coverage / (window.along_y[0].max() * window.along_x[0].max())
    sizes = np.bincount(patches[patches >= 0].ravel(), minlength=1)
    for number, box in enumerate(ndimage.find_objects(patches + 1)):
        if sizes[number] < least:
            continue
        inside = patches[box] == number
        for own, needed in _row_bands(inside.shape, len(window.along_y[0]) // 2):
            part = inside[needed]
            rows = slice(box[0].start + needed.start, box[0].start + needed.stop)
            fields = np.where(part, np.concatenate([points[:, rows, box[1]], velocity[:, rows, box[1]]]), 0.0)
            values = _growth_of_segment(fields, part, window)[own.start - needed.start : own.stop - needed.start]
            growth[box][own][inside[own]] = values[inside[own]]
    return growth


def _row_bands(shape: tuple[int, ...], reach: int) -> Iterator[tuple[slice, slice]]:
    """Yield the rows of bands that limit memory, and those that their windows need."""
    height, width = shape
    rows = max(4 * reach, _BAND_PIXELS // max(width, 1))
    for first in range(0, height, rows):
        last = min(first + rows, height)
        yield slice(first, last), slice(max(first - reach, 0), min(last + reach, height))


@dataclass(frozen=True)
class _Window:
    """Gaussian weights along y and x (see `_moments`), and the minimum determinant and coverage of a window."""

    along_y: Moments
    along_x: Moments
    min_determinant: float
    min_coverage: float


def _growth_of_segment(fields: Map, inside: Mask, window: _Window) -> Map:
    """Return the growth rate of one segment from its points and velocities (6, y, x), which are zero outside."""
    one_y, first_y, second_y = window.along_y
    one_x, first_x, second_x = window.along_x
    mask = inside.astype(np.float64)
    plain, along_x = _filtered(mask, one_x, -1), _filtered(mask, first_x, -1)
    weight = _filtered(plain, one_y, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_x, mean_y = _filtered(along_x, one_y, -2) / weight, _filtered(plain, first_y, -2) / weight
        # Covariance of the pixel positions in the window.
        c_xx = _filtered(_filtered(mask, second_x, -1), one_y, -2) / weight - mean_x**2
        c_xy = _filtered(along_x, first_y, -2) / weight - mean_x * mean_y
        c_yy = _filtered(plain, second_y, -2) / weight - mean_y**2
        determinant = c_xx * c_yy - c_xy**2
        plain, along_x = _filtered(fields, one_x, -1), _filtered(fields, first_x, -1)
        mean = _filtered(plain, one_y, -2) / weight
        by_x = _filtered(along_x, one_y, -2) / weight - mean_x * mean
        by_y = _filtered(plain, first_y, -2) / weight - mean_y * mean
        d_x, d_y = (c_yy * by_x - c_xy * by_y) / determinant, (c_xx * by_y - c_xy * by_x) / determinant
        (p_x, u_x), (p_y, u_y) = (np.split(derivative, 2) for derivative in (d_x, d_y))
        area = np.cross(p_x, p_y, axis=0)
        change = np.cross(u_x, p_y, axis=0) + np.cross(p_x, u_y, axis=0)
        growth = (change * area).sum(axis=0) / (area * area).sum(axis=0)
    usable = (weight >= window.min_coverage) & (determinant > window.min_determinant)
    return np.where(usable, growth, np.nan)


def _moments(window_px: float) -> Moments:
    """Return Gaussian weights over an offset u, with sum 1, and their products with u and u²."""
    reach = max(1, math.ceil(_TRUNCATE * window_px))
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (offset / window_px) ** 2)
    weight /= weight.sum()
    return weight, weight * offset, weight * offset**2


def _filtered(values: Map, kernel: Map, axis: int) -> Map:
    filtered: Map = ndimage.correlate1d(values, kernel, axis=axis, mode="constant")
    return filtered


def compute_growth_rate(dataset: xr.Dataset, *, settings: ScoreSettings | None = None) -> xr.DataArray:
    """Return the relative areal growth rate computed from depth and velocity.

    At every pixel, the surface point P = Z ray and the velocity U are fitted as affine functions of the pixel's x and
    y, by least squares with Gaussian weights. From their derivatives, a surface element has the area
    abs(P_x × P_y) dx dy, and it grows at the relative rate

        g = n · (U_x × P_y + P_x × U_y) / abs(P_x × P_y),    n = (P_x × P_y) / abs(P_x × P_y),

    which is the divergence of U along the surface. U belongs to the surface point at a pixel, so that U_x dx is the
    rate of change of the material line P_x dx, independent of the motion in the image. The rate is exact for any
    window where U is an affine function of P on a plane, and for rigid motions and similar growth of any surface.

    A window uses pixels of one surface only. Surfaces are separated at depth discontinuities and, if the data set has
    ``object_id`` as truths do, at object boundaries.

    Parameters
    ----------
    dataset
        An estimate with depth and velocity, or a truth of one camera; dimensions (t, y, x). Of an estimate, only pixels
        with valid velocity are used.
    settings
        Window and segmentation: ``growth_window_px``, ``growth_min_coverage`` and ``growth_max_slope_deg``; default:
        the defaults of `ScoreSettings`.

    Returns
    -------
    xarray.DataArray
        ``growth_rate``, float64, dimensions (t, y, x), in 1/frame; NaN where the coverage of the window is too small.

    Raises
    ------
    ScoreError
        If the data set lacks depth or velocity.

    See Also
    --------
    score : Statistics of the errors of all quantities.
    estimate : The refined method estimates ``growth_rate`` directly.

    Examples
    --------
    A plane at a depth of 500 mm that expands by 0.1 % per frame along both X and Y:

    >>> from scenetruth.schema import Intrinsics, label
    >>> y, x = np.mgrid[:24, :32] - 10.0
    >>> camera = Intrinsics(focal_length_px=500.0, principal_point_px=(10.0, 10.0), baseline_mm=5.0)
    >>> velocity = np.stack([1e-3 * x, 1e-3 * y, 0 * x])[:, np.newaxis]
    >>> maps = label("estimate", {"depth": 0 * x[np.newaxis] + 500.0, "velocity": velocity}, camera, t=[0])
    >>> growth = compute_growth_rate(maps, settings=ScoreSettings(growth_window_px=3.0))
    >>> print(growth.dims, f"{float(growth.sel(t=0, y=12, x=16)):.6f}")
    ('t', 'y', 'x') 0.002000
    """
    chosen = ScoreSettings() if settings is None else settings
    if not isinstance(dataset, xr.Dataset):
        raise ScoreError([Problem("", "must be an xarray.Dataset", type(dataset).__name__)])
    if not isinstance(chosen, ScoreSettings):
        raise ScoreError([Problem("settings", "must be ScoreSettings", settings)])
    problems = [
        Problem(name, "is missing; growth is computed from depth and velocity", sorted(map(str, dataset.data_vars)))
        for name in ("depth", "velocity")
        if name not in dataset
    ]
    if problems:
        raise ScoreError(problems)
    known = _valid(dataset)
    values = _rates(dataset, known, known, chosen)
    depth = dataset["depth"]
    attrs = {"units": "1/frame", "long_name": "relative areal growth rate", "window_px": chosen.growth_window_px}
    return xr.DataArray(values, coords=depth.coords, dims=depth.dims, name="growth_rate", attrs=attrs)


@dataclass(frozen=True)
class GrowthMaps:
    """Growth rates in 1/frame, shape (t, y, x), NaN where undefined; windowed truth uses the surfaces of the truth."""

    estimate: Map
    truth: Map
    truth_windowed: Map


def compute_growth_maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> GrowthMaps | None:
    """Return the growth rates of an estimate and its truth."""
    return _maps(estimate, truth, settings) if has_growth_rate(estimate, truth) else None


def _maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> GrowthMaps:
    known, finite = _valid(estimate), _finite(truth)
    tasks = (estimate, known, known), (truth, known & finite, finite)
    found, windowed = in_order(lambda task: _rates(*task, settings), tasks, at_once=len(tasks))
    return GrowthMaps(found, truth["growth_rate"].values.astype(np.float64), windowed)


def has_growth_rate(estimate: xr.Dataset, truth: xr.Dataset) -> bool:
    """Return whether the truth has ``growth_rate`` and the estimate any pixel with valid depth and velocity."""
    if "growth_rate" not in truth or not {"depth", "velocity"} <= set(estimate):
        return False
    return bool(_valid(estimate).any())


def compute_growth_pairs(
    estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings
) -> dict[str, EstimateTruthPair]:
    """Return the pairs of the growth rate computed from depth and velocity, in %/h.

    ``growth_rate`` is compared with the truth of every pixel, ``growth_rate_windowed`` with the truth in the same
    window, which excludes the bias of the window.
    """
    maps = _maps(estimate, truth, settings)
    factor = percent_per_hour(read_intrinsics(estimate))
    found = factor * maps.estimate
    return {
        "growth_rate": EstimateTruthPair(found, factor * maps.truth),
        "growth_rate_windowed": EstimateTruthPair(found, factor * maps.truth_windowed),
    }


def _valid(dataset: xr.Dataset) -> Mask:
    """Return where depth and velocity are valid, shape (t, y, x)."""
    return _finite(dataset) & find_valid_pixels(dataset, "velocity")


def _finite(dataset: xr.Dataset) -> Mask:
    finite = np.isfinite(dataset["depth"].values) & np.isfinite(dataset["velocity"].values).all(axis=0)
    return np.asarray(finite)


def _rates(dataset: xr.Dataset, used: Mask, connected: Mask, settings: ScoreSettings) -> Map:
    """Return the growth rate of every frame from the ``used`` pixels; ``connected`` pixels join segments, (t, y, x)."""
    intrinsics, grid = read_intrinsics(dataset), compute_pixel_coordinates(dataset)
    step_y, step_x = grid.step_px
    window = settings.growth_window_px / step_y, settings.growth_window_px / step_x
    growth = np.full(used.shape, np.nan)
    for n, mask in enumerate(used):
        frame = dataset.isel(t=n)
        depth = np.where(connected[n], frame["depth"].values.astype(np.float64), np.nan)
        patches = label_depth_segments(
            depth,
            intrinsics.focal_length_px,
            settings.growth_max_slope_deg,
            objects=frame["object_id"].values if "object_id" in dataset else None,
            step_px=grid.step_px,
        )
        velocity = frame["velocity"].values.astype(np.float64)
        points = compute_surface_points(depth, intrinsics, grid)
        growth[n] = compute_windowed_growth(
            points, velocity, np.where(mask, patches, np.int32(-1)), window, settings.growth_min_coverage
        )
    return growth
