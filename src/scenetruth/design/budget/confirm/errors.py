"""The errors of one estimate, pixel by pixel, and the regions over which they are gathered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.scoring.growth import growth_pairs, knows_growth
from scenetruth.scoring.quantities import QUANTITIES
from scenetruth.scoring.reading import read_pair
from scenetruth.scoring.regions import further_regions, main_regions, seen_throughout
from scenetruth.settings import ScoreSettings

__all__ = ["GROWTH", "QUANTITIES_TOLD", "ErrorMaps", "error_maps"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROWTH = "growth_rate"
"""Growth: the method's own where it gives one, else that in the windows of scores."""
QUANTITIES_TOLD = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", GROWTH)
"""The quantities of a budget, keys of `scenetruth.scoring.QUANTITIES`."""


@dataclass(frozen=True, eq=False)
class ErrorMaps:
    """What one estimate of the reference frame is off by.

    Parameters
    ----------
    errors
        Estimate minus truth by quantity, shape (y, x), NaN where nothing is told; growth in % per hour.
    truths
        The true values, alike.
    regions
        Where regions lie: ``all``, ``interior`` and objects.
    """

    errors: Mapping[str, Map]
    truths: Mapping[str, Map]
    regions: Mapping[str, Mask]

    @property
    def known(self) -> Mask:
        """Where depth, and motion if there is any, is told."""
        told = {name: np.isfinite(values) for name, values in self.errors.items()}
        # A single frame tells no motion: its maps are there, and empty.
        wanted = [name for name in ("depth", "velocity_z") if name in told and told[name].any()] or list(told)[:1]
        return np.asarray(np.all([told[name] for name in wanted], axis=0))


def error_maps(estimate: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> ErrorMaps:
    """Return the errors of an estimate at the reference frame.

    Parameters
    ----------
    estimate
        The estimate.
    truth
        The whole truth of the reference camera.
    settings
        Of scores: the margin of the interior, the window of growth.
    """
    throughout = seen_throughout(truth)
    found, exact = estimate.sel(t=[0]), truth.sel(t=[0])
    masks = main_regions(exact, settings.interior_margin_px)
    further = further_regions(exact, masks["interior"], settings, throughout=throughout)
    regions = {**masks, **{name: mask for name, mask in further.items() if name.startswith("object_")}}
    errors, truths = {}, {}
    for name in QUANTITIES_TOLD:
        variable = QUANTITIES[name].variable
        if variable not in found or variable not in exact:
            continue
        pair = read_pair(found, exact, name)
        told = pair.estimate if pair.full is None else np.where(pair.full, pair.estimate, np.nan)
        errors[name], truths[name] = told[0] - pair.truth[0], pair.truth[0]
    if GROWTH not in errors and knows_growth(found, exact):
        windowed = growth_pairs(found, exact, settings)["growth_rate_windowed"]
        errors[GROWTH], truths[GROWTH] = (windowed.estimate - windowed.truth)[0], windowed.truth[0]
    return ErrorMaps(errors, truths, {name: mask[0] for name, mask in regions.items()})
