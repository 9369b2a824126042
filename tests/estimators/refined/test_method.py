"""Analytic planes, how far noise lets them be known, and every rig that the method takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import prepare
from scenetruth.pipeline.runner import write_estimate
from tests.helpers.estimated_plane import INSIDE, errors, estimated
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane, turning

GROWTH = 2e-3
GRADIENTS = {
    "translation": np.zeros((3, 3)),
    "rigid": turning(4e-3, -3e-3, 5e-3),
    "growing": turning(4e-3, -3e-3, 5e-3) + GROWTH * np.eye(3),
    "affine": np.array([[3e-3, 1e-3, 0.0], [2e-3, -2e-3, 0.0], [4e-3, 1e-3, 0.0]]),
}


@pytest.mark.parametrize("motion", ["growing", *by_night("translation", "rigid", "affine")])
def test_a_plane_is_found_to_the_precision_of_interpolation(motion: str) -> None:
    """Each model is exact for its own motion of a plane, up to second order of the velocity; splines err by 1e-4 px."""
    plane = MovingPlane(gradient=GRADIENTS[motion])
    found = estimated(plane, plane.recording(), motion=motion, discontinuity_refit=motion == "growing")
    assert (found["status"].isel(INSIDE) == 2).all()
    # 1e-4 px of disparity (8 px) is 6e-3 mm of depth; 1e-4 px per frame is 5e-5 mm of motion.
    assert np.abs(errors(found, plane, "disparity")).max() < 3e-4
    assert np.abs(errors(found, plane, "depth")).max() < 0.02
    assert np.abs(errors(found, plane, "velocity")[:2]).max() < 2e-4
    assert np.abs(errors(found, plane, "velocity")[2]).max() < 2e-3
    assert np.abs(errors(found, plane, "flow")).max() < 3e-4
    assert np.abs(errors(found, plane, "divergence")).max() < 5e-6
    assert np.abs(errors(found, plane, "slope")).max() < 0.01
    assert np.abs(errors(found, plane, "normal")).max() < 0.01
    if motion in ("growing", "affine"):
        assert np.abs(errors(found, plane, "growth_rate")).max() < 2e-4


@nightly
def test_an_acceleration_is_found_and_is_no_depth() -> None:
    """A motion that changes evenly is exact for the model; without, depth takes most of ½ a_Z <t²> = 0.13 mm."""
    plane = MovingPlane(gradient=GRADIENTS["growing"], acceleration_mm=(0.01, -0.015, 0.04))
    recording = plane.recording()
    found = estimated(plane, recording, acceleration=True, discontinuity_refit=True)
    assert (found["status"].isel(INSIDE) == 2).all()
    # As without acceleration; 1e-4 px at the last frame, over t²/2 = 8, is 6e-6 mm of a, and of a_Z 10 times that.
    assert np.abs(errors(found, plane, "depth")).max() < 0.02
    assert np.abs(errors(found, plane, "velocity")[:2]).max() < 2e-4
    assert np.abs(errors(found, plane, "velocity")[2]).max() < 2e-3
    assert np.abs(errors(found, plane, "acceleration")[:2]).max() < 1e-4
    assert np.abs(errors(found, plane, "acceleration")[2]).max() < 1e-3
    assert np.abs(errors(found, plane, "growth_rate")).max() < 2e-4
    steady = estimated(plane, recording, max_residual_ratio=100, acceleration=False)
    assert 0.07 < np.median(errors(steady, plane, "depth")) < 0.14


def test_two_frames_do_not_tell_an_acceleration() -> None:
    plane = MovingPlane()
    with pytest.raises(st.EstimateError, match=r"acceleration: requires a window of at least 3 frames"):
        estimated(plane, plane.recording(cameras=2, frames=2), acceleration=True)


@nightly
def test_cubic_splines_do_as_well_in_noise() -> None:
    """They err by some 1e-3 px between pixels, and leave another share of the noise, which error bars know."""
    plane = MovingPlane(size=(96, 128))
    noisy, clean = plane.recording(noise_std=0.01), plane.recording()
    found = {spline: estimated(plane, noisy, surface="plane", spline=spline) for spline in ("cubic", "quintic")}
    ratio = (found["cubic"]["depth_std"] / found["quintic"]["depth_std"]).isel(INSIDE)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)
    scaled = errors(found["cubic"], plane, "depth") / found["cubic"]["depth_std"].isel(INSIDE).values
    other = errors(found["quintic"], plane, "depth") / found["quintic"]["depth_std"].isel(INSIDE).values
    assert np.sqrt(np.mean((scaled - other) ** 2)) < 0.2
    worse, better = (
        np.sqrt(np.mean(errors(estimated(plane, clean, surface="plane", spline=spline), plane, "disparity") ** 2))
        for spline in ("cubic", "quintic")
    )
    assert 2 * better < worse < 1e-3


@nightly
def test_growth_is_not_taken_for_motion() -> None:
    """The same velocity with and without growth: U_Z is the same, and growth is twice the rate of length."""
    still = MovingPlane(velocity_mm=(0.0, 0.0, -0.4))
    growing = MovingPlane(velocity_mm=(0.0, 0.0, -0.4), gradient=GROWTH * np.eye(3))
    found = [estimated(plane, plane.recording()) for plane in (still, growing)]
    ahead = [each["velocity"].isel({**INSIDE, "component": 2}).values for each in found]
    assert np.abs(ahead[0] - ahead[1] + growing.truth()["velocity"][2][14:-14, 34:-34] - -0.4).max() < 3e-3
    assert np.median(found[0]["growth_rate"].isel(INSIDE)) == pytest.approx(0.0, abs=2e-5)
    assert np.median(found[1]["growth_rate"].isel(INSIDE)) == pytest.approx(2 * GROWTH, abs=2e-5)


@nightly
def test_light_that_changes_is_not_taken_for_motion() -> None:
    """Every image has a gain and an offset of its own; with one model for all, motion goes wrong or is invalid."""
    plane = MovingPlane()
    steady = plane.recording()
    generator = np.random.default_rng(5)
    gain, offset = 1 + generator.uniform(-0.1, 0.1, (5, 9, 1, 1)), generator.uniform(-0.05, 0.05, (5, 9, 1, 1))
    flickering = steady.assign(image=steady["image"] * gain + offset)
    flickering["image"].attrs = steady["image"].attrs
    found, plain = (
        estimated(plane, flickering),
        estimated(plane, flickering, photometric_model="none", max_residual_ratio=100, pose_corrections="none"),
    )
    assert np.abs(errors(found, plane, "velocity")[2]).max() < 2e-3
    assert np.abs(errors(found, plane, "depth")).max() < 0.02
    wrong = np.abs(errors(plain, plane, "velocity")[2]) > 0.02
    assert not plain["valid"].values.any() or wrong.any()


@nightly
@pytest.mark.parametrize(("motion", "accelerated"), [("growing", False), ("rigid", False), ("growing", True)])
def test_error_bars_are_those_of_the_errors(motion: str, accelerated: bool) -> None:
    """White noise: errors over stated standard deviations have a mean square of 1.

    The image holds some 20 windows that share no noise, and five quantities: the root of the mean square of 100
    independent numbers scatters by 7 %, and two seeds leave 5 %.
    """
    ratios = []
    for seed in (1, 2):
        plane = MovingPlane(gradient=GRADIENTS[motion], seed=seed, size=(96, 128))
        noisy, model = plane.recording(noise_std=0.01, seed=seed), {"motion": motion, "acceleration": accelerated}
        found = estimated(plane, noisy, surface="plane", **model)
        scaled = [errors(found, plane, "depth") / found["depth_std"].isel(INSIDE).values]
        scaled.append(errors(found, plane, "velocity") / found["velocity_std"].isel(INSIDE).values)
        if motion == "growing":
            scaled.append(errors(found, plane, "growth_rate") / found["growth_rate_std"].isel(INSIDE).values)
        if accelerated:
            scaled.append(errors(found, plane, "acceleration") / found["acceleration_std"].isel(INSIDE).values)
        ratios.append(np.concatenate(scaled))
        # Splines smooth the noise by a share that varies by a few per cent with the places between pixels.
        assert np.median(found["residual"].isel(INSIDE)) == pytest.approx(0.01, rel=0.05)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.abs(ratios) < 2) == pytest.approx(0.954, abs=0.03)


@pytest.mark.parametrize("full_scale", [4095.0, *by_night(1.0)])
def test_the_residual_is_in_the_values_of_the_images(full_scale: float) -> None:
    """Noise of 1 % of full scale leaves 0.01 of images up to 1, and 41 digital numbers of images of 12 bits."""
    plane = MovingPlane(size=(48, 96))
    image = plane.recording(noise_std=0.01)["image"].values * full_scale
    values = image.astype(np.float32) if full_scale == 1 else image.round().clip(0, full_scale).astype(np.uint16)
    camera: dict[str, Any] = {"focal_length_px": plane.focal_px, "baseline_mm": plane.baseline_mm}
    found = estimated(plane, st.make_recording(values, full_scale=full_scale, **camera), motion="translation")
    assert float(found["residual"].isel(INSIDE).median()) == pytest.approx(0.01 * full_scale, rel=0.05)
    assert found["residual"].attrs["long_name"].endswith("in the values of image, up to full_scale")


@nightly
def test_noise_alone_shows_no_surface() -> None:
    plane = MovingPlane(size=(72, 140))
    recording = plane.recording(noise_std=0.01)
    image = recording["image"].copy()
    image[..., 70:] = 0.5 + np.random.default_rng(3).normal(0.0, 0.01, image[..., 70:].shape)
    found = estimated(plane, recording.assign(image=image), fallback="none")
    # Windows reach 8 px, and the texture's border moves by 16 px in the outermost cameras.
    assert (found["status"].isel(x=slice(100, None)) == 0).all()
    assert np.isnan(found["depth"].isel(x=slice(100, None))).all()
    assert (found["status"].isel(x=slice(34, 40), y=slice(14, -14)) == 2).all()


PLANE = MovingPlane(gradient=turning(2e-3, -1e-3, 3e-3))
TRUTH = PLANE.truth()
INNER_PIXELS = (slice(14, -14), slice(34, -34))


def off(found: np.ndarray, name: str) -> float:
    return float(np.abs(found - TRUTH[name])[(..., *INNER_PIXELS)].max())


@pytest.mark.parametrize("cameras", [2, *by_night(3, 5)])
def test_one_frame_gives_depth_and_slopes(cameras: int) -> None:
    found = st.estimate(PLANE.recording(cameras, 1), "refined", window_sigma_px=4, discontinuity_refit=False).isel(t=0)
    assert off(found["depth"].values, "depth") < 0.1
    assert off(found["slope"].values, "slope") < 0.03
    assert np.isnan(found["velocity"]).all()
    assert "growth_rate" not in found


@pytest.mark.parametrize("frames", [2, *by_night(3, 6)])
def test_one_camera_gives_flow(frames: int) -> None:
    """Divergence is that of the flow: U_Z and slopes both show in it."""
    recording = PLANE.recording(1, frames)
    found = st.estimate(recording, "refined", window_sigma_px=4, discontinuity_refit=False).isel(t=0)
    assert found["t"] == 0
    assert off(found["flow"].values, "flow") < 3e-3
    flow = TRUTH["flow"]
    expected = 0.5 * (np.gradient(flow[0], axis=1) + np.gradient(flow[1], axis=0))
    assert np.abs(found["divergence"].values - expected)[INNER_PIXELS].max() < 2e-3
    assert np.isnan(found["depth"]).all()


def test_rows_of_cameras_are_taken_together() -> None:
    settings = {"window_sigma_px": 4, "discontinuity_refit": False}
    grid = PLANE.recording(3, 3, noise_std=0.002, rows=3)
    found, row = (st.estimate(each, "refined", settings).sel(t=0) for each in (grid, grid.sel(s_y=0)))
    # With gradients that are as large along y as along x, information goes with the sum of s² + s_y²: 12 against 2.
    less = np.median((found["disparity_std"] / row["disparity_std"]).values[INNER_PIXELS])
    assert less == pytest.approx(np.sqrt(2 / 12), rel=0.15)
    # Motion is seen three times as often, and told better from motion in depth.
    less = np.median((found["velocity_std"] / row["velocity_std"]).values[:2][(..., *INNER_PIXELS)])
    assert 0.8 * np.sqrt(1 / 3) < less < 1.1 * np.sqrt(1 / 3)
    for name in ("disparity", "velocity"):
        error = (found[name].values - TRUTH[name])[(..., *INNER_PIXELS)]
        # Some six windows that share no pixels: the largest error of 24 is below 5 standard deviations.
        assert np.abs(error / found[f"{name}_std"].values[(..., *INNER_PIXELS)]).max() < 5


@nightly
def test_error_bars_of_rows_of_cameras() -> None:
    settings = {"window_sigma_px": 4, "discontinuity_refit": False}
    clean, generator = PLANE.recording(3, 3, rows=3), np.random.default_rng(0)
    scaled: dict[str, list[float]] = {"disparity": [], "velocity": []}
    for _ in range(20):
        grid = clean.assign(image=clean["image"] + generator.normal(0, 0.002, clean["image"].shape))
        found = st.estimate(grid, "refined", settings).sel(t=0)
        for name, squares in scaled.items():
            error = (found[name].values - TRUTH[name])[(..., *INNER_PIXELS)]
            squares.append(float(np.square(error / found[f"{name}_std"].values[(..., *INNER_PIXELS)]).mean()))
    for squares in scaled.values():
        # Some six windows in each, which share no pixels, draw 120 errors: 0.065 is a standard deviation.
        assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.2)


def test_a_column_of_cameras_is_refused() -> None:
    with pytest.raises(st.EstimateError, match="cameras in one column have no disparity along x"):
        st.estimate(PLANE.recording(1, 2, rows=2), "refined", window_sigma_px=4)


@pytest.mark.parametrize(("cameras", "frames"), [(2, 2), *by_night((2, 9), (3, 3))])
def test_few_cameras_and_frames_give_everything(cameras: int, frames: int) -> None:
    found = st.estimate(PLANE.recording(cameras, frames), "refined", window_sigma_px=4, discontinuity_refit=False).sel(
        t=0
    )
    assert off(found["depth"].values, "depth") < 0.2
    assert off(found["velocity"].values, "velocity") < 0.1
    assert np.abs(found["velocity"].values - TRUTH["velocity"])[(slice(2), *INNER_PIXELS)].max() < 3e-3


@nightly
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


@nightly
def test_colours_are_taken_together() -> None:
    """Three channels of different texture have three times the information, the same channel thrice as much."""
    grey = st.estimate(
        PLANE.recording(5, 3, noise_std=0.01), "refined", window_sigma_px=4, discontinuity_refit=False
    ).sel(t=0)
    colour = st.estimate(
        PLANE.recording(5, 3, channels=3, noise_std=0.01), "refined", window_sigma_px=4, discontinuity_refit=False
    ).sel(t=0)
    ratio = float(np.median((grey["depth_std"] / colour["depth_std"]).values[INNER_PIXELS]))
    assert ratio == pytest.approx(np.sqrt(3), rel=0.15)
    error = (colour["depth"].values - TRUTH["depth"])[INNER_PIXELS]
    assert np.sqrt(np.mean((error / colour["depth_std"].values[INNER_PIXELS]) ** 2)) == pytest.approx(1.0, abs=0.35)


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


@nightly
def test_every_second_pixel_has_the_cameras_units() -> None:
    plane = MovingPlane(size=(144, 192), wavelengths_px=(12.0, 40.0), gradient=turning(2e-3, -1e-3, 3e-3))
    truth = plane.truth()
    recording = plane.recording(5, 3).isel(x=slice(0, None, 2), y=slice(0, None, 2))
    found = st.estimate(recording, "refined", window_sigma_px=4, discontinuity_refit=False).sel(t=0)
    for name in ("disparity", "flow"):
        expected = truth[name][..., ::2, ::2]
        assert np.abs(found[name].values - expected)[(..., *INNER_PIXELS)].max() < 0.01


@nightly
@pytest.mark.parametrize(("cameras", "frames"), [(3, 4), (1, 3), (3, 1)])
def test_streams_from_a_folder_to_a_folder(tmp_path: Path, cameras: int, frames: int) -> None:
    """Frame by frame, with the same maps in the same types."""
    recording = PLANE.recording(cameras, frames)
    st.save_store(recording, tmp_path / "recording.zarr")
    settings: dict[str, Any] = {"window_frames": 3, "window_sigma_px": 3, "discontinuity_refit": False}
    work = prepare(st.open_store(tmp_path / "recording.zarr", kind="recording"), "refined", **settings)
    write_estimate(work, tmp_path / "estimate.zarr")
    streamed = st.load_store(tmp_path / "estimate.zarr", kind="estimate")
    kept = st.estimate(recording, "refined", **settings)
    xr.testing.assert_identical(streamed.drop_attrs(), kept.drop_attrs())
    assert streamed.attrs["iterations"] == kept.attrs["iterations"]


def test_what_cannot_be_estimated_is_refused() -> None:
    with pytest.raises(st.EstimateError, match="one image determines neither depth nor motion"):
        st.estimate(PLANE.recording(1, 1), "refined")
    plain = PLANE.recording(3, 3)
    with pytest.raises(st.EstimateError, match="window_sigma_px"):
        st.estimate(plain, "refined", window_sigma_px=0.2)
