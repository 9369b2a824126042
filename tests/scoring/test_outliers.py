"""Rates of outliers by their definition, and where they say something."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.scoring.error_pairs import EstimateTruthPair
from scenetruth.scoring.statistics import RATES, meaningful_rates, outlier_rates

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def pairs_of(
    disparity: tuple[Map, Map], flow: tuple[Map, Map], full: Mask | None = None
) -> dict[str, EstimateTruthPair]:
    """Return the pairs of estimates and truths of a disparity (n,) and a flow (2, n)."""
    return {
        "disparity": EstimateTruthPair(*disparity, full),
        "flow_x": EstimateTruthPair(flow[0][0], flow[1][0], full),
        "flow_y": EstimateTruthPair(flow[0][1], flow[1][1], full),
    }


def rates(
    disparity: tuple[float, float], flow: tuple[tuple[float, float], tuple[float, float]]
) -> tuple[float | int | None, ...]:
    """Return the rates of one pixel."""
    result = outlier_rates(
        pairs_of(
            (np.array([disparity[0]]), np.array([disparity[1]])),
            (np.array(flow[0])[:, None], np.array(flow[1])[:, None]),
        )
    )
    assert tuple(result) == RATES
    return tuple(result.values())


STILL = ((0.0, 0.0), (0.0, 0.0))


@pytest.mark.parametrize(
    ("estimate", "truth", "outlier"),
    [
        (43.0, 40.0, 0),  # exactly 3 px
        (43.25, 40.0, 1),  # above 3 px and above 5 %
        (36.75, 40.0, 1),  # the sign does not matter
        (-43.25, -40.0, 1),  # nor that of the truth
        (104.0, 100.0, 0),  # above 3 px, below 5 %
        (84.0, 80.0, 0),  # exactly 5 %
        (42.5, 40.0, 0),  # above 5 %, below 3 px
    ],
)
def test_disparity_is_an_outlier_above_both_thresholds(estimate: float, truth: float, outlier: int) -> None:
    assert rates((estimate, truth), STILL) == (outlier, 0, outlier, 1)


@pytest.mark.parametrize(
    ("estimate", "truth", "outlier"),
    [
        ((33.0, 40.0), (30.0, 40.0), 0),  # endpoint exactly 3 px
        ((33.0, 36.0), (30.0, 40.0), 1),  # endpoint 5 px, length 50 px
        ((63.0, 84.0), (60.0, 80.0), 0),  # endpoint 5 px, exactly 5 %
        ((62.0, 82.0), (60.0, 80.0), 0),  # below both
        ((93.0, 124.0), (90.0, 120.0), 0),  # endpoint 5 px, below 5 %
        ((0.0, 2.0), (0.0, 1.0), 0),  # above 5 %, below 3 px
    ],
)
def test_flow_is_an_outlier_above_both_thresholds(
    estimate: tuple[float, float], truth: tuple[float, float], outlier: int
) -> None:
    assert rates((40.0, 40.0), (estimate, truth)) == (0, outlier, outlier, 1)


def test_scene_flow_is_an_outlier_if_either_is() -> None:
    disparity = np.array([10.0, 20.0, 10.0, 20.0, np.nan])
    flow = np.array([[0.0, 0.0, 9.0, 9.0, 9.0], np.zeros(5)])
    truth = np.full(5, 10.0), np.zeros((2, 5))
    result = outlier_rates(pairs_of((disparity, truth[0]), (flow, truth[1])))
    assert result == {"disparity_rate": 0.5, "flow_rate": 0.5, "scene_flow_rate": 0.75, "count": 4}
    full = np.array([True, False, False, False, True])
    assert outlier_rates(pairs_of((disparity, truth[0]), (flow, truth[1]), full))["count"] == 1


def test_outliers_of_nothing_are_undefined() -> None:
    nothing = np.zeros(1, dtype=bool)
    result = outlier_rates(pairs_of((np.ones(1), np.ones(1)), (np.ones((2, 1)), np.ones((2, 1))), nothing))
    assert result == {"disparity_rate": None, "flow_rate": None, "scene_flow_rate": None, "count": 0}


def test_rates_need_their_own_quantities_only() -> None:
    pairs = pairs_of((np.array([10.0, 20.0]), np.full(2, 10.0)), (np.full((2, 2), np.nan), np.zeros((2, 2))))
    assert outlier_rates(pairs, ["disparity_rate"]) == {"disparity_rate": 0.5, "count": 2}
    assert outlier_rates({"disparity": pairs["disparity"]}, ["disparity_rate"])["count"] == 2
    assert outlier_rates(pairs, ["disparity_rate", "flow_rate"])["count"] == 0


ALIKE = 38.0 + np.linspace(-0.5, 0.5, 40)
APART = np.linspace(5.0, 90.0, 40)
"""True disparities as of the seed paper, and as of a street."""
NO_FLOW = (np.zeros((2, 40)), np.zeros((2, 40)))
EVERYWHERE = np.ones(40, dtype=bool)


def test_rates_say_nothing_where_even_a_guess_has_no_outlier() -> None:
    assert meaningful_rates(pairs_of((ALIKE + 0.01, ALIKE), NO_FLOW), EVERYWHERE) == ()


def test_rates_say_something_where_a_guess_has_outliers() -> None:
    both = meaningful_rates(pairs_of((APART + 0.01, APART), NO_FLOW), EVERYWHERE)
    assert both == ("disparity_rate", "scene_flow_rate")
    flow = np.stack([np.linspace(-8.0, 8.0, 40), np.zeros(40)])
    assert meaningful_rates(pairs_of((ALIKE, ALIKE), (flow, flow)), EVERYWHERE) == ("flow_rate", "scene_flow_rate")


def test_rates_say_something_where_the_estimate_has_outliers() -> None:
    wrong = np.where(np.arange(40) == 7, ALIKE + 9, ALIKE)
    pairs = pairs_of((wrong, ALIKE), NO_FLOW)
    assert meaningful_rates(pairs, EVERYWHERE) == ("disparity_rate", "scene_flow_rate")
    assert meaningful_rates({"disparity": pairs["disparity"]}, EVERYWHERE) == ("disparity_rate",)
    # Neither does a wrong pixel count that is not looked at, nor one that the estimate does not claim to know.
    assert meaningful_rates(pairs, np.arange(40) != 7) == ()
    assert meaningful_rates(pairs_of((wrong, ALIKE), NO_FLOW, np.arange(40) != 7), EVERYWHERE) == ()


def test_estimates_without_disparity_and_flow_have_no_rates() -> None:
    assert meaningful_rates({"depth": EstimateTruthPair(ALIKE, APART)}, EVERYWHERE) == ()
    assert meaningful_rates(pairs_of((APART * np.nan, APART), NO_FLOW), EVERYWHERE) == ()
