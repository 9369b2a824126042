"""The bound of planes against Fisher matrices in full, and of simulated scenes against the refined method."""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.bound import cramer_rao_bound
from scenetruth.bound.fisher_information import window_weights
from scenetruth.errors import RecordingError
from tests.helpers.bound_planes import directions, full_covariance, plane_of, truth_of
from tests.helpers.nightly import nightly
from tests.helpers.small_recipes import SCENE
from tests.helpers.wavy_plane import MovingPlane, turning

SIGMA = 2.0
AT = (14, 17)
MODELS = [
    ("constant", "translation", "gaussian"),
    ("plane", "translation", "even"),
    ("plane", "rigid", "gaussian"),
    ("plane", "growing", "gaussian"),
    ("plane", "affine", "even"),
]
STDS = ("disparity_std", "depth_std", "flow_std", "velocity_std", "slope_std")


def bound_of(plane: MovingPlane, recording: xr.Dataset | None = None, **settings: Any) -> xr.Dataset:
    recording = plane.recording(3, 3) if recording is None else recording
    given = {"noise_std": 1.0, "window_sigma_px": SIGMA, **settings}
    return cramer_rao_bound(truth_of(plane), recording.assign(radiance=recording["image"]), **given)


def inside(values: xr.DataArray) -> np.ndarray:
    """Where no window and no image ends."""
    return np.asarray(values.isel(y=slice(8, -8), x=slice(14, -14)).values)


@pytest.mark.parametrize(("surface", "motion", "window"), MODELS)
def test_it_is_that_of_the_full_fisher_matrix(surface: str, motion: str, window: str) -> None:
    """Derivatives of quintic splines err by 1e-4 for waves of 8 px; the covariances by somewhat more."""
    plane = plane_of(gradient=turning(4e-3, -3e-3, 5e-3))
    line = window_weights(window, SIGMA)[0]  # type: ignore[arg-type]
    columns = directions(plane, surface, motion, AT)
    covariance = full_covariance(plane, AT, np.outer(line, line), columns)
    found = bound_of(plane, surface=surface, motion=motion, window=window).isel(t=0, y=AT[0], x=AT[1])
    std = np.sqrt(np.diag(covariance))
    truth = plane.truth()
    at_pixel = truth["disparity"][AT], truth["depth"][AT]
    assert found["disparity_std"].item() == pytest.approx(std[0], rel=2e-3)
    assert found["depth_std"].item() == pytest.approx(std[0] * at_pixel[1] / at_pixel[0], rel=2e-3)
    assert found["velocity_std"].values == pytest.approx(std[[3, 6, 9]] * plane.baseline_mm, rel=2e-3)
    # Flow and slopes by differences of their definitions.
    centre = (np.array(plane.size[::-1]) - 1) / 2
    x, y = np.array(AT[::-1]) - centre

    def flow_and_slope(p: np.ndarray) -> np.ndarray:
        d, d_x, d_y = p[:3]
        m = d - x * d_x - y * d_y
        flow = [d * (p[3] - x * p[9] / plane.focal_px), d * (p[6] - y * p[9] / plane.focal_px)]
        return np.array([*flow, -plane.focal_px * d_x / m, -plane.focal_px * d_y / m])

    start = plane.start()
    here = np.zeros(12)
    here[[0, 3, 6, 9]] = start[:, AT[0], AT[1]]
    here[1], here[2] = np.gradient(start[0])[1][AT], np.gradient(start[0])[0][AT]
    steps = np.full(12, 1e-6)
    by_parameter = np.array(
        [(flow_and_slope(here + e) - flow_and_slope(here - e)) / (2 * e.sum()) for e in np.diag(steps)]
    )
    expected = np.sqrt(np.diag(by_parameter.T @ covariance @ by_parameter))
    assert found["flow_std"].values == pytest.approx(expected[:2], rel=2e-3)
    if surface == "plane":
        assert found["slope_std"].values == pytest.approx(expected[2:], rel=2e-3)
    assert ("slope_std" in found, "growth_rate_std" in found) == (surface == "plane", motion in ("growing", "affine"))


