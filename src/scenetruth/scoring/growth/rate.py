"""The areal growth rate of a surface, from maps of its depth and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import intrinsics_of
from scenetruth.scoring.growth.patches import surface_patches
from scenetruth.scoring.growth.window import windowed_growth
from scenetruth.scoring.pixel_coordinates import coordinates_of, surface_points
from scenetruth.scoring.reading import Pair, full_pixels, percent_per_hour
from scenetruth.settings import ScoreSettings

__all__ = ["GrowthMaps", "growth_maps", "growth_pairs", "knows_growth", "surface_growth"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def surface_growth(dataset: xr.Dataset, settings: ScoreSettings | None = None) -> xr.DataArray:
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
    >>> growth = surface_growth(maps, ScoreSettings(growth_window_px=3.0))
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
    known = _known(dataset)
    values = _rates(dataset, known, known, chosen)
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
        What follows from the true depth and velocity in the same way, with the same windows over the pixels that the
        estimate knows. What belongs to one surface is told by the truth itself.
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
        None if the truth has no ``growth_rate``, or the estimate lacks depth or velocity, or knows none.
    """
    return _maps(estimate, truth, settings) if knows_growth(estimate, truth) else None


def _maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> GrowthMaps:
    known, finite = _known(estimate), _finite(truth)
    return GrowthMaps(
        estimate=_rates(estimate, known, known, settings),
        truth=truth["growth_rate"].values.astype(np.float64),
        truth_windowed=_rates(truth, known & finite, finite, settings),
    )


def knows_growth(estimate: xr.Dataset, truth: xr.Dataset) -> bool:
    """Return whether the truth has ``growth_rate``, and the estimate knows depth and velocity of any pixel."""
    if "growth_rate" not in truth or not {"depth", "velocity"} <= set(estimate):
        return False
    return bool(_known(estimate).any())


def growth_pairs(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> dict[str, Pair]:
    """Return what is scored of the growth rate that follows from depth and velocity, in % per hour.

    ``growth_rate`` compares with the truth of every pixel, ``growth_rate_windowed`` with the truth in the same window:
    the error of the former is that of the latter plus the bias of the window. (Of an estimate with a growth rate of its
    own, `Pairs` takes that for the former.)

    Parameters
    ----------
    estimate, truth, settings
        As of `growth_maps`; some frames, perhaps, of those for which `knows_growth` holds.
    """
    maps = _maps(estimate, truth, settings)
    factor = percent_per_hour(intrinsics_of(estimate))
    found = factor * maps.estimate
    return {
        "growth_rate": Pair(found, factor * maps.truth),
        "growth_rate_windowed": Pair(found, factor * maps.truth_windowed),
    }


def _known(dataset: xr.Dataset) -> Mask:
    """Return where a data set knows depth and velocity, shape (t, y, x)."""
    return _finite(dataset) & full_pixels(dataset, "velocity")


def _finite(dataset: xr.Dataset) -> Mask:
    finite = np.isfinite(dataset["depth"].values) & np.isfinite(dataset["velocity"].values).all(axis=0)
    return np.asarray(finite)


def _rates(dataset: xr.Dataset, used: Mask, connected: Mask, settings: ScoreSettings) -> Map:
    """Return the growth rate of every frame of a data set.

    Parameters
    ----------
    dataset
        With depth and velocity.
    used
        The pixels that windows may take, shape (t, y, x).
    connected
        The pixels that connect surfaces, same shape: two used pixels may be connected by others.
    settings
        Of the window.
    """
    intrinsics, grid = intrinsics_of(dataset), coordinates_of(dataset)
    step_y, step_x = grid.step_px
    window = settings.growth_window_px / step_y, settings.growth_window_px / step_x
    growth = np.full(used.shape, np.nan)
    for n, mask in enumerate(used):
        frame = dataset.isel(t=n)
        depth = np.where(connected[n], frame["depth"].values.astype(np.float64), np.nan)
        patches = surface_patches(
            depth,
            intrinsics.focal_length_px,
            settings.growth_max_slope_deg,
            objects=frame["object_id"].values if "object_id" in dataset else None,
            step_px=grid.step_px,
        )
        velocity = frame["velocity"].values.astype(np.float64)
        points = surface_points(depth, intrinsics, grid)
        growth[n] = windowed_growth(
            points, velocity, np.where(mask, patches, np.int32(-1)), window, settings.growth_min_coverage
        )
    return growth
