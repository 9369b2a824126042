"""The areal growth rate of a surface, from maps of its depth and velocity.

Per pixel, and from affine fits in Gaussian windows.
"""

from __future__ import annotations

import math
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
    """Give numbers to the connected pieces of a depth map.

    Two pixels side by side belong to one surface if their depths differ by no more than
    tan(``max_slope_deg``) Z / f, with Z the nearer of both: by what a surface of that slope does over one pixel. Where
    it is known which object each pixel shows, they must also show the same one.

    ``depth``: Depth in mm, shape (y, x); NaN where there is none.
    ``max_slope_deg``: The steepest slope of one surface, in degrees.
    ``objects``: The number of the object that each pixel shows, shape (y, x); of one object if not given.
    ``step_px``: The distances between neighbouring pixels of the map, along y and along x, in px.
    Returns: int32, shape (y, x): 0, 1, ... for the pieces, and -1 where there is no depth.
    """
    steepest = math.tan(math.radians(max_slope_deg)) / focal_length_px
    index = np.arange(depth.size).reshape(depth.shape)
    starts, ends = [], []
    sides = (((..., slice(-1)), (..., slice(1, None)), step_px[1]), (slice(-1), slice(1, None), step_px[0]))
    for one, other, step in sides:
        near, far = np.minimum(depth[one], depth[other]), np.maximum(depth[one], depth[other])
        # NaN compares as false, so that missing pixels touch nothing.
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
"""Reach of the window in standard deviations. The fit of affine fields is exact for any weights."""

_FLAT = 1e-6
"""Least determinant of a window's covariance, in units of sigma^4, that tells x from y."""


def compute_windowed_growth(
    points: Map, velocity: Map, patches: Labels, window_px: float | tuple[float, float], min_coverage: float = 0.5
) -> Map:
    """Return the areal growth rate of one frame; see `scenetruth.scoring.compute_growth_rate` for the formula.

    ``points``, ``velocity``: Surface points in mm and their velocities in mm per frame, shape (3, y, x).
    ``patches``: The piece of surface that each pixel belongs to, shape (y, x); windows take pixels of their centre's
      piece only, and none where it is negative.
    Returns: In 1/frame, shape (y, x); NaN off all pieces, and where the window holds too little.
    """
    growth = np.full(patches.shape, np.nan)
    sigma_y, sigma_x = window_px if isinstance(window_px, tuple) else (window_px, window_px)
    window = _Window(_moments(sigma_y), _moments(sigma_x), _FLAT * (sigma_y * sigma_x) ** 2, min_coverage)
    # A piece smaller than this fills no window.
    least = min_coverage / (window.along_y[0].max() * window.along_x[0].max())
    sizes = np.bincount(patches[patches >= 0].ravel(), minlength=1)
    for number, box in enumerate(ndimage.find_objects(patches + 1)):
        if sizes[number] < least:
            continue
        inside = patches[box] == number
        fields = np.where(inside, np.concatenate([points[:, *box], velocity[:, *box]]), 0.0)
        values = _growth_of_segment(fields, inside, window)
        growth[box][inside] = values[inside]
    return growth


@dataclass(frozen=True)
class _Window:
    """Gaussian weights along y and x (see `_moments`), and the least that a window must hold."""

    along_y: Moments
    along_x: Moments
    min_determinant: float
    min_coverage: float


def _growth_of_segment(fields: Map, inside: Mask, window: _Window) -> Map:
    """Return the growth rate of one piece, from its points and velocities (6, y, x), zero off it."""
    one_y, first_y, second_y = window.along_y
    one_x, first_x, second_x = window.along_x
    mask = inside.astype(np.float64)
    plain, along_x = _filtered(mask, one_x, -1), _filtered(mask, first_x, -1)
    weight = _filtered(plain, one_y, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_x, mean_y = _filtered(along_x, one_y, -2) / weight, _filtered(plain, first_y, -2) / weight
        # Covariance of the pixels' places in the window.
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
    """Return Gaussian weights over an offset u, of sum 1, and these times u and u²."""
    reach = max(1, math.ceil(_TRUNCATE * window_px))
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (offset / window_px) ** 2)
    weight /= weight.sum()
    return weight, weight * offset, weight * offset**2


def _filtered(values: Map, kernel: Map, axis: int) -> Map:
    filtered: Map = ndimage.correlate1d(values, kernel, axis=axis, mode="constant")
    return filtered


