"""The cases of the suite: every scene is one, and is what its case says."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from scenetruth.comparison.case import SUITES, Case, all_cases, cases_named
from scenetruth.comparison.jobs import points_of
from scenetruth.errors import RecipeError
from scenetruth.scene import scene_from_plain
from scenetruth.scoring import QUANTITIES
from scenetruth.scoring.regions import seen_throughout
from scenetruth.simulation import simulate
from tests.nightly import nightly

CASES = list(all_cases().values())


def truth_of(case: Case, value: float) -> xr.Dataset:
    whole = simulate(scene_from_plain(case.scene(value)))[1]
    return whole.sel(t=0).assign(seen_throughout=(("y", "x"), seen_throughout(whole)))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.kind)
def test_every_case_says_what_it_is(case: Case) -> None:
    assert case.kind.isidentifier()
    assert case.question.endswith("?")
    assert set(case.quantities) <= set(QUANTITIES)
    assert case.headline[0] in {*case.quantities, "growth_rate_windowed"}
    assert set(case.core) <= set(case.values("full"))
    for suite in SUITES:
        assert case.values(suite) == tuple(sorted(case.values(suite)))
        for value in case.values(suite):
            scene_from_plain(case.scene(value))


@nightly
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.kind)
def test_every_value_has_pixels_to_measure(case: Case) -> None:
    for point in points_of([case], "full"):
        truth = truth_of(case, point.values[0])
        for value in point.values:
            # Fewer tell nothing of a method's errors.
            assert np.count_nonzero(case.region_at(truth, value)) > 150, value


def test_steps_lie_where_the_truth_has_them() -> None:
    case = all_cases()["step_of_motion"]
    truth = truth_of(case, 1.5)
    speed = truth["flow"].values[1]
    step = np.abs(np.diff(speed, axis=1)) > 0.5
    assert step.any(axis=1).all()
    region = case.region_at(truth, 1.5)
    assert region.any(axis=1).sum() > 60
    # Two px at most on either side of the step.
    assert region.sum(axis=1).max() <= 6
    case = all_cases()["occlusion"]
    truth = truth_of(case, 0.0)
    hidden, seen = case.region_at(truth, 0.0), case.region_at(truth, 1.0)
    assert not (hidden & seen).any()
    assert np.count_nonzero(hidden) > 500


def test_unknown_cases_are_named() -> None:
    with pytest.raises(RecipeError, match="no such case; known: blur, brightness"):
        cases_named(["noize", "blurr"])
