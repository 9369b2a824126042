"""Dark frames, flat fields and lens distortion, against sensors and formulas that are exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import scenetruth
from scenetruth.camera import Camera, Distortion
from scenetruth.capture import PatternMatch, frame_moments
from scenetruth.errors import ArgumentError

SHAPE = (24, 32)
Floats = NDArray[np.float64]


def recorded(images: NDArray[Any], **more: Any) -> xr.Dataset:
    return scenetruth.make_recording(images, focal_length_px=100, baseline_mm=5, **more)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([8, 12, 16]))
def test_fixed_patterns_vanish(seed: int, bits: int) -> None:
    """Without noise, images are offset + sensitivity x light; corrected, they are light times the mean sensitivity."""
    draw = np.random.default_rng(seed)
    full = 2**bits - 1
    offset = draw.uniform(0.01, 0.05, SHAPE) * full
    sensitivity = draw.uniform(0.5, 1.5, SHAPE)
    light = draw.uniform(0.05, 0.5, (2, 3, *SHAPE)) * full
    images = (offset + sensitivity * light).astype(np.float32)
    found = scenetruth.correct_images(
        recorded(images, full_scale=full), dark=offset, flat=offset + sensitivity * 0.4 * full
    )
    # Images are float32, which leaves 1e-7 of full scale, over a sensitivity of 0.5 and more.
    assert np.allclose(found.image, light * sensitivity.mean(), rtol=0, atol=1e-6 * full)
    assert found.attrs["full_scale"] == pytest.approx(full - offset.mean())
    assert found.image.dtype == np.float32


def test_stacks_and_black_level_are_equivalent_to_means() -> None:
    draw = np.random.default_rng(1)
    recording = recorded(draw.integers(20, 200, (2, 1, *SHAPE)).astype(np.uint8))
    dark, flat = draw.integers(5, 15, (7, *SHAPE)), draw.integers(100, 200, (7, *SHAPE))
    one = scenetruth.correct_images(recording, dark=dark, flat=flat)
    other = scenetruth.correct_images(recording, dark=dark.mean(axis=0), flat=flat.mean(axis=0))
    assert one.equals(other)
    level = scenetruth.correct_images(recording, black_level_dn=10)
    assert np.array_equal(level.image, recording.image.astype(np.float32) - 10)


def test_colours_are_corrected_one_by_one() -> None:
    draw = np.random.default_rng(2)
    images = draw.integers(20, 200, (2, 1, *SHAPE, 3)).astype(np.uint8)
    dark, flat = draw.uniform(5, 15, (*SHAPE, 3)), draw.uniform(100, 200, (*SHAPE, 3))
    whole = scenetruth.correct_images(recorded(images), dark=dark, flat=flat)
    for channel in range(3):
        single = scenetruth.correct_images(
            recorded(images[..., channel]), dark=dark[..., channel], flat=flat[..., channel]
        )
        assert np.array_equal(whole.image[..., channel], single.image)


def test_saturated_defective_and_dead_pixels_are_invalid() -> None:
    images = np.full((2, 2, *SHAPE), 100, dtype=np.uint8)
    images[0, 1, 3, 4] = 255
    dark, flat = np.full(SHAPE, 10.0), np.full(SHAPE, 180.0)
    flat[5, 6] = 10.0  # does not respond
    defects = np.zeros(SHAPE, dtype=bool)
    defects[7, 8] = True
    found = scenetruth.correct_images(recorded(images), dark=dark, flat=flat, defects=defects).image
    invalid = np.isnan(found)
    assert invalid.sum() == 1 + 4 + 4
    assert invalid[0, 1, 3, 4]
    assert invalid[:, :, 5, 6].all()
    assert invalid[:, :, 7, 8].all()


@pytest.mark.parametrize(
    ("arguments", "paths"),
    [
        ({}, ["dark"]),
        ({"dark": np.zeros((3, 4)), "flat": np.zeros((9,))}, ["dark", "flat"]),
        ({"dark": np.zeros(SHAPE), "black_level_dn": 3}, ["black_level_dn"]),
        ({"black_level_dn": 300}, ["black_level_dn", "dark"]),
        ({"dark": np.full(SHAPE, 100.0), "flat": np.full(SHAPE, 50.0)}, ["flat"]),
        ({"dark": np.zeros(SHAPE), "flat": np.full(SHAPE, 255.0)}, ["flat"]),
        ({"dark": np.full(SHAPE, np.nan)}, ["dark"]),
        ({"dark": np.zeros(SHAPE), "defects": np.zeros(SHAPE)}, ["defects"]),
        ({"dark": [["a"]]}, ["dark"]),
    ],
)
def test_invalid_frames_are_rejected_together(arguments: dict[str, Any], paths: list[str]) -> None:
    with pytest.raises(ArgumentError) as caught:
        scenetruth.correct_images(recorded(np.zeros((2, 1, *SHAPE), dtype=np.uint8)), **arguments)
    assert [problem.path for problem in caught.value.problems] == paths


LENSES = (
    {"k1": -0.3, "k2": 0.1, "p1": 1e-3, "p2": -2e-3},
    {"k1": 0.2, "k3": -0.05},
    {"k1": 0.4, "k4": 0.5, "k5": 0.02, "k6": 0.01},
)


def smooth(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Waves of 12 px and more, which a quintic spline reproduces to 1e-4."""
    return np.asarray(0.5 + 0.2 * np.sin(2 * np.pi * (x / 15 + y / 20)) + 0.1 * np.cos(2 * np.pi * y / 12))


