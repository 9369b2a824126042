"""Errors of the growth that follows from depth and velocity, to the first order."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from scenetruth.design.budget.sight import Map, Sight
from scenetruth.schema import Intrinsics
from scenetruth.scoring import surface_growth

__all__ = ["growth_error"]


def growth_error(sight: Sight, errors: Mapping[str, Map], intrinsics: Intrinsics | None = None) -> Map:
    """Return the error of the growth rate in the windows of scores, per frame.

    Parameters
    ----------
    sight
        The scene.
    errors
        Errors of depth and velocity; what is missing is 0.
    intrinsics
        What the estimate is told of the camera; the truth if not given.

    Returns
    -------
    numpy.ndarray
        Shape (y, x); NaN where windows hold too little.
    """
    right = _maps(sight, {}, sight.intrinsics)
    wrong = _maps(sight, errors, intrinsics or sight.intrinsics)
    return np.asarray((surface_growth(wrong) - surface_growth(right)).values[0])


def _maps(sight: Sight, errors: Mapping[str, Map], intrinsics: Intrinsics) -> xr.Dataset:
    truth = sight.truth.expand_dims("t")
    known = sight.known & np.isfinite(sum(errors.values(), np.zeros_like(sight.depth)))
    depth = np.where(known, sight.depth + errors.get("depth", 0.0), np.nan)
    parts = [sight.velocity[k] + errors.get(f"velocity_{axis}", 0.0) for k, axis in enumerate("xyz")]
    velocity = np.where(known, np.stack(parts), np.nan)
    found = truth[["depth", "velocity"]].transpose("component", "t", "y", "x").copy()
    found["depth"] = (("t", "y", "x"), depth[None])
    found["velocity"] = (("component", "t", "y", "x"), velocity[:, None])
    # Windows keep to objects, as those of scores do.
    found["object_id"] = (("t", "y", "x"), sight.truth["object_id"].values[None])
    found.attrs = {**truth.attrs, **intrinsics.to_attrs()}
    return found
