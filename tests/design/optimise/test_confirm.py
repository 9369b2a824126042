"""Simulations of rigs: what they measure, and what is kept."""

from __future__ import annotations

from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.dataset.sample import Made
from scenetruth.design.optimise import goal_from_plain
from scenetruth.design.optimise.confirm.confirm import confirmed
from scenetruth.design.optimise.confirm.measure import Confirmation, simulate_one, simulated
from scenetruth.design.optimise.goal.parts import Confirm
from scenetruth.design.optimise.goal.prepare import prepare
from scenetruth.design.optimise.parts import Objective
from scenetruth.design.optimise.rig.evaluate import evaluate
from scenetruth.design.optimise.rig.rigs import rig_of
from scenetruth.scene import scene_from_plain
from tests.design.optimise.small import goal, scene

DEPTH = Objective("depth", "interior", "mm", "Depth")
OF_WALL = Objective("depth", "object_wall", "mm", "Depth of wall")
NOTHING = Objective("growth_rate", "interior", "%/h", "Growth")


def test_figures_are_those_of_a_score() -> None:
    made = scene_from_plain({**scene(), "estimate": {"method": "structure_tensor"}})
    found = simulated(made, (DEPTH, OF_WALL, NOTHING))
    recording, truth = st.simulate(made)
    told = st.score(st.estimate(recording), truth, interior_margin_px=0.0).regions["interior"]["depth"]
    assert found["Depth"]["rms"] == told["rms"]
    # The only object is all that there is; what nothing is told of is left out.
    assert found["Depth of wall"] == found["Depth"]
    assert "Growth" not in found


def test_seeds_make_intervals_and_are_simulated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = prepare(goal_from_plain(goal()))
    values = {"stage.baseline_mm": 4.0, "stage.positions": 3, "optics.psf": None}
    rig = rig_of(7, evaluate(prepared.task, values), prepared)
    first = confirmed([rig], prepared, Confirm(rigs=1, seeds=2, most_px=None), tmp_path, 0)
    told = first.rigs[7].simulated["Depth"]
    assert told.seeds == 2
    assert 0 < told.low < told.number < told.high
    assert first.discrepancies[0].predicted == pytest.approx(rig.predicted["Depth"])
    assert first.changes == ()
    numbers: list[int] = []
    # What is there is not made again; one seed more is.

    def counted(job: Confirmation, number: int) -> Made:
        numbers.append(number)
        return simulate_one(job, number)

    monkeypatch.setattr("scenetruth.design.optimise.confirm.confirm.simulate_one", counted)
    again = confirmed([rig], prepared, Confirm(rigs=1, seeds=3, most_px=None), tmp_path, 0)
    assert numbers == [2]
    assert again.rigs[7].simulated["Depth"].seeds == 3
    assert confirmed([], prepared, Confirm(), tmp_path, 0).rigs == {}


def test_what_fails_is_told(tmp_path: Path) -> None:
    broken = {**scene(), "estimate": {"method": "structure_tensor"}, "objects": []}
    job = Confirmation(str(tmp_path), (broken,), (1,), (DEPTH,), ())
    made = simulate_one(job, 0)
    assert "rig 1 of those that are simulated, seed 1: SceneError" in made.failure["message"]