def distorted_image(lens: Distortion, height: int = 60, width: int = 80) -> tuple[Camera, NDArray[np.float32]]:
    """Return the image of a lens whose undistorted image is `smooth`, by the inverse of the distortion."""
    camera = Camera(width=width, height=height, focal_length_px=90, principal_point_px=(41.0, 28.5), distortion=lens)
    rays = camera.ray_directions(camera.pixel_grid())[..., :2] * 90 + np.array([41.0, 28.5])
    return camera, smooth(rays[..., 0], rays[..., 1]).astype(np.float32)


@pytest.mark.parametrize("fields", LENSES)
@pytest.mark.parametrize("order", [3, 5])
def test_undistorted_images_are_those_of_a_pinhole(fields: dict[str, float], order: int) -> None:
    lens = Distortion(**fields)
    camera, image = distorted_image(lens)
    recording = scenetruth.make_recording(
        image[None, None], 90, 5, principal_point_px=(41.0, 28.5), distortion=list(lens.coefficients)
    )
    found = scenetruth.undistort_images(recording, order=order).image[0, 0].values
    y, x = np.mgrid[:60, :80].astype(float)
    # The slope jumps at the mirrored border, which a quintic spline carries inwards by 0.43 a pixel, a cubic by 0.27.
    source = camera.project(np.stack([(x - 41.0) / 90, (y - 28.5) / 90, np.ones_like(x)], axis=-1))
    inside = np.isfinite(found) & (np.abs(source - [39.5, 29.5]) < [27, 17]).all(axis=-1)
    assert inside.mean() > 0.25
    error = np.abs(found - smooth(x, y))[inside].max()
    # Interpolation of a wave of 12 px: (pi / 12)^4 / 6 = 8e-4 cubic, (pi / 12)^6 / 4 = 8e-5 quintic, times 0.3.
    assert error < (5e-4 if order == 3 else 5e-5)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_share_of_the_noise_is_that_of_undistorted_noise(order: int) -> None:
    noise = np.random.default_rng(order).normal(0.5, 0.01, (10, 20, 36, 48)).astype(np.float32)
    recording = scenetruth.make_recording(noise, 400, 5, distortion=[-10.0, 0, 0, 0], full_scale=1.0)
    found = scenetruth.undistort_images(recording, order=order)
    assert found["noise_share"].dims == ("y", "x")
    inside = (slice(8, -8), slice(8, -8))
    share = found["noise_share"].values[inside]
    measured = found["image"].values.var(axis=(0, 1))[inside] / 1e-4
    # 200 images: 10 % for each of 640 pixels.
    assert np.sqrt(np.mean((measured / share - 1) ** 2)) == pytest.approx(np.sqrt(2 / 200), rel=0.15)
    assert share.mean() < (0.9 if order == 1 else 0.985)
    again = scenetruth.undistort_images(found, [5.0, 0, 0, 0], order=order)
    assert (again["noise_share"].values[inside] < share).mean() > 0.95
    colours = scenetruth.make_recording(np.zeros((2, 1, 8, 9, 3)), 400, 5, distortion=[-0.3, 0, 0, 0], full_scale=1.0)
    assert scenetruth.undistort_images(colours)["noise_share"].shape == (8, 9)


