"""The statistics of objectives: what is predicted of them is what errors drawn with these standard deviations have."""

from __future__ import annotations

import re

import numpy as np
import pytest

from scenetruth.design.optimisation import STATISTICS, compute_predicted_statistic, decide_target, describe_decision
from scenetruth.design.prediction import PredictedValue, compute_spread
from scenetruth.scoring.statistics import error_statistics

DRAWS = 200_000


def drawn(std: np.ndarray, seed: int) -> dict[str, float]:
    """Return the statistics of a score of normal errors."""
    errors = np.random.default_rng(seed).standard_normal(std.shape) * std
    told = error_statistics(errors, np.zeros_like(errors), np.ones(errors.shape, dtype=bool))
    return {name: kind.factor * float(told[kind.scored] or 0.0) for name, kind in STATISTICS.items()}


def test_all_are_one_where_all_points_are_alike() -> None:
    std = np.full(DRAWS, 0.3)
    figure = PredictedValue(0.3, "mm", None, 0.3, None, "mm", 1.0, *compute_spread(std[:500], np.ones(500))[1:])
    for name, told in drawn(std, 1).items():
        predicted = compute_predicted_statistic(figure, name)  # type: ignore[arg-type]
        assert predicted == pytest.approx(0.3 * STATISTICS[name].of_normal, rel=1e-3)
        # Quantiles of 200,000 draws scatter by 0.3 %; four of these are allowed.
        assert told == pytest.approx(predicted, rel=0.012)


@pytest.mark.parametrize("spread", [0.3, 0.8])
def test_those_of_a_region_whose_points_differ(spread: float) -> None:
    generator = np.random.default_rng(3)
    std = 0.1 * np.exp(spread * generator.standard_normal(400))
    weights = generator.uniform(0.2, 3.0, 400)
    median, rms, percentile = compute_spread(std, weights)
    chosen = generator.choice(std, DRAWS, p=weights / weights.sum())
    told = drawn(chosen, 2)
    assert told["rmse"] == pytest.approx(rms, rel=0.02)
    assert told["p95_abs_error"] == pytest.approx(percentile, rel=0.02)
    # The median of the errors' sizes is not that of the standard deviations, but near it.
    assert told["scaled_median_abs_error"] == pytest.approx(median, rel=0.15)


def test_points_without_error_or_without_number() -> None:
    assert compute_spread(np.array([]), np.array([])) == (np.inf,) * 3
    assert compute_spread(np.zeros(4), np.ones(4)) == (0.0, 0.0, 0.0)
    # Of ten points, nine know all: 95 % of the errors lie below the median of the tenth.
    one = np.array([0.0] * 9 + [1.0])
    median, rms, percentile = compute_spread(one, np.ones(10))
    assert median == 0.0
    assert rms == pytest.approx(np.sqrt(0.1))
    assert percentile == pytest.approx(0.6745, rel=0.05)


@pytest.mark.parametrize(("count", "scatter"), [(5, 0.1), (5, 0.3), (20, 0.3)])
def test_decisions_on_targets_have_their_error_rates(count: int, scatter: float) -> None:
    # Recordings whose RMS is 1: of 2000 intervals of 95 %, 1900 +- 40 (four standard errors) contain it; Cox's interval
    # is approximate, by 2 % for five values.
    generator = np.random.default_rng(count)
    draws = np.exp(scatter * generator.standard_normal((2000, count + 1)) - scatter**2)
    found = [decide_target(row[:-1], 1.0) for row in draws]
    answers = [one.answer for one in found]
    assert 0.93 - 0.02 < answers.count("undecided") / len(found) < 0.97 + 0.02
    # The stated chance of a further recording is the fraction that reaches the target, within four standard errors.
    reached = draws[:, -1] <= 1.0
    assert np.mean([one.chance for one in found]) == pytest.approx(reached.mean(), abs=0.045)
    far = [decide_target(row[:-1], 10.0).answer for row in draws[:100]]
    assert set(far) == {"yes"}
    near = [decide_target(row[:-1], 0.1).answer for row in draws[:100]]
    assert set(near) == {"no"}


def test_a_probability_is_never_stated_as_certain() -> None:
    sure = describe_decision(decide_target((0.10, 0.11, 0.10, 0.09), 1.0), "mm")
    assert sure.startswith("Yes: ")
    assert sure.endswith("with a probability above 99 %")
    assert describe_decision(decide_target((0.10, 0.11, 0.10, 0.09), 0.01), "mm").endswith("a probability below 1 %")
    assert re.search(r"a probability of \d+ %$", describe_decision(decide_target((0.8, 1.1, 0.9), 1.0), "mm"))


def test_targets_without_enough_recordings_are_not_decided() -> None:
    for values in ((), (0.1,), (0.1, float("nan")), (0.0, 0.1)):
        found = decide_target(values, 1.0)
        assert found.answer == "undecided"
        assert np.isnan([found.ci_low, found.ci_high, found.chance]).all()
