"""Estimates of a moving plane, and their errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import scenetruth as st
from tests.helpers.wavy_plane import MovingPlane

__all__ = ["INSIDE", "SIGMA", "errors", "estimated"]


# Where windows of sigma 4 do not reach beyond the image of any camera.
INSIDE = {"y": slice(14, -14), "x": slice(34, -34)}


SIGMA = 4


def estimated(plane: MovingPlane, recording: xr.Dataset, **settings: Any) -> xr.Dataset:
    # Planes have no outlines: what is done there would take three times as long. One test has it done.
    found = st.estimate(recording, "refined", **{"window_sigma_px": SIGMA, "discontinuity_refit": False, **settings})
    return found.sel(t=0)


def errors(found: xr.Dataset, plane: MovingPlane, name: str) -> np.ndarray:
    truth = plane.truth()[name]
    inside = found[name].copy(data=found[name].values - truth).isel(INSIDE).values
    return np.asarray(inside.reshape(-1, *inside.shape[-2:]))