def test_even_windows_have_the_inverse_of_the_information() -> None:
    """The covariance of a weighted fit is never below that of the fit with even weights of the same pixels."""
    plane, size = plane_of(), 9
    columns = directions(plane, "plane", "rigid", AT)
    even = full_covariance(plane, AT, np.ones((size, size)), columns)
    line = np.exp(-0.5 * (np.arange(size) - size // 2) ** 2 / SIGMA**2)
    weighted = full_covariance(plane, AT, np.outer(line, line), columns)
    assert np.linalg.eigvalsh(columns.T @ (weighted - even) @ columns).min() > -1e-9 * np.trace(weighted)
    # 12 σ² + 1 = n² with n = 9 weights.
    found = bound_of(plane, window="even", window_sigma_px=np.sqrt(80 / 12)).isel(t=0, y=AT[0], x=AT[1])
    assert found["disparity_std"].item() == pytest.approx(np.sqrt(even[0, 0]), rel=2e-3)


def test_gains_and_offsets_cost_as_much_as_in_full() -> None:
    """Only those that change as places do are unknown here, and all of them there: the rest is perspective."""
    plane = plane_of(wavelengths_px=(12.0, 24.0))
    line = window_weights("gaussian", SIGMA)[0]
    columns = directions(plane, "plane", "rigid", AT)
    fixed, free = (
        np.sqrt(np.diag(full_covariance(plane, AT, np.outer(line, line), columns, brightness=each)))[[0, 3, 6, 9]]
        for each in (False, True)
    )
    found = bound_of(plane, brightness="per_image").isel(t=0, y=AT[0], x=AT[1])
    told = np.append(found["disparity_std"].values, found["velocity_std"].values / plane.baseline_mm)
    # It costs something here, so that the comparison says something.
    assert (free / fixed).max() > 1.05
    assert told == pytest.approx(free, rel=5e-3)


def test_growth_is_that_of_the_area() -> None:
    """2 ε in the isotropic model; the growing plane's own velocity gradient as a unit vector of the affine model."""
    plane = plane_of(slopes=(0.0, 0.0), velocity_mm=(0.0, 0.0, 0.0))
    line = window_weights("gaussian", SIGMA)[0]
    columns = directions(plane, "plane", "growing", AT)
    covariance = full_covariance(plane, AT, np.outer(line, line), columns)
    d = plane.truth()["disparity"][AT]
    # Tangents are (1, 0, 0) / d and (0, 1, 0) / d.
    growth = np.zeros(12)
    growth[[4, 8]] = d
    found = bound_of(plane, motion="growing").isel(t=0, y=AT[0], x=AT[1])
    assert found["growth_rate_std"].item() == pytest.approx(np.sqrt(growth @ covariance @ growth), rel=2e-3)


def test_it_scales_with_noise_and_contrast() -> None:
    plane = plane_of()
    recording = plane.recording(3, 3)
    one, three = bound_of(plane, recording), bound_of(plane, recording, noise_std=3.0)
    strong = bound_of(plane, recording.assign(image=(recording["image"] - 0.5) * 4.0 + 0.5))
    for name in STDS:
        assert np.isfinite(inside(one[name])).all()
        np.testing.assert_allclose(inside(three[name]), 3 * inside(one[name]), rtol=1e-9)
        np.testing.assert_allclose(inside(strong[name]), inside(one[name]) / 4, rtol=1e-6)


def test_it_scales_with_lengths() -> None:
    """A scene that is twice as large looks the same, from a stage that is twice as long."""
    one = plane_of()
    two = plane_of(depth_mm=2 * one.depth_mm, velocity_mm=tuple(2 * u for u in one.velocity_mm), baseline_mm=4.0)
    small, large = bound_of(one), bound_of(two)
    for name, factor in (
        ("disparity_std", 1),
        ("flow_std", 1),
        ("slope_std", 1),
        ("depth_std", 2),
        ("velocity_std", 2),
    ):
        np.testing.assert_allclose(inside(large[name]), factor * inside(small[name]), rtol=1e-6)


def test_more_images_never_know_less() -> None:
    plane = plane_of()
    whole = plane.recording(5, 5)
    parts = [whole, whole.sel(s=slice(-1, 1)), whole.sel(t=slice(-1, 1)), whole.sel(t=[0])]
    most, *fewer = (bound_of(plane, part, window="even") for part in parts)
    for part in fewer:
        for name in STDS:
            if name in part:
                assert (inside(part[name]) > inside(most[name])).all()
    assert "velocity_std" not in fewer[-1]
    assert inside(most["image_count"]).max() == 25


def test_a_richer_model_never_knows_better() -> None:
    """In even windows: fits with other weights than noise has may gain from one more unknown."""
    plane = plane_of()
    models: list[dict[str, Any]] = [{"surface": "constant", "motion": "translation"}]
    models += [{"motion": motion} for motion in ("translation", "rigid", "growing", "affine")]
    found = [bound_of(plane, window="even", **model) for model in models]
    found.append(bound_of(plane, window="even", motion="affine", brightness="per_image"))
    for simple, rich in pairwise(found):
        for name in STDS[:-1]:
            assert (inside(rich[name]) >= inside(simple[name]) * (1 - 1e-9)).all()
    # A rotation about X or Y, and growth, can be taken for motion.
    assert np.median(inside(found[3]["velocity_std"][2]) / inside(found[2]["velocity_std"][2])) > 1.01


def test_noisy_images_tell_the_same_bound() -> None:
    """The squares of the noise's own derivatives would make textures look twice as strong, and the bound too low."""
    plane = plane_of(size=(60, 72))
    noise = 0.03
    clean = bound_of(plane, noise_std=noise)
    noisy = cramer_rao_bound(
        truth_of(plane), plane.recording(3, 3, noise_std=noise), noise_std=noise, window_sigma_px=SIGMA
    )
    naive = bound_of(plane, plane.recording(3, 3, noise_std=noise), noise_std=noise)
    for name in ("disparity_std", "velocity_std"):
        # 40 windows that share nothing, each with an error of some 20 %.
        assert np.nanmedian(inside(noisy[name]) / inside(clean[name])) == pytest.approx(1.0, abs=0.07)
        assert np.nanmedian(inside(naive[name]) / inside(clean[name])) < 0.85


def test_images_without_noise_tell_it_by_either_way() -> None:
    """From the reference alone, or from images that are warped by splines."""
    plane = plane_of()
    one = bound_of(plane)
    other = cramer_rao_bound(truth_of(plane), plane.recording(3, 3), noise_std=1.0, window_sigma_px=SIGMA)
    for name in STDS:
        np.testing.assert_allclose(inside(other[name]), inside(one[name]), rtol=0.01)


def test_what_is_hidden_or_masked_does_not_count() -> None:
    plane = plane_of()
    recording = plane.recording(3, 3)
    visible = np.ones((3, 3, *plane.size), dtype=bool)
    visible[0] = False
    truth = truth_of(plane).drop_vars("mixed").reindex(t=[-1, 0, 1]).assign_coords(s=[-1, 0, 1])
    truth["mixed"] = truth["depth"].isnull() & False
    truth["visible"] = (("s", "t", "y", "x"), visible)
    ideal = recording.assign(radiance=recording["image"])
    settings: dict[str, Any] = {"noise_std": 1.0, "window_sigma_px": SIGMA}
    hidden = cramer_rao_bound(truth, ideal, **settings)
    mask = np.zeros((3, 1, *plane.size), dtype=bool)
    mask[0] = True
    masked = st.make_recording(
        recording["image"].values,
        plane.focal_px,
        plane.baseline_mm,
        exclusion_mask=np.broadcast_to(mask, recording["image"].shape),
    )
    both = [hidden, cramer_rao_bound(truth_of(plane), masked.assign(radiance=masked["image"]), **settings)]
    two = bound_of(plane, recording.sel(s=slice(0, 1)))
    for found in both:
        assert inside(found["image_count"]).max() == 6
        np.testing.assert_allclose(inside(found["disparity_std"]), inside(two["disparity_std"]), rtol=1e-9)


def test_windows_keep_to_one_object() -> None:
    """What the images show beyond an object's end does not change its bound."""
    plane = plane_of()
    recording = plane.recording(3, 3)
    objects = np.zeros((1, *plane.size), dtype=np.int64)
    objects[..., 20:] = 1
    truth = truth_of(plane, object_id=objects)  # type: ignore[arg-type]
    stronger = recording["image"].copy()
    # Beyond what the derivative's spline feels to 1e-4 from 3 px before the end.
    stronger[..., 30:] = (stronger[..., 30:] - 0.5) * 4 + 0.5
    settings: dict[str, Any] = {"noise_std": 1.0, "window_sigma_px": 6.0}
    one, other = (
        cramer_rao_bound(truth, recording.assign(radiance=image), **settings)
        for image in (recording["image"], stronger)
    )
    # The image and its linear relation to ``radiance`` are those of the whole.
    left = {"x": slice(None, 20)}
    whole = bound_of(plane, recording, window_sigma_px=6.0)
    ratio = other["disparity_std"].isel(left).values / one["disparity_std"].isel(left).values
    assert np.nanmax(ratio) / np.nanmin(ratio) == pytest.approx(1.0, abs=1e-3)
    assert (one["disparity_std"].isel(left).values[..., -3:] > whole["disparity_std"].isel(left).values[..., -3:]).all()


def test_every_nth_pixel_is_the_same() -> None:
    plane = plane_of(size=(41, 50))
    whole, part = bound_of(plane), bound_of(plane, step_px=4)
    xr.testing.assert_allclose(part, whole.isel(y=slice(None, None, 4), x=slice(None, None, 4)))


def test_rows_of_cameras_tell_more() -> None:
    plane = plane_of()
    grid = plane.recording(3, 3, rows=3)
    row = bound_of(plane, grid.sel(s_y=0))
    found = bound_of(plane, grid)
    assert inside(found["image_count"]).max() == 27
    # Σs² is 3 rows times 2; Σs_y² adds the same again, by the other gradient.
    ratio = inside(row["disparity_std"]) / inside(found["disparity_std"])
    assert np.median(ratio) == pytest.approx(np.sqrt(6), rel=0.15)


def test_colours_are_independent_images() -> None:
    plane = plane_of()
    grey, colour = plane.recording(3, 3), plane.recording(3, 3, channels=3)
    same = colour.assign(image=xr.concat([grey["image"]] * 3, dim="channel").transpose(..., "channel"))
    one, three = bound_of(plane, grey), bound_of(plane, same)
    np.testing.assert_allclose(inside(three["depth_std"]), inside(one["depth_std"]) / np.sqrt(3), rtol=1e-9)


def test_what_cannot_be_known_is_missing() -> None:
    """Waves in one direction only: flow along them is not known, nor is all else that it may stand for."""
    plane = plane_of(slopes=(0.0, 0.0), velocity_mm=(0.0, 0.0, 0.0))
    recording = plane.recording(3, 3)
    width = plane.size[1]
    stripes = np.broadcast_to(0.5 + 0.1 * np.sin(np.arange(width) / 2), recording["image"].shape)
    found = bound_of(plane, recording.assign(image=recording["image"].copy(data=stripes)))
    assert all(np.isnan(found[name]).all() for name in STDS)


def test_all_that_is_wrong_is_listed() -> None:
    plane = plane_of()
    truth, recording = truth_of(plane), plane.recording(3, 3)
    with pytest.raises(RecordingError, match=r"(?s)motion.*noise_std.*window_sigma_px.*step_px"):
        cramer_rao_bound(truth, recording, motion="wild", noise_std=0.0, window_sigma_px=-1.0, step_px=0)  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match=r"(?s)truth\.normal.*recording\.s: has one camera"):
        cramer_rao_bound(truth.drop_vars("normal"), recording.sel(s=[0]), noise_std=1.0)
    visible = np.ones((1, 1, *plane.size), dtype=bool)
    told = truth.assign_coords(s=[0]).assign(visible=(("s", "t", "y", "x"), visible))
    with pytest.raises(RecordingError, match=r"truth\.visible\.s: does not contain all images .*-1, 1"):
        cramer_rao_bound(told, recording.sel(t=[0]), noise_std=1.0)
    with pytest.raises(RecordingError, match=r"noise_std: is missing"):
        cramer_rao_bound(truth, recording)
    with pytest.raises(RecordingError, match=r"must have the pixels of the truth"):
        cramer_rao_bound(truth, recording.isel(x=slice(3, None)), noise_std=1.0)
    rectified = recording.copy(deep=True)
    rectified["image"].values[0, 0, :, :2] = np.nan
    with pytest.raises(RecordingError, match=rf"image: contains {2 * plane.size[0]} values that are not finite"):
        cramer_rao_bound(truth, rectified, noise_std=1.0)


def test_a_scene_has_a_bound_on_its_surfaces() -> None:
    scene = copy.deepcopy(SCENE)
    recording, truth = st.simulate(st.Scene.from_dict(scene), save_radiance=True)
    at = truth.sel(t=0)
    found = cramer_rao_bound(truth, recording, window_sigma_px=3.0)
    noisy = cramer_rao_bound(truth, recording.drop_vars("radiance"), window_sigma_px=3.0)
    nothing = at["mixed"].values.astype(bool) | np.isnan(at["depth"].values)
    known = np.isfinite(found["depth_std"].values[0])
    assert nothing.any()
    assert not known[nothing].any()
    assert known[~nothing].mean() > 0.95
    # 0.01 of 255, and rounding.
    assert found.attrs["noise_std"] == pytest.approx(np.sqrt(2.55**2 + 1 / 12))
    assert found.attrs["recording_hash"] == recording.attrs["recording_hash"]
    # What follows from depth and disparity being one.
    ratio = found["depth_std"] / found["disparity_std"] * at["disparity"] / at["depth"]
    np.testing.assert_allclose(ratio.values[0][known], 1.0, rtol=1e-6)
    # Waves of 4 px are short for splines of nine noisy images, and windows hold few pixels.
    both = known & np.isfinite(noisy["depth_std"].values[0])
    assert np.median((noisy["depth_std"] / found["depth_std"]).values[0][both]) == pytest.approx(1.0, abs=0.1)


def test_a_sensor_without_noise_needs_to_be_told_one() -> None:
    scene = copy.deepcopy(SCENE)
    scene["sensor"] = "ideal"
    recording, truth = st.simulate(st.Scene.from_dict(scene), save_radiance=True)
    with pytest.raises(st.RecordingError, match="noise_std"):
        cramer_rao_bound(truth, recording)
    found = cramer_rao_bound(truth, recording, noise_std=0.01, window_sigma_px=3.0)
    plain = cramer_rao_bound(truth, recording.drop_vars("radiance"), noise_std=0.01, window_sigma_px=3.0)
    np.testing.assert_allclose(plain["depth_std"].values, found["depth_std"].values, rtol=1e-5)


def test_a_truth_of_all_cameras_is_that_of_the_reference() -> None:
    scene = st.Scene.from_dict(copy.deepcopy(SCENE))
    (recording, one), (_, every) = (st.simulate(scene, truth_views=views) for views in ("reference", "all"))
    found = [cramer_rao_bound(truth, recording, window_sigma_px=3.0, step_px=5) for truth in (one, every)]
    np.testing.assert_array_equal(found[0]["velocity_std"].values, found[1]["velocity_std"].values)


def test_bright_pixels_have_more_noise() -> None:
    """Of a sensor with shot noise, the bound lies between those of its least and its largest noise."""
    scene = copy.deepcopy(SCENE)
    scene["sensor"] = {"kind": "emva1288", "preset": "industrial_cmos"}
    recording, truth = st.simulate(st.Scene.from_dict(scene), save_radiance=True)
    clean = recording["image"].values.astype(np.float64)
    least, most = (np.sqrt(0.39 * (grey - 16)) for grey in (np.quantile(clean, 0.01), clean.max()))
    low, own, high = (
        cramer_rao_bound(truth, recording, noise_std=noise, window_sigma_px=3.0)["depth_std"].values
        for noise in (least, None, most + 2.0)
    )
    known = np.isfinite(own)
    assert known.any()
    assert ((low < own) & (own < high))[known].mean() > 0.99
    assert (own / low)[known].std() > 0.01


def test_parts_of_different_scenes_are_refused() -> None:
    first, second = copy.deepcopy(SCENE), copy.deepcopy(SCENE)
    second["objects"][1]["pose"]["position_mm"][2] = 90
    (recording, _), (_, truth) = (st.simulate(st.Scene.from_dict(each)) for each in (first, second))
    with pytest.raises(st.MismatchError):
        cramer_rao_bound(truth, recording)


@nightly
@pytest.mark.parametrize("motion", ["rigid", "growing"])
def test_the_refined_method_reaches_it(motion: Any) -> None:
    """Scatter over noise, over the bound of the same windows.

    The image holds some 20 windows that share no noise: with 16 seeds, the scatter is known to 4 %. The median over
    pixels is 2 % low for so few seeds.
    """
    plane = plane_of(size=(64, 96), baseline_mm=4.0, velocity_mm=(0.05, -0.03, -0.2), waves=100)
    truth, clean = truth_of(plane), plane.recording(3, 5)
    noise, sigma = 0.005, 3.0
    bound = cramer_rao_bound(
        truth, clean.assign(radiance=clean["image"]), noise_std=noise, window_sigma_px=sigma, motion=motion
    )
    settings = {
        "surface": "plane",
        "motion": motion,
        "acceleration": False,
        "discontinuity_refit": False,
        "photometric_model": "none",
    }
    found = [
        st.estimate(plane.recording(3, 5, noise_std=noise, seed=seed), "refined", window_sigma_px=sigma, **settings)
        for seed in range(16)
    ]
    inside = {"t": 0, "y": slice(14, -14), "x": slice(22, -22)}
    for name in ("depth", "velocity"):
        estimates = np.array([each.sel(t=[0])[name].isel(inside).values for each in found], dtype=np.float64)
        ratio = estimates.std(axis=0, ddof=1) / bound[f"{name}_std"].isel(inside).values
        for part in ratio.reshape(-1, *ratio.shape[-2:]):
            assert 0.9 < np.median(part) < 1.15, name
