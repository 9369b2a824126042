"""Rigs evaluated: predictions with their parts, and what the hardware allows."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from scenetruth.design.optimise import goal_from_plain
from scenetruth.design.optimise.goal.prepare import Prepared, prepare
from scenetruth.design.optimise.rig.evaluate import Evaluation, evaluate, parts_of, sorted_by_worth
from scenetruth.design.optimise.rig.rigs import rig_of, ten_percent_of
from scenetruth.design.predict import predict
from scenetruth.scene import scene_from_plain
from tests.design.optimise.small import goal

VALUES: dict[str, Any] = {
    "lens": "c_mount_25mm",
    "camera": "vga_cmos",
    "stage": "screw_stage",
    "f_number": 8.0,
    "stage.baseline_mm": 4.0,
}


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    free = {"lens": "all", "camera": "all", "stage": "all", "f_number": {"from": 1.5, "to": 22}}
    free |= {"stage.baseline_mm": {"from": 1, "to": 90}}
    found = goal(free=free, objectives=[{"quantity": "depth"}, {"quantity": "velocity_z"}], constraints=[])
    found["scene"]["frames"]["frame_interval_s"] = 60.0
    return prepare(goal_from_plain(found))


def evaluated(prepared: Prepared, **changes: Any) -> Evaluation:
    return evaluate(prepared.task, {**VALUES, **changes})


def test_parts_add_up_to_what_is_predicted(prepared: Prepared) -> None:
    one = evaluated(prepared)
    scene = scene_from_plain(dict(rig_of(3, one, prepared).scene))
    assert one.parts["Depth"]["noise"] == predict(scene, method="structure_tensor").figure("depth", "interior").value
    for title, parts in one.parts.items():
        assert one.predicted[title] == pytest.approx(math.hypot(*parts.values()))
    # A screw is far worse than the noise, an air bearing far better than a screw.
    better = evaluated(prepared, stage="air_bearing")
    depth = "Depth"
    assert one.parts[depth]["stage"] > one.parts[depth]["noise"]
    assert better.parts[depth]["stage"] < 0.2 * one.parts[depth]["stage"]
    assert better.parts[depth]["noise"] == pytest.approx(one.parts[depth]["noise"], rel=1e-6)


@pytest.mark.parametrize("statistic", ["rms", "percentile_95"])
def test_statistics_are_those_of_the_region(prepared: Prepared, statistic: Any) -> None:
    one = evaluated(prepared, stage="air_bearing")
    scene = scene_from_plain(dict(rig_of(3, one, prepared).scene))
    prediction = predict(scene, method="structure_tensor")
    figure = prediction.figure("depth", "interior")
    depth = replace(prepared.task.objectives[0], statistic=statistic)
    parts = parts_of(depth, scene, prediction)
    assert parts["noise"] == getattr(figure, statistic)
    # Standard deviations differ from place to place, but not by much: a wall.
    factor = {"rms": 1.0, "percentile_95": 1.96}[statistic]
    assert factor * figure.value * 0.95 < parts["noise"] < factor * figure.value * 1.5
    typical = parts_of(prepared.task.objectives[0], scene, prediction)
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
def test_lenses_and_stages_bring_limits(prepared: Prepared, changes: dict[str, Any], kind: str) -> None:
    one = evaluated(prepared, **changes)
    assert {each.kind for each in one.constraints if not each.holds} == ({kind} if kind else set())
    assert one.holds == (not kind)
    assert (one.excess == 0) == (not kind)


def test_what_makes_no_scene_is_worst(prepared: Prepared) -> None:
    lost = evaluated(prepared, **{"stage.baseline_mm": 0.0})
    assert "must not be zero" in lost.problem
    assert (lost.holds, lost.predicted["Depth"]) == (False, math.inf)
    good, wide = evaluated(prepared), evaluated(prepared, **{"stage.baseline_mm": 60.0})
    assert sorted_by_worth([lost, wide, good]) == [good, wide, lost]


def test_ten_percent_of_lenses_and_apertures(prepared: Prepared) -> None:
    more = ten_percent_of(evaluated(prepared), prepared)
    assert ("Depth", "camera") not in more
    assert ("Depth", "stage") not in more
    # The stage's turns limit depth, at any focal length: ψ f px, over f B / Z.
    assert more["Depth", "stage.baseline_mm"] == pytest.approx(1 / 1.1 - 1, abs=0.01)
    assert abs(more["Depth", "lens"]) < 0.02
    less = ten_percent_of(evaluated(prepared), prepared, 0.9)
    assert less["Depth", "stage.baseline_mm"] == pytest.approx(1 / 0.9 - 1, abs=0.01)
    assert set(less) == set(more)
