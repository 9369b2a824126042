"""An estimate made frame by frame is the one that is made at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.schema import IncrementalDataset, blank_estimate, compute_depth_rate, put_estimate

HEIGHT, WIDTH = 6, 9


def recording(frames: int, baseline_mm: float, step_px: int) -> xr.Dataset:
    images = np.zeros((2, frames, step_px * HEIGHT, step_px * WIDTH), np.uint8)
    made = st.make_recording(images, focal_length_px=500, baseline_mm=baseline_mm)
    return made.isel(x=slice(None, None, step_px), y=slice(None, None, step_px))


def maps(frames: int, sign: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Disparity and flow with holes, of points that stay inside, leave, and go beyond all bounds."""
    random = np.random.default_rng(frames)
    disparity = sign * random.uniform(1, 20, (frames, HEIGHT, WIDTH))
    flow = random.normal(0, 3, (2, frames, HEIGHT, WIDTH))
    disparity[random.random(disparity.shape) < 0.1] = np.nan
    flow[random.random(flow.shape) < 0.1] = np.nan
    return disparity, flow


@settings(max_examples=20)
@given(some.integers(2, 5), some.sampled_from([5.0, -5.0]), some.sampled_from([1, 2]))
def test_velocity_is_derived_from_neighbours_alone(frames: int, baseline_mm: float, step_px: int) -> None:
    like = recording(frames, baseline_mm, step_px)
    disparity, flow = maps(frames, np.sign(baseline_mm))
    whole = st.make_estimate(recording=like, disparity=disparity, flow=flow)
    assert np.isfinite(whole["velocity"].sel(component="Z")).any()
    filling = IncrementalDataset(
        blank_estimate(["flow", "disparity", "depth_rate"], recording=like, t=like["t"].values)
    )
    for n, t in enumerate(like["t"].values):
        near = {step: disparity[n + step] for step in (1, 0, -1) if 0 <= n + step < frames}
        rate = compute_depth_rate(near, flow[:, n], recording=like)
        found = st.make_estimate(recording=like, disparity=disparity[n], flow=flow[:, n], depth_rate=rate, t=t)
        put_estimate(found, n, filling.put)
    same_maps(filling.dataset(), whole)


@pytest.mark.parametrize("name", ["depth", "disparity", "flow", "velocity", "velocity_std"])
def test_blanks_have_what_is_made(name: str) -> None:
    like = recording(4, 5.0, 2)
    components = {"flow": (2,), "velocity": (3,), "velocity_std": (3,)}.get(name, ())
    given_maps: dict[str, Any] = {name: np.ones((*components, 2, HEIGHT, WIDTH))}
    if name == "velocity_std":
        given_maps["depth"] = np.ones((2, HEIGHT, WIDTH))
    whole = st.make_estimate(recording=like, t=[0, 1], **given_maps)
    blank = blank_estimate(given_maps, recording=like, t=[0, 1])
    filling = IncrementalDataset(blank)
    put_estimate(whole, 0, filling.put)
    same_maps(filling.dataset(), whole)
    # Blank maps take no memory.
    assert all(item.values.strides == (0,) * item.ndim for item in blank.data_vars.values())


def same_maps(found: xr.Dataset, whole: xr.Dataset) -> None:
    """Check that two estimates are the same to the last bit; only a finished one has a hash."""
    attrs = {key: value for key, value in whole.attrs.items() if key != "estimate_hash"}
    xr.testing.assert_identical(found.drop_attrs(deep=False), whole.drop_attrs(deep=False))
    assert found.attrs == attrs
    assert {name: item.dtype for name, item in found.variables.items()} == {
        name: item.dtype for name, item in whole.variables.items()
    }