def test_coefficients_of_the_recording_and_given_are_the_same_and_disappear() -> None:
    lens = Distortion(**LENSES[0])
    _, image = distorted_image(lens)
    stated = scenetruth.make_recording(
        image[None, None], 90, 5, principal_point_px=(41.0, 28.5), distortion=list(lens.coefficients),
        lens_tolerances={"distortion_std": [0.01] * 8, "focal_length_std_px": 2.0},
    )  # fmt: skip
    silent = scenetruth.make_recording(image[None, None], 90, 5, principal_point_px=(41.0, 28.5))
    one = scenetruth.undistort_images(stated)
    assert one.image.equals(scenetruth.undistort_images(silent, lens.coefficients).image)
    assert set(one.attrs) == set(stated.attrs) - {"distortion", "distortion_std"}


def test_part_of_a_recording_is_undistorted_like_the_whole() -> None:
    lens = Distortion(**LENSES[0])
    _, image = distorted_image(lens)
    whole = scenetruth.make_recording(
        image[None, None], 90, 5, principal_point_px=(41.0, 28.5), distortion=list(lens.coefficients)
    )
    part = whole.isel(y=slice(6, 58), x=slice(4, 76))
    one, other = (scenetruth.undistort_images(each).image for each in (whole, part))
    same = other.isel(y=slice(12, -12), x=slice(12, -12))
    # The splines of the two differ by the poles of their ends, 0.43 to the power of the distance.
    assert float(np.abs(one.sel(y=same.y, x=same.x) - same).max()) < 1e-3
    assert np.isfinite(same).all()


def test_invalid_pixels_stay_invalid_and_change_no_other() -> None:
    lens = Distortion(k1=-0.3)
    _, image = distorted_image(lens)
    options: dict[str, Any] = {"principal_point_px": (41.0, 28.5), "distortion": [-0.3, 0, 0, 0]}
    good = scenetruth.undistort_images(scenetruth.make_recording(image[None, None], 90, 5, **options)).image
    holed = image.copy()
    holed[30, 40] = np.nan
    bad = scenetruth.undistort_images(scenetruth.make_recording(holed[None, None], 90, 5, **options)).image
    lost = np.isnan(bad) & np.isfinite(good)
    assert 25 <= int(lost.sum()) <= 81
    assert bool(lost[0, 0, 29:32, 39:42].all())
    # A hole is filled by its neighbours, off by 0.1 at most; the cardinal spline is below 0.02 at a distance of 4 px.
    assert float(np.nanmax(np.abs(bad - good))) < 2e-3
    missing = scenetruth.make_recording(np.full((1, 1, 60, 80), np.nan, dtype=np.float32), 90, 5, **options)
    assert np.isnan(scenetruth.undistort_images(missing).image).all()


