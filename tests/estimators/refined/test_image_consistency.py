"""Images that must not be used, and images of which nothing follows: no number is told that is wrong."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined import DefectFilteredFrames, ImageStack, Splines, fine_contrast
from tests.helpers.nightly import by_night, nightly
from tests.helpers.wavy_plane import MovingPlane, turning

Array = NDArray[Any]

PLANE = MovingPlane(seed=2, size=(90, 120), gradient=turning(4e-3, -3e-3, 5e-3))
TRUTH = PLANE.truth()
INSIDE = (slice(14, -14), slice(34, -34))
OTHER = MovingPlane(seed=77, size=(90, 120)).image((0.0, 0.0), 0.0)
SETTINGS: dict[str, Any] = {"window_sigma_px": 4, "surface": "plane", "motion": "rigid", "discontinuity_refit": False}


def black(image: Array) -> Array:
    return np.zeros_like(image)


def dark(image: Array) -> Array:
    return np.random.default_rng(0).normal(0.02, 0.01, image.shape)


def knocked(image: Array) -> Array:
    return np.roll(image, (9, 6), (-2, -1))


def another(image: Array) -> Array:
    return np.broadcast_to(OTHER, image.shape)


def changed(recording: xr.Dataset, change: Callable[[Array], Array], *places: Any) -> xr.Dataset:
    values = recording["image"].values.copy()
    for place in places:
        values[place] = change(values[place])
    return recording.assign(image=(recording["image"].dims, values, recording["image"].attrs))


def estimated(recording: xr.Dataset, **settings: Any) -> xr.Dataset:
    return st.estimate(recording, "refined", {**SETTINGS, **settings}).sel(t=0)


def scaled_errors(found: xr.Dataset, truth: dict[str, Array] = TRUTH) -> Array:
    """Errors over standard deviations where there is an estimate."""
    told = found["status"].values == 2
    each = [(found[name].values - truth[name]) / found[f"{name}_std"].values for name in ("depth", "velocity")]
    return (
        np.concatenate([values[..., told].reshape(-1, max(int(told.sum()), 1)) for values in each])
        if told.any()
        else np.zeros((4, 0))
    )


@pytest.fixture(scope="module")
def noisy() -> xr.Dataset:
    return PLANE.recording(5, 5, noise_std=0.01)


@pytest.mark.parametrize(
    ("change", "places"),
    [
        pytest.param(black, [(0, 0)], marks=nightly, id="black"),
        pytest.param(dark, [(1, 3)], marks=nightly, id="dark"),
        pytest.param(another, [(0, 1)], marks=nightly, id="file"),
        pytest.param(knocked, [(4, 2)], id="knocked"),
        pytest.param(black, [(2, 2)], marks=nightly, id="black0"),
        pytest.param(another, [(2, 2)], marks=nightly, id="file0"),
        pytest.param(knocked, [(2, 2)], marks=nightly, id="knocked0"),
        pytest.param(knocked, [(2, n) for n in range(5)], marks=nightly, id="camera0"),
        pytest.param(black, [(n, 2) for n in range(5)], marks=nightly, id="frame0"),
    ],
)
def test_bad_images_are_left_out_and_named(
    noisy: xr.Dataset, change: Callable[[Array], Array], places: list[tuple[int, int]]
) -> None:
    """Of the reference too: the texture is the mean of all images, and the start comes from another."""
    named = sorted((s - 2, t - 2) for s, t in places)
    with pytest.warns(st.EstimateWarning, match=rf"\(s {named[0][0]}, t {named[0][1]}\).* are excluded") as warned:
        found = estimated(changed(noisy, change, *places))
    assert len(warned) == 1
    assert json.loads(found.attrs["excluded_images"]) == [list(image) for image in named]
    assert (found["status"].values[INSIDE] == 2).all()
    np.testing.assert_allclose(found["image_count"].values[INSIDE], 25 - len(places))
    scaled = scaled_errors(found)
    assert np.sqrt(np.mean(scaled**2)) == pytest.approx(0.87, abs=0.1)
    assert np.abs(scaled).max() < 6


# NaN of single pixels by day: `tests/estimators/refined/test_pixel_defects.py`.
@pytest.mark.parametrize("how", ["mask", *by_night("NaN")])
def test_images_that_the_user_leaves_out_are_no_surprise(noisy: xr.Dataset, how: str) -> None:
    """Warnings are errors: there is none."""
    values = noisy["image"].values.copy()
    hidden = np.zeros(values.shape, dtype=np.bool_)
    hidden[4, 1], hidden[0, 3] = True, True
    if how == "NaN":
        values[hidden] = np.nan
        recording = noisy.assign(image=(noisy["image"].dims, values, noisy["image"].attrs))
    else:
        values[hidden] = np.random.default_rng(5).random(int(hidden.sum()))
        recording = st.make_recording(values, 500.0, 5.0, exclusion_mask=hidden)
        recording.attrs |= {name: value for name, value in noisy.attrs.items() if name != "scene"}
        recording = recording.assign_coords(noisy.coords)
    found = estimated(recording)
    assert (found["status"].values[INSIDE] == 2).all()
    np.testing.assert_allclose(found["image_count"].values[INSIDE], 23)
    assert np.sqrt(np.mean(scaled_errors(found) ** 2)) == pytest.approx(0.87, abs=0.1)


def test_good_images_are_all_used(noisy: xr.Dataset) -> None:
    found = estimated(noisy)
    assert json.loads(found.attrs["excluded_images"]) == []
    assert json.loads(found.attrs["frames_without_estimate"]) == {}
    assert np.sqrt(np.mean(scaled_errors(found) ** 2)) == pytest.approx(0.86, abs=0.1)


@pytest.mark.parametrize(("cameras", "frames"), [(5, 1), *by_night((1, 5))])
def test_cameras_alone_and_frames_alone_tell_it_too(cameras: int, frames: int) -> None:
    recording = changed(PLANE.recording(cameras, frames, noise_std=0.01), another, (cameras // 2, frames // 2))
    with pytest.warns(st.EstimateWarning, match=r"\(s 0, t 0\) are excluded"):
        found = estimated(recording)
    name = "depth" if cameras > 1 else "flow"
    off = np.abs(found[name].values - TRUTH[name])[(..., *INSIDE)]
    assert (found["status"].values[INSIDE] == 2).all()
    assert off.max() < (1.5 if cameras > 1 else 0.05)


def displaced(image: Array) -> Array:
    return np.roll(image, 4, -1)


@pytest.mark.parametrize(
    ("cameras", "frames", "change"),
    [
        *((3, 1, another), (1, 3, another), (2, 2, displaced)),
        *by_night((2, 1, another), (2, 2, another), (4, 1, another), (2, 3, another)),
        *by_night((2, 1, displaced), (3, 1, displaced), (1, 3, displaced), (4, 1, displaced), (2, 3, displaced)),
    ],
)
def test_few_images_do_not_tell_which_is_wrong(cameras: int, frames: int, change: Callable[[Array], Array]) -> None:
    """No image is excluded: two cameras, one image of them displaced, show another depth, and one camera motion."""
    recording = changed(PLANE.recording(cameras, frames, noise_std=0.01), change, (cameras // 2, frames // 2))
    found = estimated(recording, pose_corrections="none")
    assert json.loads(found.attrs["excluded_images"]) == []
    if change is another or cameras * frames > 3 or cameras == 3:
        assert (found["status"] == 0).mean() > 0.98


@pytest.mark.parametrize(
    ("same", "reason"),
    [
        (lambda v: v * 0 + 0.5, "all images are equal"),
        (lambda v: np.broadcast_to(v[2:3, 2:3], v.shape), "all images are equal"),
        (lambda v: np.broadcast_to(v[2:3], v.shape), "the images of all cameras are equal"),
    ],
    ids=["flat", "copies", "cameras"],
)
def test_images_that_are_equal_give_a_reason_and_no_number(
    noisy: xr.Dataset, same: Callable[[Array], Array], reason: str
) -> None:
    with pytest.warns(st.EstimateWarning, match=f"frame 0: no estimate: {reason}"):
        found = estimated(changed(noisy, same, slice(None)))
    assert json.loads(found.attrs["frames_without_estimate"])["0"].startswith(reason)
    assert (found["status"] == 0).all()
    for name in ("depth", "velocity", "disparity", "flow", "depth_std"):
        assert np.isnan(found[name]).all()


def test_one_frame_without_anything_costs_that_frame_only() -> None:
    recording = changed(PLANE.recording(3, 3, noise_std=0.01), lambda image: image * 0, (slice(None), 0))
    with pytest.warns(st.EstimateWarning, match="frame -1: no estimate"):
        found = st.estimate(recording, "refined", {**SETTINGS, "window_frames": 1, "motion": "translation"})
    assert list(json.loads(found.attrs["frames_without_estimate"])) == ["-1"]
    assert (found["status"].sel(t=-1) == 0).all()
    assert (found["status"].sel(t=0).values[INSIDE] == 2).all()


def test_cameras_that_see_the_same_but_for_noise_have_no_depth(noisy: xr.Dataset) -> None:
    """Disparity 0, give or take: no depth, for it is not clear of infinity."""
    still = PLANE.image((0.0, 0.0), 0.0) + np.random.default_rng(1).normal(0, 0.01, (5, 5, 90, 120))
    with pytest.warns(st.EstimateWarning, match="is the same for all cameras"):
        found = estimated(changed(noisy, lambda _: still, slice(None)))
    assert (found["status"] == 0).all()


# What fits by chance may not fit one of the images.
@pytest.mark.filterwarnings("ignore:images:scenetruth.errors.EstimateWarning")
@pytest.mark.parametrize(
    "velocity",
    [
        (14.0, 14.0, 0.0),
        pytest.param((20.0, 0.0, 0.0), marks=nightly),
        pytest.param((0.0, 20.0, 0.0), marks=nightly),
    ],
)
@pytest.mark.parametrize(("cameras", "seed"), [(3, 2), *by_night((5, 3))])
def test_motion_beyond_reach_is_unknown_and_not_wrong(
    velocity: tuple[float, float, float], cameras: int, seed: int
) -> None:
    """40 px per frame: 16 are looked for."""
    plane = MovingPlane(seed=seed, size=(90, 120), velocity_mm=velocity)
    found = estimated(
        plane.recording(cameras, cameras, noise_std=0.01), surface="auto", motion="growing", discontinuity_refit=True
    )
    scaled = scaled_errors(found, plane.truth())
    assert np.sum(np.abs(scaled) > 6) <= 0.005 * scaled.size


def test_one_camera_needs_more_than_one_frame_at_once() -> None:
    with pytest.raises(st.EstimateError, match="window_frames: one camera determines motion only"):
        st.estimate(PLANE.recording(1, 5), "refined", window_frames=1)


def test_noise_is_no_larger_than_what_is_fine(noisy: xr.Dataset) -> None:
    """White noise as it is; of a wave across both axes, the product of its second differences over six."""
    generator = np.random.default_rng(4)
    y, x = np.mgrid[:90, :120]
    wave = 0.1 * np.cos(0.8 * x) * np.cos(0.6 * y)
    for values, expected in (
        (generator.normal(0.5, 0.01, (1, 2, 90, 120)), 0.01),
        (np.broadcast_to(0.5 + wave, (1, 2, 90, 120)), 0.05 * (2 - 2 * np.cos(0.8)) * (2 - 2 * np.cos(0.6)) / 6),
    ):
        recording = st.make_recording(values, 1000.0, 4.0)
        splines = Splines(DefectFilteredFrames(recording), 5).frames(0, 2)
        images = ImageStack(splines, np.zeros((1, 2)), np.array([0.0, 1.0]), 1000.0, (59.5, 44.5), np.zeros((2, 4)))
        found = fine_contrast(images, 4.0)[15:-15, 15:-15]
        assert np.median(found) == pytest.approx(expected, rel=0.05)


@nightly
def test_images_that_are_nearly_all_saturated_are_invalid_and_no_failure() -> None:
    """No image is an exception: a highlight saturates three of four pixels in all of them."""
    turn = {"axis": [0, 1, 0], "angle_deg": 10}
    item = {
        "name": "plane",
        "mesh": {"kind": "plane", "size_mm": [150, 120]},
        "texture": {"kind": "noise", "wavelength_mm": [2.5, 10], "mean": 0.35},
        "material": {"refractive_index": 1.5, "roughness": 0.1},
        "pose": {"position_mm": [0, 0, 600], "rotations": [turn]},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.3, 0.1, -0.2]}],
    }
    # Parallel light that the plane reflects into the camera.
    lamp = {"kind": "directional", "direction": [np.sin(np.pi / 9), 0, np.cos(np.pi / 9)], "irradiance": 0.8}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.SceneWarning)
        recording, _ = st.simulate(
            {
                "camera": {"width": 160, "height": 120, "focal_length_px": 1200},
                "stage": {"positions": 5, "baseline_mm": 3.0},
                "frames": {"count": 5},
                "lighting": {"ambient": 0.15, "lights": [lamp]},
                "objects": [item],
                "sensor": {"noise_std": 0.005, "bit_depth": 12},
                "seed": 1,
            }
        )
    assert (recording["image"] == 4095).mean() > 0.7
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        estimate = st.estimate(recording, "refined")
    assert not estimate["valid"].any()