def compute_growth_rate(dataset: xr.Dataset, settings: ScoreSettings | None = None) -> xr.DataArray:
    """Return the relative areal growth rate that follows from a data set's depth and velocity.

    At every pixel, the surface point P = Z ray and the velocity U are fitted as affine functions of the pixel's x and
    y, by least squares with Gaussian weights. With their derivatives, an element of the surface has the area
    abs(P_x × P_y) dx dy, and it grows at the relative rate

        g = n · (U_x × P_y + P_x × U_y) / abs(P_x × P_y),    n = (P_x × P_y) / abs(P_x × P_y),

    which is the divergence of U along the surface. U belongs to the point that a pixel sees, so that U_x dx is the
    rate at which the material line P_x dx changes, however the image moves. The rate is exact, whatever the window,
    where U is an affine function of P on a plane, and for rigid motions and similar growth of any surface.

    A window takes pixels of one surface only. Neighbours are on two surfaces where depth jumps, and where the data set
    has ``object_id``, as truths do, also where it changes.

    Parameters
    ----------
    dataset
        An estimate with depth and velocity, or a truth of one camera; dimensions (t, y, x). Of an estimate, only pixels
        whose velocity is full are used.
    settings
        Of which ``growth_window_px``, ``growth_min_coverage`` and ``growth_max_slope_deg`` are used; the defaults if
        not given.

    Returns
    -------
    xarray.DataArray
        ``growth_rate``, float64, dimensions (t, y, x), in 1/frame; NaN where the window holds too little.

    Raises
    ------
    ScoreError
        If the data set lacks depth or velocity.

    See Also
    --------
    score : Scores growth with all else.
    estimate : The refined method tells growth of its own, ``growth_rate``.

    Examples
    --------
    A plane 500 mm away that expands by 0.1 % per frame along both X and Y:

    >>> from scenetruth.schema import Intrinsics, label
    >>> y, x = np.mgrid[:24, :32] - 10.0
    >>> camera = Intrinsics(focal_length_px=500.0, principal_point_px=(10.0, 10.0), baseline_mm=5.0)
    >>> velocity = np.stack([1e-3 * x, 1e-3 * y, 0 * x])[:, np.newaxis]
    >>> maps = label("estimate", {"depth": 0 * x[np.newaxis] + 500.0, "velocity": velocity}, camera, t=[0])
    >>> growth = compute_growth_rate(maps, ScoreSettings(growth_window_px=3.0))
    >>> print(growth.dims, f"{float(growth.sel(t=0, y=12, x=16)):.6f}")
    ('t', 'y', 'x') 0.002000
    """
    chosen = ScoreSettings() if settings is None else settings
    if not isinstance(dataset, xr.Dataset):
        raise ScoreError([Problem("", "must be an xarray.Dataset", type(dataset).__name__)])
    if not isinstance(chosen, ScoreSettings):
        raise ScoreError([Problem("settings", "must be ScoreSettings", settings)])
    problems = [
        Problem(name, "is missing; growth follows from depth and velocity", sorted(map(str, dataset.data_vars)))
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
    """Growth rates that are compared with each other, in 1/frame, shape (t, y, x), NaN where there is none.

    ``estimate``: What follows from the estimate's depth and velocity.
    ``truth``: The true growth rate of every pixel's own surface element.
    ``truth_windowed``: What follows from the true depth and velocity in the same way, with the same windows over the
      pixels that the estimate knows. What belongs to one surface is told by the truth itself.
    """

    estimate: Map
    truth: Map
    truth_windowed: Map


def compute_growth_maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> GrowthMaps | None:
    """Return the growth rates of an estimate and its truth."""
    return _maps(estimate, truth, settings) if has_growth_rate(estimate, truth) else None


def _maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> GrowthMaps:
    known, finite = _valid(estimate), _finite(truth)
    return GrowthMaps(
        estimate=_rates(estimate, known, known, settings),
        truth=truth["growth_rate"].values.astype(np.float64),
        truth_windowed=_rates(truth, known & finite, finite, settings),
    )


def has_growth_rate(estimate: xr.Dataset, truth: xr.Dataset) -> bool:
    """Return whether the truth has ``growth_rate``, and the estimate knows depth and velocity of any pixel."""
    if "growth_rate" not in truth or not {"depth", "velocity"} <= set(estimate):
        return False
    return bool(_valid(estimate).any())


def compute_growth_pairs(
    estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings
) -> dict[str, EstimateTruthPair]:
    """Return what is scored of the growth rate that follows from depth and velocity, in % per hour.

    ``growth_rate`` compares with the truth of every pixel, ``growth_rate_windowed`` with the truth in the same window:
    the error of the former is that of the latter plus the bias of the window. (Of an estimate with a growth rate of its
    own, `EstimateTruthPairs` takes that for the former.)
    """
    maps = _maps(estimate, truth, settings)
    factor = percent_per_hour(read_intrinsics(estimate))
    found = factor * maps.estimate
    return {
        "growth_rate": EstimateTruthPair(found, factor * maps.truth),
        "growth_rate_windowed": EstimateTruthPair(found, factor * maps.truth_windowed),
    }


def _valid(dataset: xr.Dataset) -> Mask:
    """Return where a data set knows depth and velocity, shape (t, y, x)."""
    return _finite(dataset) & find_valid_pixels(dataset, "velocity")


def _finite(dataset: xr.Dataset) -> Mask:
    finite = np.isfinite(dataset["depth"].values) & np.isfinite(dataset["velocity"].values).all(axis=0)
    return np.asarray(finite)


def _rates(dataset: xr.Dataset, used: Mask, connected: Mask, settings: ScoreSettings) -> Map:
    """Return the growth rate of every frame of a data set.

    ``used``: The pixels that windows may take, shape (t, y, x).
    ``connected``: The pixels that connect surfaces, same shape: two used pixels may be connected by others.
    """
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
