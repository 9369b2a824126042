"""Depth, shape, motion and growth of analytic planes, and how far noise lets them be known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from tests.estimators.refined.surface import MovingPlane, turning
from tests.nightly import by_night, nightly

GROWTH = 2e-3
GRADIENTS = {
    "translation": np.zeros((3, 3)),
    "rigid": turning(4e-3, -3e-3, 5e-3),
    "growing": turning(4e-3, -3e-3, 5e-3) + GROWTH * np.eye(3),
    "affine": np.array([[3e-3, 1e-3, 0.0], [2e-3, -2e-3, 0.0], [4e-3, 1e-3, 0.0]]),
}
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


@pytest.mark.parametrize("motion", [*by_night("rigid", "affine"), *sorted({*GRADIENTS} - {"rigid", "affine"})])
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


def test_growth_is_not_taken_for_motion() -> None:
    """The same velocity with and without growth: U_Z is the same, and growth is twice the rate of length."""
    still = MovingPlane(velocity_mm=(0.0, 0.0, -0.4))
    growing = MovingPlane(velocity_mm=(0.0, 0.0, -0.4), gradient=GROWTH * np.eye(3))
    found = [estimated(plane, plane.recording()) for plane in (still, growing)]
    ahead = [each["velocity"].isel({**INSIDE, "component": 2}).values for each in found]
    assert np.abs(ahead[0] - ahead[1] + growing.truth()["velocity"][2][14:-14, 34:-34] - -0.4).max() < 3e-3
    assert np.median(found[0]["growth_rate"].isel(INSIDE)) == pytest.approx(0.0, abs=2e-5)
    assert np.median(found[1]["growth_rate"].isel(INSIDE)) == pytest.approx(2 * GROWTH, abs=2e-5)


def test_light_that_changes_is_not_taken_for_motion() -> None:
    """Every image has a gain and an offset of its own; with one model for all, depth or motion goes wrong."""
    plane = MovingPlane()
    steady = plane.recording()
    generator = np.random.default_rng(5)
    gain, offset = 1 + generator.uniform(-0.1, 0.1, (5, 9, 1, 1)), generator.uniform(-0.05, 0.05, (5, 9, 1, 1))
    flickering = steady.assign(image=steady["image"] * gain + offset)
    flickering["image"].attrs = steady["image"].attrs
    found, plain = (
        estimated(plane, flickering),
        estimated(plane, flickering, photometric_model="none", max_residual_ratio=100),
    )
    assert np.abs(errors(found, plane, "velocity")[2]).max() < 2e-3
    assert np.abs(errors(found, plane, "depth")).max() < 0.02
    assert np.nanmax(np.abs(errors(plain, plane, "velocity")[2])) > 0.02


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


@pytest.mark.parametrize("full_scale", [1.0, 4095.0])
def test_the_residual_is_in_the_values_of_the_images(full_scale: float) -> None:
    """Noise of 1 % of full scale leaves 0.01 of images up to 1, and 41 digital numbers of images of 12 bits."""
    plane = MovingPlane(size=(48, 96))
    image = plane.recording(noise_std=0.01)["image"].values * full_scale
    values = image.astype(np.float32) if full_scale == 1 else image.round().clip(0, full_scale).astype(np.uint16)
    camera: dict[str, Any] = {"focal_length_px": plane.focal_px, "baseline_mm": plane.baseline_mm}
    found = estimated(plane, st.make_recording(values, full_scale=full_scale, **camera), motion="translation")
    assert float(found["residual"].isel(INSIDE).median()) == pytest.approx(0.01 * full_scale, rel=0.05)
    assert found["residual"].attrs["long_name"].endswith("in the values of image, up to full_scale")


def test_noise_alone_shows_no_surface() -> None:
    plane = MovingPlane(size=(72, 140))
    recording = plane.recording(noise_std=0.01)
    image = recording["image"].copy()
    image[..., 70:] = 0.5 + np.random.default_rng(3).normal(0.0, 0.01, image[..., 70:].shape)
    found = estimated(plane, recording.assign(image=image))
    # Windows reach 8 px, and the texture's border moves by 16 px in the outermost cameras.
    assert (found["status"].isel(x=slice(100, None)) == 0).all()
    assert np.isnan(found["depth"].isel(x=slice(100, None))).all()
    assert (found["status"].isel(x=slice(34, 40), y=slice(14, -14)) == 2).all()
