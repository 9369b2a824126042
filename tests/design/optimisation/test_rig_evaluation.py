"""Rigs evaluated: free parameters, scenes, predictions with their parts, and what the hardware allows."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.camera.sensor import EmvaSensor
from scenetruth.design.optimisation import (
    BaseRig,
    DesignSpace,
    DesignSpec,
    Evaluation,
    IlluminationSpec,
    OptimisationProblem,
    Parameter,
    build_rig,
    compute_local_sensitivities,
    compute_objective_contributions,
    evaluate_rig,
    load_catalogues,
    prepare_problem,
    rank_evaluations,
    rig_from_evaluation,
)
from scenetruth.design.prediction import predict
from scenetruth.errors import SceneError
from scenetruth.scene import Scene
from tests.helpers.small_specification import scene, spec

VALUES: dict[str, Any] = {
    "lens": "c_mount_25mm",
    "camera": "vga_cmos",
    "stage": "screw_stage",
    "f_number": 8.0,
    "stage.baseline_mm": 4.0,
}


@pytest.fixture(scope="module")
def prepared() -> OptimisationProblem:
    free = {"lens": "all", "camera": "all", "stage": "all", "f_number": {"from": 1.5, "to": 22}}
    free |= {"stage.baseline_mm": {"from": 1, "to": 90}}
    found = spec(variables=free, objectives=[{"quantity": "depth"}, {"quantity": "velocity_z"}], constraints=[])
    found["scene"]["frames"]["frame_interval_s"] = 60.0
    return prepare_problem(DesignSpec.from_dict(found))


def evaluated(prepared: OptimisationProblem, **changes: Any) -> Evaluation:
    return evaluate_rig(prepared.task, {**VALUES, **changes})


def test_parts_add_up_to_what_is_predicted(prepared: OptimisationProblem) -> None:
    one = evaluated(prepared)
    scene = Scene.from_dict(dict(rig_from_evaluation(3, one, prepared).scene))
    assert one.parts["Depth"]["noise"] == predict(scene, method="structure_tensor").precision("depth", "interior").value
    for title, parts in one.parts.items():
        assert one.predicted[title] == pytest.approx(math.hypot(*parts.values()))
    # A screw is far worse than the noise, an air bearing far better than a screw.
    better = evaluated(prepared, stage="air_bearing")
    depth = "Depth"
    assert one.parts[depth]["stage"] > one.parts[depth]["noise"]
    assert better.parts[depth]["stage"] < 0.2 * one.parts[depth]["stage"]
    assert better.parts[depth]["noise"] == pytest.approx(one.parts[depth]["noise"], rel=1e-6)


@pytest.mark.parametrize("statistic", ["rmse", "p95_abs_error"])
def test_statistics_are_those_of_the_region(prepared: OptimisationProblem, statistic: Any) -> None:
    one = evaluated(prepared, stage="air_bearing")
    scene = Scene.from_dict(dict(rig_from_evaluation(3, one, prepared).scene))
    prediction = predict(scene, method="structure_tensor")
    figure = prediction.precision("depth", "interior")
    depth = replace(prepared.task.objectives[0], statistic=statistic)
    parts = compute_objective_contributions(depth, scene, prediction)
    assert parts["noise"] == getattr(figure, statistic)
    # Standard deviations differ from place to place, but not by much: a wall.
    factor = {"rmse": 1.0, "p95_abs_error": 1.96}[statistic]
    assert factor * figure.value * 0.95 < parts["noise"] < factor * figure.value * 1.5
    typical = compute_objective_contributions(prepared.task.objectives[0], scene, prediction)
    assert parts["stage"] == pytest.approx(factor * typical["stage"], rel=1e-4)


def test_the_bias_of_isotropic_growth_is_no_noise(prepared: OptimisationProblem) -> None:
    plain = scene() | {"estimate": {"method": "refined"}}
    prediction = replace(predict(plain), growth_bias_share={"interior": 0.36})
    growth = replace(prepared.task.objectives[0], quantity="growth_rate")
    known = Scene.from_dict(plain)
    parts = compute_objective_contributions(growth, known, prediction)
    whole = compute_objective_contributions(growth, known, replace(prediction, growth_bias_share={}))["noise"]
    assert (parts["noise"], parts["anisotropy"]) == pytest.approx((0.8 * whole, 0.6 * whole))


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({}, ""),
        ({"stage.baseline_mm": 60.0}, "travel"),
        ({"f_number": 1.6}, "f_number"),
        ({"f_number": 20.0}, "f_number"),
        ({"camera": "large_pixel_cmos_12mp"}, "image_circle"),
    ],
)
def test_lenses_and_stages_bring_limits(prepared: OptimisationProblem, changes: dict[str, Any], kind: str) -> None:
    one = evaluated(prepared, **changes)
    assert {each.kind for each in one.constraints if not each.holds} == ({kind} if kind else set())
    assert one.holds == (not kind)
    assert (one.excess == 0) == (not kind)


def test_what_makes_no_scene_is_worst(prepared: OptimisationProblem) -> None:
    lost = evaluated(prepared, **{"stage.baseline_mm": 0.0})
    assert "must not be zero" in lost.problem
    assert (lost.holds, lost.predicted["Depth"]) == (False, math.inf)
    good, wide = evaluated(prepared), evaluated(prepared, **{"stage.baseline_mm": 60.0})
    assert rank_evaluations([lost, wide, good]) == [good, wide, lost]


def test_ten_percent_of_lenses_and_apertures(prepared: OptimisationProblem) -> None:
    more = compute_local_sensitivities(evaluated(prepared), prepared)
    assert ("Depth", "camera") not in more
    assert ("Depth", "stage") not in more
    # The stage's turns limit depth, at any focal length: ψ f px, over f B / Z.
    assert more["Depth", "stage.baseline_mm"] == pytest.approx(1 / 1.1 - 1, abs=0.01)
    assert abs(more["Depth", "lens"]) < 0.02
    less = compute_local_sensitivities(evaluated(prepared), prepared, 0.9)
    assert less["Depth", "stage.baseline_mm"] == pytest.approx(1 / 0.9 - 1, abs=0.01)
    assert set(less) == set(more)


ENTRIES = load_catalogues()
RIG = {"lens": "c_mount_50mm", "camera": "industrial_cmos_5mp", "stage": "air_bearing"}


def base(light: IlluminationSpec | None = None, *free: str) -> BaseRig:
    return BaseRig(Scene.from_dict(scene()).to_dict(), {path: (path,) for path in free}, ENTRIES, light, 500.0)


def built(values: dict[str, Any], light: IlluminationSpec | None = None) -> Scene:
    return Scene.from_dict(build_rig(base(light), values).plain)


def test_a_thin_lens_that_is_focused() -> None:
    made = built({**RIG, "f_number": 8.0})
    # 1/f = 1/Z + 1/b; rays through its middle make the scale b / Z.
    image_mm = 1 / (1 / 50 - 1 / 500)
    assert made.camera.focal_px == pytest.approx(image_mm / 3.45e-3)
    defocus = made.optics.defocus
    assert defocus is not None
    assert (defocus.aperture_mm, defocus.focus_distance_mm) == (50 / 8, 500.0)
    # 2 µm of the lens, and Airy's disc of the effective f-number: its radius is 1.22 λ N, its core's σ 0.345 of that.
    airy_um = 0.345 * 1.22 * 0.55 * 8 * image_mm / 50
    assert made.optics.psf is not None
    assert made.optics.psf.finest_px == pytest.approx(math.hypot(2.0, airy_um) / 3.45, rel=1e-3)


def test_photons_of_a_lit_surface() -> None:
    light = IlluminationSpec(illuminance_lux=1000)
    made = built({**RIG, "f_number": 8.0, "exposure_s": 0.02}, light)
    assert isinstance(made.sensor, EmvaSensor)
    # A white surface of 1000 lux sends E / (4 N²) lux; a photon of 555 nm has h c / λ; a lux is 1 / 683 W/m².
    effective = 8 * (1 / (1 / 50 - 1 / 500)) / 50
    watts = 1000 / (4 * effective**2) / 683
    photons = watts / (6.62607e-34 * 2.99792e8 / 555e-9) * (3.45e-6) ** 2
    assert made.sensor.photon_rate_per_s == pytest.approx(photons, rel=1e-3)
    assert (made.sensor.exposure_time_s, made.shutter.exposure_time_s) == (0.02, 0.02)
    # Without light, a white surface fills 80 % of the full well, whatever the exposure.
    lit = built({**RIG, "exposure_s": 0.02}).sensor
    assert isinstance(lit, EmvaSensor)
    electrons = lit.photon_rate_per_s * 0.02 * lit.quantum_efficiency
    assert electrons == pytest.approx(0.8 * min(lit.full_well_e, (4095 - 16) / lit.gain_dn_per_e))


@pytest.mark.parametrize("name", list(ENTRIES.cameras))
def test_every_camera_makes_a_scene(name: str) -> None:
    made = built({**RIG, "camera": name})
    entry = ENTRIES.cameras[name]
    assert (made.camera.width, made.camera.pixel_pitch_um) == (entry.width, entry.pixel_pitch_um)
    assert isinstance(made.sensor, EmvaSensor)
    if entry.read_noise_e is not None:
        assert made.sensor.temporal_dark_noise_e == entry.read_noise_e


@pytest.mark.parametrize("name", list(ENTRIES.stages))
def test_stages_have_errors_and_need_time(name: str) -> None:
    entry = ENTRIES.stages[name]
    given = base()
    given.plain["frames"]["frame_interval_s"] = 60.0
    made = Scene.from_dict(build_rig(given, {"stage": name, "exposure_s": 0.01}).plain)
    assert made.stage.errors is not None
    assert made.stage.errors.yaw_urad == entry.yaw_urad
    moving = 4 / entry.speed_mm_per_s if entry.speed_mm_per_s else 0.0
    assert made.stage.time_per_position_s == pytest.approx(entry.settle_s + moving + 0.01)


def test_the_working_distance_moves_all_and_the_focus() -> None:
    given = base()
    given.plain["objects"].append({**copy.deepcopy(given.plain["objects"][0]), "name": "behind"})
    given.plain["objects"][1]["pose"]["position_mm"] = [1, 2, 600]
    made = Scene.from_dict(build_rig(given, {**RIG, "working_distance_mm": 450.0}).plain)
    assert [item.pose.position_mm[2] for item in made.objects] == [450.0, 550.0]
    assert made.optics.defocus is not None
    assert made.optics.defocus.focus_distance_mm == 450.0
    assert given.plain["objects"][0]["pose"]["position_mm"][2] == 500


def test_fields_of_the_scene_are_put_where_they_belong() -> None:
    given = base(None, "stage.baseline_mm")
    assert build_rig(given, {"stage.baseline_mm": 7.5}).plain["stage"]["baseline_mm"] == 7.5


def test_lenses_that_cannot_be_used() -> None:
    with pytest.raises(SceneError, match="pixel_pitch_um"):
        build_rig(base(), {"lens": "c_mount_50mm"})
    near = BaseRig(base().plain, {}, ENTRIES, None, 40.0)
    with pytest.raises(SceneError, match="above the focal length of the lens"):
        build_rig(near, RIG)


RANGES = [
    Parameter("real", 2.0, 40.0),
    Parameter("log", 0.001, 20.0, logarithmic=True),
    Parameter("whole", 2.0, 9.0, whole=True),
    Parameter("whole log", 1.0, 500.0, logarithmic=True, whole=True),
    Parameter("choice", choices=(60, "a", None, {"kind": "gaussian"})),
]


@pytest.mark.parametrize("parameter", RANGES, ids=lambda one: one.name)
@given(unit=some.floats(0, 1))
def test_a_value_stands_for_its_own_number(parameter: Parameter, unit: float) -> None:
    value = parameter.value(unit)
    again = parameter.value(min(max(parameter.unit(value), 0.0), 1.0))
    if isinstance(value, float):
        # Values have four digits: half of the last is 5e-4 of the value at most.
        assert again == pytest.approx(value, rel=5e-4)
    else:
        assert again == value


@pytest.mark.parametrize("parameter", RANGES[:4], ids=lambda one: one.name)
def test_ranges_reach_their_ends_and_no_farther(parameter: Parameter) -> None:
    values = [parameter.value(unit / 1000) for unit in range(1001)]
    assert (min(values), max(values)) == (parameter.low, parameter.high)
    assert sorted(values) == values


def test_whole_numbers_and_choices_are_equally_likely() -> None:
    for parameter in (RANGES[2], RANGES[4]):
        told: list[Any] = [str(parameter.value((n + 0.5) / 8000)) for n in range(8000)]
        assert {told.count(value) for value in set(told)} == {8000 // parameter.levels}


def test_a_logarithmic_range_is_even_in_factors() -> None:
    assert RANGES[1].value(0.5) == pytest.approx(math.sqrt(0.001 * 20), rel=1e-3)


def test_points_and_values_of_a_space() -> None:
    space = DesignSpace(tuple(RANGES))
    values = space.values([0.1, 0.2, 0.3, 0.4, 0.9])
    assert space.names == list(values)
    assert space.values(space.point(values)) == values
