"""Positions visited one after the other and rolling shutters: surfaces and motions as at the time of each pixel."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.warp import ImageView, place_of
from scenetruth.estimators.refined.schedule import read_schedule, remove_delay_bias
from scenetruth.indexing import centred_indices

Array = NDArray[np.float64]
SIZE, FOCAL_PX, BASELINE_MM, DEPTH_MM = (72, 96), 1000.0, 4.0, 500.0
SLOPES, VELOCITY_MM = np.array([0.3, -0.2]), np.array([0.5, -0.3, -0.4])
CAMERAS, FRAMES, INTERVAL_S = 5, 5, 20.0
SETTINGS = {"window_sigma_px": 4.0, "window_frames": FRAMES, "surface": "plane", "discontinuity_refit": False}


def hit(stage_mm: float, t: Array) -> tuple[Array, Array]:
    """Return material coordinates and depth of a moving plane at every pixel, with a time for every row, (y, 1)."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
    rays = np.stack([(x - (SIZE[1] - 1) / 2) / FOCAL_PX, (y - (SIZE[0] - 1) / 2) / FOCAL_PX, np.ones_like(x)], axis=-1)
    centre = np.array([-stage_mm, 0.0, DEPTH_MM]) + t[..., None] * VELOCITY_MM
    normal = np.array([*SLOPES, -1.0])
    depth = (centre @ normal) / (rays @ normal)
    return (depth[..., None] * rays - centre)[..., :2], depth


def row_times(line: float) -> Array:
    """Return the times of the rows after that of the image, shape (y, 1)."""
    return line * (np.arange(SIZE[0]) - (SIZE[0] - 1) / 2)[:, None]


def scanned(delay: float, line: float = 0.0, *, stated: bool = True) -> xr.Dataset:
    """Return a recording whose camera s is taken s delay frames later, and whose rows are line frames apart."""
    generator = np.random.default_rng(0)
    lengths = np.exp(generator.uniform(np.log(5.0), np.log(20.0), 40)) * DEPTH_MM / FOCAL_PX
    angles, phases = generator.uniform(0, 2 * np.pi, (2, 40))
    along = 2 * np.pi * np.stack([np.cos(angles), np.sin(angles)]) / lengths
    s, t = centred_indices(CAMERAS)[:, None], centred_indices(FRAMES)
    times = t + delay * s
    images = [
        [
            0.5 + 0.02 * np.cos(hit(BASELINE_MM * own, time + row_times(line))[0] @ along + phases).sum(-1)
            for time in row
        ]
        for own, row in zip(s[:, 0], times, strict=True)
    ]
    more = {"planned_time_s": INTERVAL_S * times, "line_time_s": INTERVAL_S * line} if stated else {}
    return st.make_recording(images, FOCAL_PX, BASELINE_MM, frame_interval_s=INTERVAL_S, **more)


def worst(recording: xr.Dataset, line: float = 0.0) -> dict[str, float]:
    """Return the largest errors in the interior, of disparity in px per step and of velocity in mm per frame."""
    inner = {"y": slice(20, -20), "x": slice(28, -28)}
    found = st.estimate(recording, "refined", SETTINGS).sel(t=0).isel(inner)
    # Each row of the reference shows the surface at its own time.
    depth = hit(0.0, row_times(line))[1][20:-20, 28:-28]
    errors = {
        "disparity": found["disparity"].values - FOCAL_PX * BASELINE_MM / depth,
        "velocity": found["velocity"].values - VELOCITY_MM[:, None, None],
    }
    return {name: float(np.abs(values).max()) for name, values in errors.items()}


@pytest.mark.parametrize("delay", [0.1, -0.2])
def test_positions_visited_one_after_the_other(delay: float) -> None:
    """The flow of 1 px per frame would be taken for a disparity."""
    found = worst(scanned(delay))
    assert found["disparity"] < 0.002
    assert found["velocity"] < 0.01
    assert worst(scanned(delay, stated=False))["disparity"] > 0.05


def test_rolling_shutter() -> None:
    """A motion of half a pixel per frame along the columns would be wrong by a percent, and taken for growth."""
    assert worst(scanned(0.0, 0.01), 0.01)["velocity"] < 0.01


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
    recording = scanned(0.1)
    part = recording.isel(s=slice(1, None), t=slice(1, None), y=slice(0, 60, 2), x=slice(0, 90, 2))
    part.attrs["line_time_s"] = 0.2
    positions = np.stack([part["stage_x_mm"].values / BASELINE_MM, np.zeros(4)], axis=-1)
    found = read_schedule(part, positions)
    assert found.times.tolist() == [-1, 0, 1, 2]
    assert found.delays is not None
    np.testing.assert_allclose(found.delays, np.broadcast_to([-0.1, 0.0, 0.1, 0.2], (4, 4)), atol=1e-12)
    assert found.shutter == pytest.approx((2 * 0.2 / INTERVAL_S, 0.0))
    even = read_schedule(recording.drop_vars("planned_time_s"), np.zeros((CAMERAS, 2)))
    assert even.delays is None


def test_initial_disparity_of_a_scan_is_corrected() -> None:
    """A camera that is taken s τ later shows d - τ (u_X - x u_Z / f)."""
    delays = np.broadcast_to(0.1 * np.arange(-2, 3), (1, 5))
    positions = np.stack([np.arange(-2.0, 3.0), np.zeros(5)], axis=-1)
    blank = [np.zeros((1, 5, 4, 6), dtype=np.float32)]
    images = ImageStack(blank, positions, np.zeros(1), 500.0, (2.5, 1.5), np.zeros((5, 4)), delays=delays)
    true_d, flow = 10.0, np.array([2.0, 0.5, 30.0])
    shown = true_d - 0.1 * (flow[0] - (np.arange(6) - 2.5) * flow[2] / 500.0)
    fields = np.empty((4, 4, 6))
    fields[0], fields[1:] = shown, flow[:, None, None] / shown
    remove_delay_bias(fields, images)
    np.testing.assert_allclose(fields[0], true_d, rtol=1e-12)
    np.testing.assert_allclose(fields[1:], np.broadcast_to(flow[:, None, None] / true_d, (3, 4, 6)), rtol=1e-12)
