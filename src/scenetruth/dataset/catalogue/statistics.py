"""What a sample's truth tells of it in a few numbers, for the catalogue."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

__all__ = ["STATISTICS", "statistics_of"]

STATISTICS = {
    "depth_min_mm": "least depth that the reference camera sees at the reference frame",
    "depth_max_mm": "largest depth",
    "disparity_min_px": "least disparity, px per step",
    "disparity_max_px": "largest disparity, px per step",
    "flow_rms_px_per_frame": "root mean square of the flow of all that is seen, px per frame",
    "flow_max_px_per_frame": "largest flow, px per frame",
    "velocity_z_median_mm_per_frame": "median of U_Z over the objects that move, mm per frame; 0 if none does",
    "growth_median_per_hour": "median growth rate of areas over the objects that grow, 1 per hour; 0 if none does",
    "seen_share": "share of the image that shows a surface",
    "occluded_share": "share of what is seen that another camera does not see",
    "mixed_share": "share of the image whose pixels show an edge",
}
"""Columns, and what they mean; all of the reference camera at the reference frame."""
_HOUR_S = 3600.0
_STILL = 1e-9
"""Rounding makes what does not grow grow by less than this per frame, and what rests move by less in mm."""


def statistics_of(truth: xr.Dataset) -> dict[str, Any]:
    """Return a truth in a few numbers.

    Parameters
    ----------
    truth
        The truth.

    Returns
    -------
    dict
        The values of `STATISTICS`, and under ``objects`` a list with name, image_share (of all pixels), seen_by_all
        (share of its pixels that every camera sees), depth_min_mm, depth_max_mm and growth_median_per_hour of every
        object.
    """
    at = {name: 0 for name in ("t", "s", "s_y") if name in truth["depth"].dims}
    names = ("depth", "disparity", "flow", "velocity", "growth_rate", "object_id", "occluded_in_s", "mixed")
    here = truth[[name for name in names if name in truth]].sel(at).load()
    maps = {str(name): np.asarray(values) for name, values in here.items()}
    seen = maps["object_id"] >= 0
    depth, disparity = maps["depth"][seen], maps["disparity"][seen]
    speed = np.hypot(*maps["flow"])[seen]
    per_hour = _HOUR_S / float(truth.attrs["frame_interval_s"])
    moving = _of_objects_that(np.linalg.norm(maps["velocity"], axis=0), maps["object_id"])
    growing = _of_objects_that(np.abs(maps["growth_rate"]), maps["object_id"])
    found: dict[str, Any] = {
        "depth_min_mm": _least(depth),
        "depth_max_mm": _largest(depth),
        "disparity_min_px": _least(disparity),
        "disparity_max_px": _largest(disparity),
        "flow_rms_px_per_frame": float(np.sqrt(np.mean(speed**2))) if speed.size else float("nan"),
        "flow_max_px_per_frame": _largest(speed),
        "velocity_z_median_mm_per_frame": _median_of_these(maps["velocity"][2], moving, seen),
        "growth_median_per_hour": _median_of_these(maps["growth_rate"], growing, seen) * per_hour,
        "seen_share": float(seen.mean()),
        "occluded_share": float(maps["occluded_in_s"][seen].mean()) if seen.any() else 0.0,
        "mixed_share": float(maps["mixed"].mean()),
    }
    found["objects"] = [
        {
            "name": name,
            "image_share": float(own.mean()),
            "seen_by_all": float(1 - maps["occluded_in_s"][own].mean()) if own.any() else 0.0,
            "depth_min_mm": _least(maps["depth"][own]),
            "depth_max_mm": _largest(maps["depth"][own]),
            "growth_median_per_hour": _median(maps["growth_rate"][own]) * per_hour,
        }
        for number, name in enumerate(json.loads(truth.attrs["object_names"]))
        for own in [maps["object_id"] == number]
    ]
    return found


def _least(values: NDArray[Any]) -> float:
    return float(values.min()) if values.size else float("nan")


def _largest(values: NDArray[Any]) -> float:
    return float(values.max()) if values.size else float("nan")


def _median(values: NDArray[Any]) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _of_objects_that(amount: NDArray[Any], object_id: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell where objects are seen that have any of an amount: most of an image may be what stands still behind them."""
    return np.isin(object_id, np.unique(object_id[(object_id >= 0) & (amount > _STILL)]))


def _median_of_these(values: NDArray[Any], these: NDArray[np.bool_], seen: NDArray[np.bool_]) -> float:
    return 0.0 if seen.any() and not these.any() else _median(values[these])
