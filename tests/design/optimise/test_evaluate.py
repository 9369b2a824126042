"""Rigs evaluated: predictions with their parts, and what the hardware allows."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from scenetruth.design.optimisation import DesignSpec
from scenetruth.design.optimisation.interpretation import compute_local_sensitivities, rig_from_evaluation
from scenetruth.design.optimisation.problem_setup import OptimisationProblem, prepare_problem
from scenetruth.design.optimisation.rig_evaluation import (
    Evaluation,
    compute_objective_contributions,
    evaluate_rig,
    rank_evaluations,
)
from scenetruth.design.prediction import predict
from scenetruth.scene import Scene
from tests.design.optimise.small import spec

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
