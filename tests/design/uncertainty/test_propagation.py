"""Propagation, against disturbances whose effect is known, against the methods themselves, and against the bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.benchmark.design_point import add_noise, ignore_scene_warnings
from scenetruth.bound import cramer_rao_bound
from scenetruth.design.uncertainty import (
    ImageDisturbance,
    ObservationModel,
    Propagation,
    build_observation_model,
    select_propagation,
)
from scenetruth.estimators.method_settings import RefinedSettings, StructureTensorSettings
from tests.helpers.budget_scenes import laboratory

NOISE_STD = 0.005


@pytest.fixture(scope="module")
def seen() -> tuple[ObservationModel, xr.Dataset, xr.Dataset]:
    scene = laboratory(everything=False)
    with ignore_scene_warnings():
        recording, truth = st.simulate(scene, save_radiance=True)
        estimate = st.estimate(recording, "structure_tensor")
    known = (estimate["status"].values[0] == 2) & np.isfinite(estimate["velocity"].values[:, 0]).all(axis=0)
    return build_observation_model(scene, recording, truth, known), recording, truth


def inner(sight: ObservationModel) -> NDArray[np.bool_]:
    mask = np.zeros_like(sight.known)
    mask[20:-20, 30:-30] = True
    return np.asarray(mask & sight.known)


@pytest.fixture(scope="module", params=["structure_tensor", "refined"])
def model(request: pytest.FixtureRequest, seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]) -> Propagation:
    settings = StructureTensorSettings() if request.param == "structure_tensor" else RefinedSettings()
    found = select_propagation(seen[0], settings)
    assert found is not None
    return found


def test_a_shift_per_step_is_a_disparity(
    model: Propagation, seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]
) -> None:
    sight = seen[0]
    errors = model.respond(lambda s, t: ImageDisturbance(-0.01 * s))
    inside = inner(sight) & np.isfinite(errors["depth"])
    # A slanted sheet is shown a little wider by one camera than by another, which the tensor leaves out.
    tolerance = 0.02 if model.name == "structure_tensor" else 1e-3
    np.testing.assert_allclose(errors["disparity"][inside], 0.01, rtol=tolerance)
    exact = -0.01 * sight.depth / sight.points.d
    np.testing.assert_allclose(errors["depth"][inside], exact[inside], rtol=tolerance)


def test_a_shift_per_frame_is_a_velocity(
    model: Propagation, seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]
) -> None:
    sight = seen[0]
    focal = sight.intrinsics.focal_length_px
    errors = model.respond(lambda s, t: ImageDisturbance(0.01 * t, -0.02 * t))
    inside = inner(sight) & np.isfinite(errors["velocity_x"])
    share = sight.depth / focal
    for name, value in (("velocity_x", 0.01), ("velocity_y", -0.02)):
        np.testing.assert_allclose(np.median((errors[name] / share)[inside]), value, rtol=0.05)


def test_images_that_grow_come_nearer(seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]) -> None:
    sight = seen[0]
    model = select_propagation(sight, StructureTensorSettings())
    assert model is not None
    errors = model.respond(
        lambda s, t: ImageDisturbance(1e-3 * t * sight.place(s, t).x, 1e-3 * t * sight.place(s, t).y)
    )
    inside = inner(sight)
    np.testing.assert_allclose(np.median((errors["velocity_z"] / sight.depth)[inside]), -1e-3, rtol=0.03)


def test_what_a_gain_explains_does_nothing_to_the_refined_method(
    seen: tuple[ObservationModel, xr.Dataset, xr.Dataset],
) -> None:
    sight = seen[0]
    drift = lambda s, t: ImageDisturbance(grey=0.01 * t * sight.texture)  # noqa: E731
    with_gains = select_propagation(sight, RefinedSettings())
    without = select_propagation(sight, RefinedSettings(photometric_model="none"))
    assert with_gains is not None
    assert without is not None
    inside = inner(sight)
    left, whole = (np.nanstd(one.respond(drift)["velocity_z"][inside]) for one in (with_gains, without))
    assert left < 1e-9 * whole


def test_noise_of_the_structure_tensor_is_what_it_shows(seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]) -> None:
    sight, recording, _ = seen
    model = select_propagation(sight, StructureTensorSettings())
    assert model is not None
    generator = np.random.default_rng(3)
    errors = model.respond(lambda s, t: ImageDisturbance(grey=generator.normal(0, NOISE_STD, sight.texture.shape)))
    with ignore_scene_warnings():
        one, other = (st.estimate(add_noise(recording, NOISE_STD, k), "structure_tensor") for k in "ab")
    inside = inner(sight)
    for name, found in (
        ("depth", [each["depth"].values[0] for each in (one, other)]),
        ("velocity_y", [each["velocity"].values[1, 0] for each in (one, other)]),
        ("velocity_z", [each["velocity"].values[2, 0] for each in (one, other)]),
    ):
        scatter = np.sqrt(np.nanmean((found[0] - found[1])[inside] ** 2) / 2)
        predicted = np.sqrt(np.nanmean(errors[name][inside] ** 2))
        # Some twenty independent windows give a standard deviation to a sixth; total least squares adds a tenth.
        assert 0.75 < predicted / scatter < 1.25, name


def test_noise_of_the_refined_method_is_the_bound(seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]) -> None:
    sight, recording, truth = seen
    model = select_propagation(sight, RefinedSettings(photometric_model="none"))
    assert model is not None
    generator = np.random.default_rng(3)
    draws = [
        model.respond(lambda s, t: ImageDisturbance(grey=generator.normal(0, NOISE_STD, sight.texture.shape)))
        for _ in range(4)
    ]
    bound = cramer_rao_bound(truth, recording, noise_std=NOISE_STD, motion="growing", step_px=3)
    inside = inner(sight)[::3, ::3]
    for name, std in (
        ("depth", bound["depth_std"].values[0]),
        ("velocity_x", bound["velocity_std"].values[0, 0]),
        ("velocity_z", bound["velocity_std"].values[2, 0]),
        ("growth_rate", bound["growth_rate_std"].values[0]),
    ):
        square = np.mean([one[name][::3, ::3] ** 2 for one in draws], axis=0)
        both = inside & np.isfinite(square) & np.isfinite(std)
        assert both.sum() > 100
        ratio = np.sqrt(square[both].mean() / (std[both] ** 2).mean())
        # Four draws of some twenty windows: a standard deviation to a twelfth.
        assert ratio == pytest.approx(1.0, abs=0.2), name


def test_slopes_are_what_ideal_images_leave(seen: tuple[ObservationModel, xr.Dataset, xr.Dataset]) -> None:
    sight, recording, truth = seen
    with ignore_scene_warnings():
        estimate = st.estimate(recording, "structure_tensor")
    model = select_propagation(sight, StructureTensorSettings())
    assert model is not None
    own = model.own()
    inside = inner(sight)
    left = (estimate["depth"].values[0] - truth["depth"].sel(t=0).values)[inside]
    predicted = own["slope"]["depth"][inside]
    # On a plane, nothing is curved.
    assert np.nanstd(own["curvature"]["depth"][inside]) < 0.1 * np.nanstd(predicted)
    assert np.corrcoef(left, predicted)[0, 1] > 0.9
    assert np.std(predicted) == pytest.approx(np.std(left), rel=0.3)


@pytest.mark.parametrize(("rate_per_hour", "model"), [(0.6, "affine"), (0.0, "growing")])
def test_noise_is_that_of_the_selected_motion_model(rate_per_hour: float, model: Any) -> None:
    """Growth along X alone by 1 % per frame exceeds the noise of the affine model, where the slope hides it."""
    growth = {"kind": "growth", "rate_per_hour": rate_per_hour, "along_share": 1.0}
    frames = {"count": 5, "frame_interval_s": 60}
    changes = {"objects.0.deformation": [growth], "frames": frames, "sensor": {"noise_std": NOISE_STD}}
    scene = laboratory(changes, everything=False)
    with ignore_scene_warnings():
        recording, truth = st.simulate(scene, save_radiance=True)
    sight = build_observation_model(scene, recording, truth, np.isfinite(truth["depth"].sel(t=0).values))
    disturbance = [np.random.default_rng(3).normal(0, NOISE_STD, (len(sight.s), len(sight.t), *sight.texture.shape))]
    errors = {}
    for motion in ("auto", model):
        found = select_propagation(sight, RefinedSettings(motion=motion))
        assert found is not None
        errors[motion] = found.respond(lambda s, t: ImageDisturbance(grey=disturbance[0][s, t]))
    for name, expected in errors[model].items():
        np.testing.assert_array_equal(errors["auto"][name][inner(sight)], expected[inner(sight)], err_msg=name)
