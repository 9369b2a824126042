"""Every rig that the method takes: few cameras, few frames, colours, parts of images; and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import prepare
from scenetruth.pipeline.runner import write_estimate
from tests.estimators.refined.surface import MovingPlane, turning
from tests.nightly import nightly

PLANE = MovingPlane(gradient=turning(2e-3, -1e-3, 3e-3))
TRUTH = PLANE.truth()
INSIDE = (slice(14, -14), slice(34, -34))


def off(found: np.ndarray, name: str) -> float:
    return float(np.abs(found - TRUTH[name])[(..., *INSIDE)].max())


@pytest.mark.parametrize("cameras", [2, 3, 5])
def test_one_frame_gives_depth_and_slopes(cameras: int) -> None:
    found = st.estimate(PLANE.recording(cameras, 1), "refined", window_sigma_px=4, discontinuity_refit=False).isel(t=0)
    assert off(found["depth"].values, "depth") < 0.1
    assert off(found["slope"].values, "slope") < 0.03
    assert np.isnan(found["velocity"]).all()
    assert "growth_rate" not in found


@pytest.mark.parametrize("frames", [2, 3, 6])
def test_one_camera_gives_flow(frames: int) -> None:
    """Divergence is that of the flow: U_Z and slopes both show in it."""
    recording = PLANE.recording(1, frames)
    found = st.estimate(recording, "refined", window_sigma_px=4, discontinuity_refit=False).isel(t=0)
    assert found["t"] == 0
    assert off(found["flow"].values, "flow") < 3e-3
    flow = TRUTH["flow"]
    expected = 0.5 * (np.gradient(flow[0], axis=1) + np.gradient(flow[1], axis=0))
    assert np.abs(found["divergence"].values - expected)[INSIDE].max() < 2e-3
    assert np.isnan(found["depth"]).all()


def test_rows_of_cameras_are_taken_together() -> None:
    settings = {"window_sigma_px": 4, "discontinuity_refit": False}
    grid = PLANE.recording(3, 3, noise_std=0.002, rows=3)
    found, row = (st.estimate(each, "refined", settings).sel(t=0) for each in (grid, grid.sel(s_y=0)))
    # With gradients that are as large along y as along x, information goes with the sum of s² + s_y²: 12 against 2.
    less = np.median((found["disparity_std"] / row["disparity_std"]).values[INSIDE])
    assert less == pytest.approx(np.sqrt(2 / 12), rel=0.15)
    # Motion is seen three times as often, and told better from motion in depth.
    less = np.median((found["velocity_std"] / row["velocity_std"]).values[:2][(..., *INSIDE)])
    assert 0.8 * np.sqrt(1 / 3) < less < 1.1 * np.sqrt(1 / 3)
    for name in ("disparity", "velocity"):
        error = (found[name].values - TRUTH[name])[(..., *INSIDE)]
        # Some six windows that share no pixels: the largest error of 24 is below 5 standard deviations.
        assert np.abs(error / found[f"{name}_std"].values[(..., *INSIDE)]).max() < 5


@nightly
def test_error_bars_of_rows_of_cameras() -> None:
    settings = {"window_sigma_px": 4, "discontinuity_refit": False}
    clean, generator = PLANE.recording(3, 3, rows=3), np.random.default_rng(0)
    scaled: dict[str, list[float]] = {"disparity": [], "velocity": []}
    for _ in range(20):
        grid = clean.assign(image=clean["image"] + generator.normal(0, 0.002, clean["image"].shape))
        found = st.estimate(grid, "refined", settings).sel(t=0)
        for name, squares in scaled.items():
            error = (found[name].values - TRUTH[name])[(..., *INSIDE)]
            squares.append(float(np.square(error / found[f"{name}_std"].values[(..., *INSIDE)]).mean()))
    for squares in scaled.values():
        # Some six windows in each, which share no pixels, draw 120 errors: 0.065 is a standard deviation.
        assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.2)


def test_a_column_of_cameras_is_refused() -> None:
    with pytest.raises(st.EstimateError, match="cameras in one column have no disparity along x"):
        st.estimate(PLANE.recording(1, 2, rows=2), "refined", window_sigma_px=4)


@pytest.mark.parametrize(("cameras", "frames"), [(2, 2), (2, 9), (3, 3)])
def test_few_cameras_and_frames_give_everything(cameras: int, frames: int) -> None:
    found = st.estimate(PLANE.recording(cameras, frames), "refined", window_sigma_px=4, discontinuity_refit=False).sel(
        t=0
    )
    assert off(found["depth"].values, "depth") < 0.2
    assert off(found["velocity"].values, "velocity") < 0.1
    assert np.abs(found["velocity"].values - TRUTH["velocity"])[(slice(2), *INSIDE)].max() < 3e-3


def test_every_frame_or_those_with_whole_windows() -> None:
    recording = PLANE.recording(2, 4)
    whole = st.estimate(recording, "refined", window_sigma_px=4, window_frames=3, discontinuity_refit=False)
    every = st.estimate(
        recording, "refined", window_sigma_px=4, window_frames=3, discontinuity_refit=False, frames="all"
    )
    assert whole["t"].values.tolist() == recording["t"].values[1:-1].tolist()
    assert every["t"].values.tolist() == recording["t"].values.tolist()
    np.testing.assert_array_equal(every["depth"].sel(t=whole["t"]), whole["depth"])
    # The plane comes nearer by 0.4 mm per frame, and as it moves along its slopes, what a pixel sees by 0.021 mm more.
    middle = every["depth"].isel(y=slice(20, -20), x=slice(40, -40)).mean(("x", "y"))
    np.testing.assert_allclose(np.diff(middle), -0.421, atol=2e-3)


def test_colours_are_taken_together() -> None:
    """Three channels of different texture have three times the information, the same channel thrice as much."""
    grey = st.estimate(
        PLANE.recording(5, 3, noise_std=0.01), "refined", window_sigma_px=4, discontinuity_refit=False
    ).sel(t=0)
    colour = st.estimate(
        PLANE.recording(5, 3, channels=3, noise_std=0.01), "refined", window_sigma_px=4, discontinuity_refit=False
    ).sel(t=0)
    ratio = float(np.median((grey["depth_std"] / colour["depth_std"]).values[INSIDE]))
    assert ratio == pytest.approx(np.sqrt(3), rel=0.15)
    error = (colour["depth"].values - TRUTH["depth"])[INSIDE]
    assert np.sqrt(np.mean((error / colour["depth_std"].values[INSIDE]) ** 2)) == pytest.approx(1.0, abs=0.35)


def test_a_part_of_the_image_has_the_cameras_pixels() -> None:
    """A crop knows less only where windows and other images reach beyond it."""
    recording = PLANE.recording(3, 3)
    whole = st.estimate(recording, "refined", window_sigma_px=3, discontinuity_refit=False)
    part = st.estimate(
        recording.isel(x=slice(10, None), y=slice(6, None)), "refined", window_sigma_px=3, discontinuity_refit=False
    )
    assert part["x"].values[0] == 10
    inner = {"x": slice(40, 60), "y": slice(30, 50)}
    both = [
        each["depth"].sel(t=0).sel({key: slice(span.start, span.stop) for key, span in inner.items()})
        for each in (part, whole.assign_coords(x=np.arange(96), y=np.arange(72)))
    ]
    np.testing.assert_allclose(both[0], both[1], atol=2e-3)


def test_every_second_pixel_has_the_cameras_units() -> None:
    plane = MovingPlane(size=(144, 192), wavelengths_px=(12.0, 40.0), gradient=turning(2e-3, -1e-3, 3e-3))
    truth = plane.truth()
    recording = plane.recording(5, 3).isel(x=slice(0, None, 2), y=slice(0, None, 2))
    found = st.estimate(recording, "refined", window_sigma_px=4, discontinuity_refit=False).sel(t=0)
    for name in ("disparity", "flow"):
        expected = truth[name][..., ::2, ::2]
        assert np.abs(found[name].values - expected)[(..., *INSIDE)].max() < 0.01


@pytest.mark.parametrize(("cameras", "frames"), [(3, 4), (1, 3), (3, 1)])
def test_streams_from_a_folder_to_a_folder(tmp_path: Path, cameras: int, frames: int) -> None:
    """Frame by frame, with the same maps in the same types."""
    recording = PLANE.recording(cameras, frames)
    st.save_store(recording, tmp_path / "recording.zarr")
    settings: dict[str, Any] = {"window_frames": 3, "window_sigma_px": 3, "discontinuity_refit": False}
    work = prepare(st.open_store(tmp_path / "recording.zarr", "recording"), "refined", **settings)
    write_estimate(work, tmp_path / "estimate.zarr")
    streamed = st.load_store(tmp_path / "estimate.zarr", "estimate")
    kept = st.estimate(recording, "refined", **settings)
    xr.testing.assert_identical(streamed.drop_attrs(), kept.drop_attrs())
    assert streamed.attrs["iterations"] == kept.attrs["iterations"]


def test_what_cannot_be_estimated_is_refused() -> None:
    with pytest.raises(st.EstimateError, match="one image determines neither depth nor motion"):
        st.estimate(PLANE.recording(1, 1), "refined")
    plain = PLANE.recording(3, 3)
    with pytest.raises(st.EstimateError, match="window_sigma_px"):
        st.estimate(plain, "refined", window_sigma_px=0.2)
