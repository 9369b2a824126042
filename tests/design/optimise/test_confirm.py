"""Simulations of rigs: what they measure, and what is kept."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.design.optimisation import DesignSpec
from scenetruth.design.optimisation.confirmation import (
    ConfirmationTask,
    get_simulated_statistic,
    simulate_candidate,
    simulate_candidates,
    simulate_objectives,
)
from scenetruth.design.optimisation.design_records import STATISTICS, Objective, compute_prediction_interval
from scenetruth.design.optimisation.design_result import compose_summary
from scenetruth.design.optimisation.interpretation import rig_from_evaluation
from scenetruth.design.optimisation.problem_setup import prepare_problem
from scenetruth.design.optimisation.rig_evaluation import evaluate_rig
from scenetruth.design.optimisation.specification import ConfirmationSpec
from scenetruth.jobs.results import TaskResult
from scenetruth.scene import Scene
from tests.design.optimise.small import scene, spec

DEPTH = Objective("depth", "interior", "mm", "Depth")
OF_WALL = Objective("depth", "object_wall", "mm", "Depth of wall")
NOTHING = Objective("growth_rate", "interior", "%/h", "Growth")


def test_figures_are_those_of_a_score() -> None:
    made = Scene.from_dict({**scene(), "estimate": {"method": "structure_tensor"}})
    found = simulate_objectives(made, (DEPTH, OF_WALL, NOTHING))
    recording, truth = st.simulate(made)
    told = st.score(st.estimate(recording), truth, settings={"interior_margin_px": 0.0}).regions["interior"]["depth"]
    assert found["Depth"]["rmse"] == told["rmse"]
    # The only object is all that there is; what nothing is told of is left out.
    assert found["Depth of wall"] == found["Depth"]
    assert "Growth" not in found


def test_growth_of_lengths_is_measured_though_the_standard_truth_does_not_tell_it() -> None:
    method = {"method": "refined", "motion": "affine", "surface": "plane"}
    made = Scene.from_dict({**scene(), "estimate": method})
    found = simulate_objectives(made, (Objective("growth_principal_1", "interior", "%/h", "Growth"),))
    assert found["Growth"]["rmse"] > 0
    assert 0 < found["Growth"]["density"] <= 1


def test_a_rig_of_which_little_is_told_says_so() -> None:
    prepared = prepare_problem(DesignSpec.from_dict(spec()))
    values = {"stage.baseline_mm": 4.0, "stage.positions": 3, "optics.psf": None}
    rig = rig_from_evaluation(7, evaluate_rig(prepared.task, values), prepared)
    assert math.isnan(rig.density("Depth"))
    every = dict.fromkeys(STATISTICS, (0.1, 0.2))
    for densities, told in (((0.5, 0.7), True), ((0.9, 0.95), False), ((0.6, math.nan), True)):
        simulated_rig = replace(
            rig,
            figures={"Depth": {**every, "density": densities}},
            simulated={"Depth": compute_prediction_interval((0.1, 0.2))},
        )
        words = " ".join(compose_summary(prepared.task.objectives, simulated_rig, (), (), ()))
        assert ("only 60 % of the pixels are valid" in words) == told


def test_seeds_make_intervals_and_are_simulated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = prepare_problem(DesignSpec.from_dict(spec()))
    values = {"stage.baseline_mm": 4.0, "stage.positions": 3, "optics.psf": None}
    rig = rig_from_evaluation(7, evaluate_rig(prepared.task, values), prepared)
    first = simulate_candidates([rig], prepared, ConfirmationSpec(rigs=1, seeds=2, max_size_px=None), tmp_path)
    told = first.rigs[7].simulated["Depth"]
    assert told.seeds == 2
    assert 0 < told.pi_low < told.value < told.pi_high
    assert first.discrepancies[0].predicted == pytest.approx(rig.predicted["Depth"])
    assert first.changes == ()
    numbers: list[int] = []
    # What is there is not made again; one seed more is.

    def counted(job: ConfirmationTask, number: int) -> TaskResult:
        numbers.append(number)
        return simulate_candidate(job, number)

    monkeypatch.setattr("scenetruth.design.optimisation.confirmation.simulate_candidate", counted)
    again = simulate_candidates([rig], prepared, ConfirmationSpec(rigs=1, seeds=3, max_size_px=None), tmp_path)
    assert numbers == [2]
    assert again.rigs[7].simulated["Depth"].seeds == 3
    figures = again.rigs[7].figures["Depth"]
    # A median is no larger than √2 of the rms; what 95 % lie below, no larger than √20 of it.
    for typical, rms, percentile in zip(*(figures[name] for name in STATISTICS), strict=True):
        assert 0 < typical <= 1.4826 * 2**0.5 * rms
        assert typical / 1.4826 <= percentile <= 20**0.5 * rms
    assert again.rigs[7].simulated["Depth"] == compute_prediction_interval(figures["scaled_median_abs_error"])
    assert simulate_candidates([], prepared, ConfirmationSpec(), tmp_path).rigs == {}


def test_figures_that_lack_a_statistic_are_made_again(tmp_path: Path) -> None:
    plain = {**scene(), "estimate": {"method": "structure_tensor"}}
    job = ConfirmationTask(str(tmp_path), (plain,), (1,), (DEPTH,), ())
    told = {"Depth": {"rmse": 0.2, "median_abs_error": 0.1, "bias": 0.0, "density": 1.0}}
    (tmp_path / f"{job.key(0)}.json").write_text(json.dumps({"key": job.key(0), "figures": told}))
    assert job.figures(0) == told
    assert get_simulated_statistic(told, "Depth", "scaled_median_abs_error") == pytest.approx(0.14826)
    assert replace(job, objectives=(replace(DEPTH, statistic="p95_abs_error"),)).figures(0) is None


def test_what_fails_is_told(tmp_path: Path) -> None:
    broken = {**scene(), "estimate": {"method": "structure_tensor"}, "objects": []}
    job = ConfirmationTask(str(tmp_path), (broken,), (1,), (DEPTH,), ())
    made = simulate_candidate(job, 0)
    assert "simulated rig 1, seed 1: SceneError" in made.failure["message"]
