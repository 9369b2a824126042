"""The areal growth rate of a surface, from maps of its depth and velocity."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scenetruth.schema import Intrinsics, intrinsics_of
from scenetruth.scoring.quantities import Pair, full_pixels
from scenetruth.settings import ScoreSettings

__all__ = [
    "GrowthMaps",
    "growth_maps",
    "growth_pairs",
    "percent_per_hour",
    "surface_growth",
    "surface_patches",
    "surface_points",
    "windowed_growth",
]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]

_TRUNCATE = 3.0
"""Reach of the window in standard deviations. The fit of affine fields is exact for any weights."""

_FLAT = 1e-6
"""Least determinant of a window's covariance, in units of sigma^4, that tells x from y."""


def surface_growth(dataset: xr.Dataset, settings: ScoreSettings | None = None) -> xr.DataArray:
    """Return the relative areal growth rate that follows from a data set's depth and velocity.

    At every pixel, the surface point P = Z ray and the velocity U are fitted as affine functions of the pixel's x and
    y, by least squares with Gaussian weights. With their derivatives, an element of the surface has the area
    abs(P_x × P_y) dx dy, and it grows at the relative rate

        g = n · (U_x × P_y + P_x × U_y) / abs(P_x × P_y),    n = (P_x × P_y) / abs(P_x × P_y),

    which is the divergence of U along the surface. U belongs to the point that a pixel sees, so that U_x dx is the
    rate at which the material line P_x dx changes, however the image moves. The rate is exact, whatever the window,
    where U is an affine function of P on a plane, and for rigid motions and similar growth of any surface.

    Parameters
    ----------
    dataset
        An estimate, or a truth of one camera; of an estimate, only pixels whose velocity is full are used.
    settings
        Of which ``growth_window_px``, ``growth_min_coverage`` and ``growth_max_slope_deg`` are used; the defaults if
        not given.

    Returns
    -------
    xarray.DataArray
        ``growth_rate``, float64, dimensions (t, y, x), in 1/frame; NaN where the window holds too little.
    """
    chosen = ScoreSettings() if settings is None else settings
    values = _by_frame(dataset, chosen)[0]
    depth = dataset["depth"]
    attrs = {"units": "1/frame", "long_name": "relative areal growth rate", "window_px": chosen.growth_window_px}
    return xr.DataArray(values, coords=depth.coords, dims=depth.dims, name="growth_rate", attrs=attrs)


@dataclass(frozen=True)
class GrowthMaps:
    """Growth rates that are compared with each other, in 1/frame, shape (t, y, x), NaN where there is none.

    Parameters
    ----------
    estimate
        What follows from the estimate's depth and velocity.
    truth
        The true growth rate of every pixel's own surface element.
    truth_windowed
        What follows from the true depth and velocity in the same way, with the same windows over the same pixels.
    """

    estimate: Map
    truth: Map
    truth_windowed: Map


def growth_maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> GrowthMaps | None:
    """Return the growth rates of an estimate and its truth.

    Parameters
    ----------
    estimate, truth
        Aligned data sets of the same frames and pixels.
    settings
        Of the window.

    Returns
    -------
    GrowthMaps or None
        None if the truth has no ``growth_rate``, or the estimate knows no velocity.
    """
    if "growth_rate" not in truth or not np.any(_known(estimate)):
        return None
    here, there = _by_frame(estimate, settings, truth)
    return GrowthMaps(here, truth["growth_rate"].values.astype(np.float64), there)


