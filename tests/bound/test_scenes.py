"""The bound of simulated scenes, and how near the refined method comes to it."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.bound import cramer_rao_bound
from tests.bound.planes import plane_of, truth_of
from tests.dataset.conftest import SCENE
from tests.nightly import nightly


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