def test_saturated_pixels_and_masks_are_resampled_with_the_images() -> None:
    images = np.full((1, 1, 60, 80), 100, dtype=np.uint8)
    images[0, 0, 30, 40] = 255
    mask = np.zeros((60, 80), dtype=bool)
    mask[20, 50] = True
    recording = scenetruth.make_recording(images, 90, 5, distortion=[-0.2, 0, 0, 0], exclusion_mask=mask)
    found = scenetruth.undistort_images(recording)
    assert np.isnan(found.image[0, 0, 30, 40])
    assert found.exclusion_mask.dims == ("y", "x")
    assert found.exclusion_mask.values[20, 50] or found.exclusion_mask.values[19:22, 48:53].any()
    assert not found.exclusion_mask.values[28:33, 30:40].any()
    inside = np.isfinite(found.image)
    assert np.allclose(found.image.values[inside], 100, atol=1e-3)


def test_undistorted_images_of_a_simulation_do_not_pass_for_its_own() -> None:
    lens = Distortion(k1=-0.2)
    _, image = distorted_image(lens)
    recording = scenetruth.make_recording(image[None, None], 90, 5, distortion=[-0.2, 0, 0, 0])
    recording.attrs["recording_hash"] = "0123456789abcdef"
    assert scenetruth.undistort_images(recording).attrs["recording_hash"] != "0123456789abcdef"


@pytest.mark.parametrize(
    ("distortion", "order", "paths"),
    [
        (None, 5, ["distortion"]),
        ((1, 2, 3), 5, ["distortion"]),
        ("wide", 0, ["distortion", "order"]),
        ((-3.0, 0, 0, 0), 5, ["distortion"]),  # folds the image
        ((np.inf, 0, 0, 0), 6, ["distortion", "order"]),
    ],
)
def test_invalid_lenses_are_rejected(distortion: Any, order: int, paths: list[str]) -> None:
    recording = scenetruth.make_recording(np.zeros((1, 1, 60, 80)), 60, 5)
    with pytest.raises(ArgumentError) as caught:
        scenetruth.undistort_images(recording, distortion, order=order)
    assert [problem.path for problem in caught.value.problems] == paths


PATTERN = (120, 160)


def pattern(seed: int, std: float) -> Floats:
    return std * np.random.default_rng([seed, 1]).standard_normal(PATTERN)


def frames(fixed: Floats, light: Floats, count: int, seed: int) -> list[Floats]:
    """Return frames with read noise of 1.5 DN and shot noise, of a gain of 0.4 DN per electron."""
    draw = np.random.default_rng([seed, 2])
    return [
        np.rint(50 + fixed + light + np.sqrt(1.5**2 + 0.4 * light) * draw.standard_normal(PATTERN))
        for _ in range(count)
    ]  # fmt: skip


def matched(fixed: Floats, dark: Floats, seed: int = 3) -> PatternMatch:
    match = PatternMatch(frame_moments(frames(dark, np.zeros(PATTERN), 8, seed)))
    # Smooth areas next to texture, as in images of a board.
    light = np.full(PATTERN, 60.0)
    light[:, 80:] = 900 + 300 * np.random.default_rng(seed).standard_normal((PATTERN[0], 80)).clip(-2, 2)
    for image in frames(fixed, light, 12, seed + 1):
        match.add(image)
    return match


@pytest.mark.parametrize("std", [0.7, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_own_and_foreign_patterns(std: float, seed: int) -> None:
    own, foreign = pattern(seed, std), pattern(seed + 50, std)
    slope, deviation = matched(own, own).slope()
    assert abs(slope - 1) < 4 * deviation + 0.03  # tolerance of the jackknife
    assert deviation < 0.2
    slope, deviation = matched(own, foreign).slope()
    assert abs(slope) < 4 * deviation
    assert slope < 1 - 4 * deviation


def test_a_pattern_below_its_uncertainty_is_not_tested() -> None:
    none = np.zeros(PATTERN)
    match = matched(none, none)
    assert not match.measurable
    assert match.slope()[1] == np.inf


def test_images_without_noise_do_not_count() -> None:
    """Rounding hides the pattern in them."""
    own = pattern(1, 3.0)
    match = PatternMatch(frame_moments(frames(own, np.zeros(PATTERN), 8, 1)))
    match.add(np.full(PATTERN, 300))
    assert match.slope()[1] == np.inf