def growth_pairs(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> dict[str, Pair]:
    """Return what is scored of the growth rate, in % per hour; nothing where `growth_maps` returns None.

    ``growth_rate`` compares with the truth of every pixel, ``growth_rate_windowed`` with the truth in the same window:
    the error of the former is that of the latter plus the bias of the window.
    """
    maps = growth_maps(estimate, truth, settings)
    if maps is None:
        return {}
    factor = percent_per_hour(intrinsics_of(estimate))
    found = factor * maps.estimate
    return {
        "growth_rate": Pair(found, factor * maps.truth),
        "growth_rate_windowed": Pair(found, factor * maps.truth_windowed),
    }


def percent_per_hour(intrinsics: Intrinsics) -> float:
    """Return the factor from 1/frame to % per hour."""
    return 100.0 * 3600.0 / intrinsics.frame_interval_s


def surface_points(depth: Map, intrinsics: Intrinsics) -> Map:
    """Return the points (X, Y, Z) in mm that pixels see in the camera's frame, shape (3, y, x), from depth (y, x)."""
    c_x, c_y = intrinsics.principal_point_px
    y, x = np.indices(depth.shape, dtype=np.float64)
    scale = depth / intrinsics.focal_length_px
    return np.stack([(x - c_x) * scale, (y - c_y) * scale, depth])


def surface_patches(depth: Map, focal_length_px: float, max_slope_deg: float = 80.0) -> Labels:
    """Give numbers to the connected pieces of a depth map.

    Two pixels side by side belong to one surface if their depths differ by no more than
    tan(``max_slope_deg``) Z / f, with Z the nearer of both: by what a surface of that slope does over one pixel.

    Parameters
    ----------
    depth
        Depth in mm, shape (y, x); NaN where there is none.
    focal_length_px
        f, in pixels.
    max_slope_deg
        The steepest slope of one surface, in degrees.

    Returns
    -------
    numpy.ndarray
        int32, shape (y, x): 0, 1, ... for the pieces, and -1 where there is no depth.
    """
    steepest = math.tan(math.radians(max_slope_deg)) / focal_length_px
    index = np.arange(depth.size).reshape(depth.shape)
    starts, ends = [], []
    for one, other in (((..., slice(-1)), (..., slice(1, None))), (slice(-1), slice(1, None))):
        near, far = np.minimum(depth[one], depth[other]), np.maximum(depth[one], depth[other])
        # NaN compares as false, so that missing pixels touch nothing.
        joined = far - near <= steepest * near
        starts.append(index[one][joined])
        ends.append(index[other][joined])
    start, end = np.concatenate(starts), np.concatenate(ends)
    graph = coo_matrix((np.ones(start.size, dtype=np.int8), (start, end)), shape=(depth.size, depth.size))
    _, labels = connected_components(graph, directed=False)
    seen = np.isfinite(depth)
    numbers = np.full(depth.shape, -1, dtype=np.int32)
    numbers[seen] = np.unique(labels.reshape(depth.shape)[seen], return_inverse=True)[1].ravel()
    return numbers


def windowed_growth(points: Map, velocity: Map, patches: Labels, window_px: float, min_coverage: float = 0.5) -> Map:
    """Return the areal growth rate of one frame; see `surface_growth` for the formula.

    Parameters
    ----------
    points, velocity
        Surface points in mm and their velocities in mm per frame, shape (3, y, x).
    patches
        The piece of surface that each pixel belongs to, shape (y, x); windows take pixels of their centre's piece only,
        and none where it is negative.
    window_px
        Standard deviation of the Gaussian weights, in px; they reach three times as far.
    min_coverage
        Least share of a window's weight that must lie on its piece.

    Returns
    -------
    numpy.ndarray
        In 1/frame, shape (y, x); NaN off all pieces, and where the window holds too little.
    """
    growth = np.full(patches.shape, np.nan)
    kernels = _kernels(window_px)
    # A piece smaller than this fills no window.
    least = min_coverage / kernels[0].max() ** 2
    sizes = np.bincount(patches[patches >= 0].ravel(), minlength=1)
    for number, box in enumerate(ndimage.find_objects(patches + 1)):
        if sizes[number] < least:
            continue
        inside = patches[box] == number
        fields = np.where(inside, np.concatenate([points[:, *box], velocity[:, *box]]), 0.0)
        values = _growth_of_piece(fields, inside, kernels, window_px, min_coverage)
        growth[box][inside] = values[inside]
    return growth


def _growth_of_piece(
    fields: Map, inside: Mask, kernels: tuple[Map, Map, Map], window_px: float, min_coverage: float
) -> Map:
    """Return the growth rate of one piece, from its points and velocities (6, y, x), zero off it."""
    one, first, second = kernels
    mask = inside.astype(np.float64)
    plain, along_x = _filtered(mask, one, -1), _filtered(mask, first, -1)
    weight = _filtered(plain, one, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_x, mean_y = _filtered(along_x, one, -2) / weight, _filtered(plain, first, -2) / weight
        # Covariance of the pixels' places in the window.
        c_xx = _filtered(_filtered(mask, second, -1), one, -2) / weight - mean_x**2
        c_xy = _filtered(along_x, first, -2) / weight - mean_x * mean_y
        c_yy = _filtered(plain, second, -2) / weight - mean_y**2
        determinant = c_xx * c_yy - c_xy**2
        plain, along_x = _filtered(fields, one, -1), _filtered(fields, first, -1)
        mean = _filtered(plain, one, -2) / weight
        by_x = _filtered(along_x, one, -2) / weight - mean_x * mean
        by_y = _filtered(plain, first, -2) / weight - mean_y * mean
        d_x, d_y = (c_yy * by_x - c_xy * by_y) / determinant, (c_xx * by_y - c_xy * by_x) / determinant
        (p_x, u_x), (p_y, u_y) = (np.split(derivative, 2) for derivative in (d_x, d_y))
        area = np.cross(p_x, p_y, axis=0)
        change = np.cross(u_x, p_y, axis=0) + np.cross(p_x, u_y, axis=0)
        growth = (change * area).sum(axis=0) / (area * area).sum(axis=0)
    usable = (weight >= min_coverage) & (determinant > _FLAT * window_px**4)
    return np.where(usable, growth, np.nan)


def _kernels(window_px: float) -> tuple[Map, Map, Map]:
    """Return Gaussian weights over an offset u, of sum 1, and these times u and u²."""
    reach = max(1, math.ceil(_TRUNCATE * window_px))
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (offset / window_px) ** 2)
    weight /= weight.sum()
    return weight, weight * offset, weight * offset**2


def _filtered(values: Map, kernel: Map, axis: int) -> Map:
    filtered: Map = ndimage.correlate1d(values, kernel, axis=axis, mode="constant")
    return filtered


def _known(dataset: xr.Dataset) -> Mask:
    """Return where a data set knows depth and velocity, shape (t, y, x)."""
    finite = np.isfinite(dataset["depth"].values) & np.isfinite(dataset["velocity"].values).all(axis=0)
    return np.asarray(finite & full_pixels(dataset, "velocity"))


def _by_frame(dataset: xr.Dataset, settings: ScoreSettings, other: xr.Dataset | None = None) -> tuple[Map, Map]:
    """Return the growth rate of every frame, and that of another data set in the same windows over the same pixels."""
    intrinsics = intrinsics_of(dataset)
    known = _known(dataset)
    growth = np.full((2, *known.shape), np.nan)
    window = settings.growth_window_px, settings.growth_min_coverage
    for n, mask in enumerate(known):
        depth = np.where(mask, dataset["depth"].values[n].astype(np.float64), np.nan)
        patches = surface_patches(depth, intrinsics.focal_length_px, settings.growth_max_slope_deg)
        for m, source in enumerate((dataset,) if other is None else (dataset, other)):
            depth = source["depth"].values[n].astype(np.float64)
            velocity = source["velocity"].values[:, n].astype(np.float64)
            finite = np.isfinite(depth) & np.isfinite(velocity).all(axis=0)
            shared = np.where(finite, patches, np.int32(-1))
            growth[m, n] = windowed_growth(surface_points(depth, intrinsics), velocity, shared, *window)
    return growth[0], growth[1]
