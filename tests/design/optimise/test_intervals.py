"""Intervals of simulated figures, and what is said of prediction and simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scenetruth.design.optimisation.confirmation import compare_with_prediction
from scenetruth.design.optimisation.design_records import (
    PredictionInterval,
    RigDesign,
    compute_prediction_interval,
    compute_rig_interval,
)
from tests.design.optimise.small import objective


@pytest.mark.parametrize("seeds", [2, 4, 10])
def test_one_more_figure_lies_inside_with_95_percent(seeds: int) -> None:
    draws = 2000
    figures = np.exp(0.2 * np.random.default_rng(seeds).standard_normal((draws, seeds + 1)))
    inside = 0
    for *known, another in figures:
        found = compute_prediction_interval(known)
        inside += found.pi_low <= another <= found.pi_high
    # Of 2000 draws, the share is known to √(0.95 0.05 / 2000) = 0.5 %; three of them are allowed.
    assert inside / draws == pytest.approx(0.95, abs=0.015)


def test_few_figures() -> None:
    assert compute_prediction_interval([]).seeds == 0
    one = compute_prediction_interval([2.0])
    assert (one.value, one.seeds) == (2.0, 1)
    assert math.isnan(one.pi_low)
    assert math.isnan(compute_prediction_interval([0.0, 1.0]).pi_high)
    figures = {"depth": {"scaled_median_abs_error": (1.0, math.nan, 4.0), "rmse": (2.0, 2.0, 2.0)}}
    rig = RigDesign(1, {}, {}, {}, {}, (), None, "", figures)
    # What was not told of a seed is left out.
    assert compute_rig_interval(rig, "depth", "scaled_median_abs_error") == compute_prediction_interval([1.0, 4.0])
    assert compute_rig_interval(rig, "depth", "rmse").value == 2.0
    assert compute_rig_interval(rig, "growth", "rmse").seeds == 0


@pytest.mark.parametrize(
    ("simulated", "notable", "words"),
    [
        (PredictionInterval(1.1, 1.0, 1.2, 4), False, "factor 1.10"),
        (PredictionInterval(2.0, 1.8, 2.2, 4), True, "2.0 times the prediction"),
        (PredictionInterval(0.5, 0.4, 0.6, 4), True, "0.50 times the prediction"),
        # Seeds differ too much to tell.
        (PredictionInterval(2.0, 0.5, 8.0, 2), False, "within the scatter of 2 seeds"),
        (PredictionInterval(math.nan, math.nan, math.nan, 0), True, "no valid estimate"),
    ],
)
def test_discrepancies_are_told(simulated: PredictionInterval, notable: bool, words: str) -> None:
    found = compare_with_prediction(3, objective(), 1.0, simulated)
    assert (found.rig, found.notable) == (3, notable)
    assert words in found.says
