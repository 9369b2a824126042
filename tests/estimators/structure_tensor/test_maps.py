"""What can be known: the aperture problem for disparity and for motion, and where the model does not hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.schema import STATUS_INVALID, STATUS_NORMAL, STATUS_VALID
from tests.helpers.nightly import by_night

Array = NDArray[np.float64]

SIZE, PART = 192, 96
DISPARITY, FLOW = 0.3, (0.2, -0.15)
PARTS = {"stripes": (0, 0), "rows": (0, 1), "blank": (1, 0), "both": (1, 1)}


def scene(noise: float = 0.0) -> Any:
    """Return vertical stripes, horizontal stripes, a blank and a texture, one in every quarter of the image."""
    s, t = np.meshgrid(np.arange(5) - 2, np.arange(9) - 4, indexing="ij")
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float64)
    moved_x = x + DISPARITY * s[..., None, None] - FLOW[0] * t[..., None, None]
    moved_y = y - FLOW[1] * t[..., None, None]
    patterns = {
        "stripes": np.cos(2 * np.pi * moved_x / 9) + 0 * moved_y,
        "rows": np.cos(2 * np.pi * moved_y / 9) + 0 * moved_x,
        "blank": 0 * (moved_x + moved_y),
        "both": np.cos(2 * np.pi * moved_x / 9) * np.cos(2 * np.pi * moved_y / 11 + 0.4),
    }
    images = np.empty((5, 9, SIZE, SIZE))
    for name, (row, column) in PARTS.items():
        at = (..., slice(PART * row, PART * (row + 1)), slice(PART * column, PART * (column + 1)))
        images[at] = patterns[name][at]
    images = 0.5 + 0.4 * images + np.random.default_rng(1).normal(0, 1, images.shape) * noise / 2
    return st.make_recording(images, 100.0, 1.0)


def inside(name: str) -> tuple[slice, slice]:
    """Return the pixels of a part whose window and filters see nothing else."""
    row, column = PARTS[name]
    margin = 15
    return (
        slice(PART * row + margin, PART * (row + 1) - margin),
        slice(PART * column + margin, PART * (column + 1) - margin),
    )


EXPECTED = {
    # Kind of disparity, of motion, of all.
    "stripes": (STATUS_VALID, STATUS_NORMAL, STATUS_NORMAL),
    "rows": (STATUS_INVALID, STATUS_NORMAL, STATUS_INVALID),
    "blank": (STATUS_INVALID, STATUS_INVALID, STATUS_INVALID),
    "both": (STATUS_VALID, STATUS_VALID, STATUS_VALID),
}


def violated(estimate: xr.Dataset) -> NDArray[np.bool_]:
    """Return where an eigenvalue beyond those of texture in two directions is above the threshold."""
    return np.asarray(estimate["eigenvalues"].sel(rank=4).values > estimate.attrs["tau"])


@pytest.mark.parametrize(
    ("noise", "tau"), [(0.0, 0.0012), (0.02, "auto"), *by_night((0.02, 0.0012), (0.005, "auto"), (0.0, "auto"))]
)
def test_kinds_are_right_on_99_percent_of_the_pixels(noise: float, tau: float | str) -> None:
    estimate = st.estimate(scene(noise), working_point_px=0, flow_working_point_px=(0, 0), tau=tau).isel(t=0)
    right = []
    for name, kinds in EXPECTED.items():
        for variable, kind in zip(("status_disparity", "status_motion", "status"), kinds, strict=True):
            right.append((estimate[variable].values[inside(name)] == kind).mean())
    assert min(right) >= 0.99
    assert not violated(estimate)[inside("both")].any()


def test_normal_solutions() -> None:
    estimate = st.estimate(scene(), working_point_px=0, flow_working_point_px=(0, 0)).isel(t=0)
    stripes, rows = (
        {name: estimate[name].values[(..., *inside(part))] for name in estimate} for part in ("stripes", "rows")
    )
    # The filters' own accuracy at these displacements, 1e-4 of them.
    np.testing.assert_allclose(stripes["disparity"], DISPARITY, rtol=5e-4)
    np.testing.assert_allclose(stripes["flow"][0], FLOW[0], rtol=5e-4)
    np.testing.assert_allclose(stripes["flow"][1], 0, atol=1e-6)
    np.testing.assert_allclose(rows["flow"][0], 0, atol=1e-6)
    np.testing.assert_allclose(rows["flow"][1], FLOW[1], rtol=5e-4)
    assert np.isnan(rows["disparity"]).all()
    assert np.isnan(rows["velocity"]).all()


@pytest.mark.parametrize("angle_deg", [30, 45, 60])
def test_slanted_stripes_give_the_disparity_along_the_stage_and_the_flow_across_them(angle_deg: float) -> None:
    """Disparity is along x alone, so one direction of texture is enough; flow is known across the stripes."""
    normal = np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    s, t = np.meshgrid(np.arange(5) - 2, np.arange(9) - 4, indexing="ij")
    y, x = np.mgrid[:48, :48].astype(np.float64)
    moved_x = x + DISPARITY * s[..., None, None] - FLOW[0] * t[..., None, None]
    moved_y = y - FLOW[1] * t[..., None, None]
    images = 0.5 + 0.4 * np.cos(2 * np.pi / 9 * (normal[0] * moved_x + normal[1] * moved_y))
    estimate = st.estimate(
        st.make_recording(images, 100.0, 1.0), working_point_px=0, flow_working_point_px=(0, 0)
    ).isel(t=0, y=slice(15, -15), x=slice(15, -15))
    assert (estimate["status_disparity"] == STATUS_VALID).all()
    assert (estimate["status_motion"] == STATUS_NORMAL).all()
    np.testing.assert_allclose(estimate["disparity"], DISPARITY, rtol=2e-3)
    across = normal * (normal @ np.array(FLOW))
    for index in range(2):
        np.testing.assert_allclose(estimate["flow"].values[index], across[index], atol=2e-4)


def test_model_violation_at_a_motion_edge() -> None:
    """Two textures that move apart: the model holds on either side, and not in windows that see both."""
    t = (np.arange(9) - 4)[None, :, None, None]
    s = (np.arange(5) - 2)[:, None, None, None]
    y, x = np.mgrid[:64, :120].astype(np.float64)

    def texture(moved_x: Array, moved_y: Array) -> Array:
        return np.asarray(np.cos(0.7 * moved_x + 0.2 * moved_y) * np.cos(0.6 * moved_y - 0.3 * moved_x))

    left = texture(x + 0.3 * s - 0.4 * t, y - 0.3 * t)
    right = texture(x - 0.3 * s + 0.4 * t + 20, y + 0.3 * t + 11)
    images = 0.5 + 0.5 * np.where(x < 60, left, right)
    estimate = st.estimate(
        st.make_recording(images, 100.0, 1.0), working_point_px=0, flow_working_point_px=(0, 0)
    ).isel(t=0, y=slice(15, -15))
    flagged = violated(estimate)
    assert flagged[:, 55:65].mean() >= 0.95
    assert not flagged[:, 15:44].any()
    assert not flagged[:, 76:-15].any()


def test_coherence_falls_where_the_model_fails() -> None:
    images = np.random.default_rng(0).random((5, 9, 48, 48))
    noise = st.estimate(st.make_recording(images, 100.0, 1.0), working_point_px=0, tau=0.0)
    good = st.estimate(scene(), working_point_px=0, flow_working_point_px=(0, 0)).isel(t=0)
    assert float(noise["coherence"].max()) < 0.5
    assert good["coherence"].values[inside("both")].min() > 0.95
    assert (good["coherence"].values[inside("blank")] == 0).all()


@pytest.mark.parametrize(("cameras", "frames"), [(2, 9), (5, 2), (2, 2)])
def test_kinds_of_rigs_that_estimate_between_cameras_or_frames(cameras: int, frames: int) -> None:
    """Horizontal stripes show no disparity to any rig: nothing in world units is known of them."""
    t = (np.arange(frames) - (frames - 1) // 2)[None, :, None, None]
    y, x = np.mgrid[:48, :64].astype(np.float64)
    images = 0.5 + 0.4 * np.cos(2 * np.pi * (y + 0.15 * t + 0 * x) / 9) + np.zeros((cameras, 1, 1, 1))
    estimate = st.estimate(st.make_recording(images, 100.0, 1.0), working_point_px=0, flow_working_point_px=(0, 0))
    inner = estimate.isel(t=0, y=slice(16, -16), x=slice(16, -16))
    assert (inner["status_disparity"] == STATUS_INVALID).all()
    assert (inner["status_motion"] == STATUS_NORMAL).all()
    assert (inner["status"] == STATUS_INVALID).all()
