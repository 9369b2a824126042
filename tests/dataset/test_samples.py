"""A truth in a few numbers: what stands still around an object does not hide what it does."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.dataset.samples import compute_truth_statistics

RATE_PER_HOUR, RISE = 0.03, -0.4


def truth(**changes: Any) -> xr.Dataset:
    """A patch of a tenth of the image that grows and rises, before a wall that rests."""
    patch = {
        "name": "patch",
        "mesh": {"kind": "plane", "size_mm": [16, 12], "resolution_mm": 4},
        "pose": {"position_mm": [0, 0, 500]},
        "texture": {"kind": "uniform"},
        "deformation": [{"kind": "growth", "rate_per_hour": RATE_PER_HOUR}],
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, RISE]}],
    }
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 70]}, "texture": {"kind": "uniform"}}
    wall["pose"] = {"position_mm": [0, 0, 520], "rotations": [{"axis": [0, 1, 0], "angle_deg": 20}]}
    plain = {
        "camera": {"width": 50, "height": 40, "focal_length_px": 500},
        "stage": {"positions": 2, "baseline_mm": 1},
        "frames": {"count": 1, "frame_interval_s": 60},
        "objects": [patch | changes, wall],
    }
    return st.make_truth(st.Scene.from_dict(plain))


def test_growth_and_motion_are_those_of_what_grows_and_moves() -> None:
    found = compute_truth_statistics(truth())
    patch, wall = found["objects"]
    assert patch["image_share"] < 0.2 < 0.5 < wall["image_share"]
    assert found["growth_median_per_hour"] == pytest.approx(RATE_PER_HOUR, rel=1e-6)
    assert found["velocity_z_median_mm_per_frame"] == pytest.approx(RISE, rel=1e-9)
    assert patch["growth_median_per_hour"] == pytest.approx(RATE_PER_HOUR, rel=1e-6)
    assert wall["growth_median_per_hour"] == pytest.approx(0, abs=1e-9)


def test_what_rests_does_neither_and_of_nothing_nothing_is_told() -> None:
    still = truth(deformation=[], motion=[])
    found = compute_truth_statistics(still)
    assert (found["growth_median_per_hour"], found["velocity_z_median_mm_per_frame"]) == (0, 0)
    unseen = still.assign(object_id=xr.full_like(still["object_id"], -1))
    told = compute_truth_statistics(unseen)
    assert math.isnan(told["growth_median_per_hour"])
    assert math.isnan(told["depth_min_mm"])
    assert told["seen_share"] == 0 < found["seen_share"]
    assert np.isfinite(found["depth_max_mm"])
