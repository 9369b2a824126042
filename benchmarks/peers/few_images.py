"""Methods of scenetruth on the images that stereo correlation sees: two cameras, two frames.

The outermost camera on the right is matched with the reference, as by the programs of the peers. A Gaussian window of 8
px averages noise as an even one of 28 px does.
"""

from __future__ import annotations

from typing import Any

import xarray as xr

import scenetruth as st

__all__ = ["refined_of_four", "structure_tensor_of_four"]

WINDOW_SIGMA_PX = 8.0


def structure_tensor_of_four(recording: xr.Dataset, window_sigma_px: float = WINDOW_SIGMA_PX) -> dict[str, Any]:
    """Return what the structure tensor finds in four images."""
    return _found(recording, "structure_tensor", window_sigma_px=window_sigma_px)


def refined_of_four(recording: xr.Dataset, window_sigma_px: float = WINDOW_SIGMA_PX) -> dict[str, Any]:
    """Return what the refined method finds in four images."""
    return _found(recording, "refined", window_sigma_px=window_sigma_px)


def _found(recording: xr.Dataset, method: str, **settings: Any) -> dict[str, Any]:
    farthest = int(recording["s"].values.max())
    few = recording.sel(s=[0, farthest], t=[0, 1])
    places = few["stage_x_mm"].values - few["stage_x_mm"].values[0]
    few = few.assign_coords(s=[0, 1], stage_x_mm=("s", places))
    few.attrs["baseline_mm"] = float(places[1])
    # It is another recording now.
    few.attrs.pop("recording_hash", None)
    found = st.estimate(few, method, settings).sel(t=[0])
    # Disparity follows from depth: per step of the whole recording.
    names = ("depth", "velocity", "depth_std", "velocity_std", "status")
    return {"t": [0], **{name: found[name].values for name in names}}
