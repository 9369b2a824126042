"""Stated times and tolerances: surfaces and motions at the time of each pixel, and priors of the pose errors."""

from __future__ import annotations

import numpy as np
import pytest

import scenetruth as st
from scenetruth.estimators.refined import ImageView, derive_priors, place_of, read_schedule, remove_delay_bias
from scenetruth.schema import StageTolerances
from tests.helpers.nightly import by_night
from tests.helpers.scanned_plane import ScannedPlane

INTERVAL_S = 20.0
SETTINGS = {"window_sigma_px": 4.0, "window_frames": 5, "surface": "plane", "discontinuity_refit": False}


def worst(plane: ScannedPlane, *, stated: bool = True) -> dict[str, float]:
    """Return the largest errors in the interior, of disparity in px per step and of velocity in mm per frame."""
    given = {} if stated else {"pose_corrections": "none"}
    found = st.estimate(plane.recording(stated=stated), "refined", SETTINGS | given).sel(t=0)
    inner = (..., slice(20, -20), slice(28, -28))
    truth = plane.truth()
    return {name: float(np.abs(found[name].values - truth[name])[inner].max()) for name in ("disparity", "velocity")}


@pytest.mark.parametrize("delay", [0.1, *by_night(-0.2)])
def test_positions_visited_one_after_the_other(delay: float) -> None:
    """The flow of 1 px per frame would be taken for a disparity."""
    plane = ScannedPlane(delay=delay)
    found = worst(plane)
    assert found["disparity"] < 0.002
    assert found["velocity"] < 0.01
    assert worst(plane, stated=False)["disparity"] > 0.05


def test_rolling_shutter() -> None:
    """A motion of half a pixel per frame along the columns would be wrong by a percent, and taken for growth."""
    plane = ScannedPlane(line=0.01)
    assert worst(plane)["velocity"] < 0.001
    assert worst(plane, stated=False)["velocity"] > 0.002


def test_point_is_where_the_row_of_its_own_time_shows_it() -> None:
    """Row y' is taken (y' - y) lines later than the row y of the pixel: the implicit equation, solved by iteration."""
    line, t, d, q = 0.004, 2.0, 8.0, (0.1, 0.15, -0.05)
    view = ImageView(np.ones(1), np.zeros(1), np.full(1, t), np.zeros((1, 4)), 1000.0, 50.0, 40.0, 5, line)
    fields = np.array([d, *q])[:, None, None] * np.ones((4, 81, 101))
    x, y = 70, 60
    got_x, got_y, _ = place_of(False, view, 1.0, 0.0, t, fields, y, x)
    to_x, to_y = float(x - 50), float(y - 40)
    for _ in range(20):
        later = t + line * (to_y - (y - 40))
        scale = 1 / (1 + later * d * q[2] / 1000.0)
        to_x, to_y = (x - 50 + d * (later * q[0] - 1.0)) * scale, (y - 40 + d * later * q[1]) * scale
    assert (got_x, got_y) == pytest.approx((to_x, to_y), abs=2e-4)


def test_times_of_a_crop_are_those_of_its_images() -> None:
    plane = ScannedPlane(delay=0.1)
    recording = plane.recording()
    part = recording.isel(s=slice(1, None), t=slice(1, None), y=slice(0, 60, 2), x=slice(0, 90, 2))
    part.attrs["line_time_s"] = 0.2
    positions = np.stack([part["stage_x_mm"].values / plane.baseline_mm, np.zeros(4)], axis=-1)
    found = read_schedule(part, positions)
    assert found.times.tolist() == [-1, 0, 1, 2]
    assert found.delays is not None
    np.testing.assert_allclose(found.delays, np.broadcast_to([-0.1, 0.0, 0.1, 0.2], (4, 4)), atol=1e-12)
    assert found.shutter == pytest.approx((2 * 0.2 / INTERVAL_S, 0.0))
    even = read_schedule(recording.drop_vars("planned_time_s"), np.zeros((5, 2)))
    assert even.delays is None


def test_initial_disparity_of_a_scan_is_corrected() -> None:
    """A camera that is taken s τ later shows d - τ (u_X - x u_Z / f)."""
    delays = 0.1 * np.arange(-2.0, 3.0)
    positions = np.stack([np.arange(-2.0, 3.0), np.zeros(5)], axis=-1)
    true_d, flow = 10.0, np.array([2.0, 0.5, 30.0])
    shown = true_d - 0.1 * (flow[0] - (np.arange(6) - 2.5) * flow[2] / 500.0)
    fields = np.empty((4, 4, 6))
    fields[0], fields[1:] = shown, flow[:, None, None] / shown
    remove_delay_bias(fields, positions, delays, 500.0, 2.5)
    np.testing.assert_allclose(fields[0], true_d, rtol=1e-12)
    np.testing.assert_allclose(fields[1:], np.broadcast_to(flow[:, None, None] / true_d, (3, 4, 6)), rtol=1e-12)


def test_priors_of_a_stage() -> None:
    """1 mrad at f = 2000 px is 2 px; at f / Z = 4 px per mm, 10 µm are 0.04 px, and scale the image by 10 µm / Z."""
    found = derive_priors(StageTolerances(yaw_urad=1000, roll_urad=30, straightness_um=10, accuracy_um=5), 2000.0, 4.0)
    assert found.position == pytest.approx((np.hypot(2.0, 0.02), 0.04, 3e-5, 10 / 500e3))
    assert found.visit == (0.0, 0.0)
    visits = derive_priors(StageTolerances(pitch_urad=100, repeatability_um=3, backlash_um=8), 2000.0, 4.0)
    assert visits.position == pytest.approx((0.0, 0.2, 0.0, 0.0))
    assert visits.visit == pytest.approx((0.02, 0.0))
