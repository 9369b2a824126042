"""Whether simulations keep the order of predictions: judged by paired differences, and not where they cannot tell."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from scenetruth.design.optimisation.confirmation import check_pair_rank, check_rank_consistency
from scenetruth.design.optimisation.design_records import PredictionInterval, RigDesign
from scenetruth.design.optimisation.design_result import describe_rank_consistency
from tests.design.optimise.small import objective


def rig(number: int, predicted: float, *figures: float) -> RigDesign:
    simulated = {"depth": PredictionInterval(1.0, 0.9, 1.1, len(figures))} if figures else {}
    return RigDesign(
        number, {}, {}, {"depth": predicted}, simulated, (), None, "", {"depth": {"scaled_median_abs_error": figures}}
    )


def test_what_seeds_have_in_common_does_not_hide_an_order() -> None:
    # Seeds differ by a factor of ten, rigs by a fifth in every seed.
    common = np.array([0.1, 1.0, 0.4, 0.2])
    better, worse = rig(1, 1.0, *common), rig(2, 1.5, *(common * [1.19, 1.21, 1.2, 1.2]))
    found = check_pair_rank(worse, better, objective())
    assert (found.better, found.worse, found.predicted, found.verdict) == (1, 2, 1.5, "kept")
    assert found.simulated == pytest.approx(1.2, rel=1e-3)
    assert 1.15 < found.ci_low < found.simulated < found.ci_high < 1.25
    swapped = check_pair_rank(replace(better, predicted={"depth": 2.0}), worse, objective())
    assert (swapped.better, swapped.worse, swapped.verdict) == (2, 1, "swapped")
    assert swapped.simulated == pytest.approx(1 / found.simulated)
    # The median statistic was told, the other was not.
    unknown = check_pair_rank(better, worse, replace(objective(), statistic="rmse"))
    assert (unknown.seeds, unknown.verdict) == (0, "undecided")


def test_what_seeds_do_not_tell_is_told_so() -> None:
    near = check_pair_rank(rig(1, 1.0, 1.0, 1.1, 0.9), rig(2, 1.02, 1.1, 0.9, 1.0), objective())
    assert near.verdict == "undecided"
    assert near.ci_low < 1 < near.ci_high
    # Seeds that tell one rig alone tell nothing.
    lost = check_pair_rank(rig(1, 1.0, 1.0, math.nan, 1.0), rig(2, 1.2, math.nan, 2.0, 2.0), objective())
    assert (lost.seeds, lost.verdict) == (1, "undecided")
    assert math.isnan(lost.simulated)


def test_one_pair_of_twenty_like_rigs_is_told_apart_by_chance() -> None:
    generator = np.random.default_rng(7)
    draws = 4000
    told = 0
    for figures in np.exp(0.2 * generator.standard_normal((draws, 2, 5))):
        one = check_pair_rank(rig(1, 1.0, *figures[0]), rig(2, 1.01, *figures[1]), objective())
        told += one.verdict != "undecided"
    # Known to √(0.05 0.95 / 4000) = 0.34 %; three of them are allowed.
    assert told / draws == pytest.approx(0.05, abs=0.0105)


def test_all_pairs_that_were_simulated_are_judged_and_counted() -> None:
    rigs = [rig(1, 1.0, 1.0, 1.1), rig(2, 2.0, 2.0, 2.2), rig(3, 3.0), rig(4, 1.0, 0.5, 0.55), rig(5, 9.0, 2.1, 2.1)]
    found = check_rank_consistency(rigs, (objective(),))
    # None with rig 3, which was not simulated; none of 1 and 4, which are predicted to be alike.
    assert [(one.better, one.worse) for one in found] == [(1, 2), (1, 5), (2, 4)[::-1], (2, 5), (4, 5)]
    (line,) = describe_rank_consistency((objective(),), found)
    verdicts = [one.verdict for one in found]
    assert verdicts.count("kept") == 4
    assert line.startswith("depth: of 5 pairs of simulated rigs, 4 keep the predicted order, 0 reverse it")
    assert list(describe_rank_consistency((objective("growth"),), found)) == []
