"""What is compared of one quantity: the maps of the estimate, and those of the truth at its frames and beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import intrinsics_of
from scenetruth.scoring.alignment import align, check_alignable, select_pixels
from scenetruth.scoring.pixel_coordinates import coordinates_of
from scenetruth.scoring.reading import full_pixels
from scenetruth.scoring.slips.facts import Facts, facts_of
from scenetruth.scoring.slips.moves import Grid, Places

__all__ = ["VARIABLES", "Material", "read_materials"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

VARIABLES = ("depth", "disparity", "flow", "velocity")
"""The variables whose slips are looked for."""

_KINDS = ("kind", "kind_disparity", "kind_motion")
_NEEDED = (*VARIABLES, "mixed", "boundary_distance")

_FRAMES = 3
"""How many frames are looked at: a slip is in all of them."""

_EDGE_PX = 4.0
"""Closer to edges than this, a window mixes surfaces, and derivatives of the truth are none of the surface."""


@dataclass(frozen=True)
class Material:
    """The maps of one quantity.

    Parameters
    ----------
    quantity
        The variable.
    facts
        Of the camera and the maps.
    estimate
        Shape (component, t, y, x); NaN where the estimate does not claim to know it.
    truth
        Shape (component, frame, y, x). The first frames are those of the estimate, in their order; the others are
        beside them. NaN where there is no surface.
    grid
        How frames follow each other.
    rays
        Length of the ray of every pixel, scaled to Z = 1; shape (y, x).
    smooth
        Where the true surface has no edge near, shape (t, y, x).
    """

    quantity: str
    facts: Facts
    estimate: Map
    truth: Map
    grid: Grid
    rays: Map
    smooth: Mask

    def estimate_at(self, places: Places) -> Map:
        """Return the estimate's values, shape (component, n)."""
        return np.asarray(self.estimate[:, places.frame, places.y, places.x])

    def truth_at(self, places: Places) -> Map:
        """Return the true values, shape (component, n); NaN where there is no such frame."""
        values = np.asarray(self.truth[:, places.frame, places.y, places.x])
        values[:, places.frame < 0] = np.nan
        return values

    def drawn(self, count: int, *, inner: bool = False) -> Places:
        """Return pixels where estimate and truth are known, evenly spread; at most ``count``.

        Parameters
        ----------
        count
            How many.
        inner
            Whether to take only pixels away from edges and from the border.
        """
        frames = self.estimate.shape[1]
        known = np.asarray(np.isfinite(self.estimate).all(axis=0))
        known &= np.isfinite(self.truth[:, :frames]).all(axis=0)
        if inner:
            known &= self.smooth
            known[:, [0, -1]] = known[:, :, [0, -1]] = False
        flat = np.flatnonzero(known)
        if len(flat) > count:
            flat = flat[np.linspace(0, len(flat) - 1, count).astype(np.intp)]
        return Places(*np.unravel_index(flat, known.shape))


def read_materials(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[Material]:
    """Give what is compared, quantity by quantity, of some frames of an estimate.

    Parameters
    ----------
    estimate, truth
        As of `scenetruth.scoring.alignment.align`; they may have been opened and not loaded.

    Raises
    ------
    ScoreError
        If they cannot be compared.
    """
    check_alignable(estimate, truth)
    count = estimate.sizes["t"]
    held = [name for name in VARIABLES if name in estimate]
    if not (held and count):
        return
    chosen = np.unique(np.linspace(0, count - 1, min(count, _FRAMES)).round().astype(int))
    few = estimate[[*held, *(name for name in _KINDS if name in estimate)]].isel(t=chosen)
    facts = facts_of(few, truth)
    needed = truth[[name for name in _NEEDED if name in truth]]
    _, exact = align(few, needed)
    beside, grid = _beside(estimate, truth, chosen)
    others = needed.sel({dim: 0 for dim in ("s_y", "s") if dim in needed.dims}).sel(t=beside)
    others = select_pixels(others, few)
    smooth = exact["boundary_distance"].transpose("t", "y", "x").values > _EDGE_PX
    rays = _rays(few)
    for name in held:
        found = _maps(few[name])
        found[:, ~full_pixels(few, name)] = np.nan
        maps = np.concatenate([_maps(exact[name]), _maps(others[name])], axis=1) if beside else _maps(exact[name])
        yield Material(name, facts, found, maps, grid, rays, smooth)


def _beside(estimate: xr.Dataset, truth: xr.Dataset, chosen: NDArray[np.intp]) -> tuple[list[int], Grid]:
    """Return the frames of the truth that are needed besides the chosen ones, and how they all follow each other."""
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
    return beside, Grid(estimate.sizes["y"], estimate.sizes["x"], following, preceding, across)


def _maps(array: xr.DataArray) -> Map:
    """Return maps of the shape (component, t, y, x); NaN where they are not finite."""
    values = np.array(array.transpose(..., "t", "y", "x").values, dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    return values if values.ndim == 4 else values[np.newaxis]


def _rays(dataset: xr.Dataset) -> Map:
    camera, pixels = intrinsics_of(dataset), coordinates_of(dataset)
    c_x, c_y = camera.principal_point_px
    x, y = (pixels.x - c_x) / camera.focal_length_px, (pixels.y - c_y) / camera.focal_length_px
    return np.asarray(np.sqrt(1 + x**2 + y[:, np.newaxis] ** 2))
