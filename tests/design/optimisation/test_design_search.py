"""The search, on problems whose answers are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.design.optimisation import (
    DesignSpace,
    Evaluation,
    Parameter,
    SearchSpec,
    add_alternatives,
    allocate_evaluations,
    analyse_sensitivity,
    descend_from_choices,
    find_pareto_front,
    search_with_optuna,
    select_distinguishable,
    select_recommended,
    thin_front,
)
from tests.helpers.small_specification import Formula, constraint, objective, square

TWO = (objective("a"), objective("b"))


def spring(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
    """A valley along x0 + x1, cut off where their sum passes 1.2: least at x0 = x1 = 0.6, of the third kind."""
    x, y, kind = values["x"], values["y"], values["kind"]
    return {"depth": math.exp(4 * (x - y) ** 2 - 2 * (x + y) - 0.5 * (kind == "c"))}, [1.2 - x - y]


def springs() -> Formula:
    choice = Parameter("kind", choices=("a", "b", "c"))
    return Formula(DesignSpace((Parameter("x"), Parameter("y"), choice)), spring)


def test_the_best_within_constraints_is_found() -> None:
    ledger = springs()
    ledger.ask(np.random.default_rng(0).random((16, 3)).tolist(), "even")
    descend_from_choices(ledger, ledger.space, (objective(),), 160, 0)  # type: ignore[arg-type]
    search_with_optuna(ledger, ledger.space, (objective(),), 64, 0)  # type: ignore[arg-type]
    best = ledger.evaluations[find_pareto_front(ledger.evaluations, (objective(),))[0]]
    assert best.values["kind"] == "c"
    # The least value is exp(-2.4 - 0.5); 160 rigs of descents come within 1 % of it.
    assert best.predicted["depth"] == pytest.approx(math.exp(-2.9), rel=0.01)
    random = [spring(ledger.space.values(point)) for point in np.random.default_rng(1).random((200, 3))]
    assert best.predicted["depth"] <= min(told["depth"] for told, (margin,) in random if margin >= 0)


def test_a_search_is_repeated_to_the_last_rig() -> None:
    found = []
    for _ in range(2):
        ledger = springs()
        ledger.ask(np.random.default_rng(0).random((16, 3)).tolist(), "even")
        search_with_optuna(ledger, ledger.space, (objective(),), 32, 5)  # type: ignore[arg-type]
        found.append([one.values for one in ledger.evaluations])
    assert found[0] == found[1]
    assert len(found[0]) > 30


def circle(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
    """Two distances: whatever lies between the two points is on the front."""
    x, y = values["x0"], values["x1"]
    return {"a": math.hypot(x - 0.2, y - 0.5) + 0.1, "b": math.hypot(x - 0.8, y - 0.5) + 0.1}, []


def test_the_front_of_two_objectives() -> None:
    ledger = Formula(square(2), circle)
    ledger.ask(np.random.default_rng(0).random((48, 2)).tolist(), "even")
    descend_from_choices(ledger, ledger.space, TWO, 150, 0)  # type: ignore[arg-type]
    search_with_optuna(ledger, ledger.space, TWO, 144, 0)  # type: ignore[arg-type]
    told = [ledger.evaluations[number].predicted for number in find_pareto_front(ledger.evaluations, TWO)]
    assert len(told) >= 8
    # On the line between the points, the sum of both is 0.8; off it by a twentieth at most.
    assert np.median([one["a"] + one["b"] for one in told]) < 0.84
    # The ends of the front are the points themselves, to a few steps.
    assert min(one["a"] for one in told) < 0.13
    assert min(one["b"] for one in told) < 0.13


@given(some.lists(some.tuples(some.integers(1, 9), some.integers(1, 9), some.booleans()), min_size=1, max_size=30))
def test_fronts_hold_what_nothing_beats(figures: list[tuple[int, int, bool]]) -> None:
    found = [
        Evaluation({"x0": n, "x1": 0.5}, {"a": float(a), "b": float(b)}, {}, (constraint(0.1 if holds else -0.1),))
        for n, (a, b, holds) in enumerate(figures)
    ]
    front = find_pareto_front(found, TWO)
    held = [(a, b) for a, b, holds in figures if holds]
    least = {(a, b) for a, b in held if not any((c <= a and d <= b) and (c, d) != (a, b) for c, d in held)}
    assert {figures[number][:2] for number in front} == least
    assert [figures[number][0] for number in front] == sorted(figures[number][0] for number in front)
    # Of rigs that are alike, one is told.
    assert len(front) == len(least)


def test_alternatives_of_one_objective_differ() -> None:
    ledger = springs()
    ledger.ask(np.random.default_rng(0).random((200, 3)).tolist(), "even")
    found = ledger.evaluations
    best = find_pareto_front(found, (objective(),))
    assert len(best) == 1
    front = [found[number] for number in add_alternatives(found, (objective(),), ledger.space, best)]
    assert 1 < len(front) <= 6
    figures = [one.predicted["depth"] for one in front]
    assert figures == sorted(figures)
    assert figures[-1] <= 3 * figures[0]
    for number, one in enumerate(front):
        for other in front[:number]:
            near = all(abs(one.values[name] - other.values[name]) <= 0.2 for name in ("x", "y"))
            assert not near or one.values["kind"] != other.values["kind"]


def test_which_rig_is_recommended() -> None:
    figures = [{"a": 1.0, "b": 9.0}, {"a": 2.0, "b": 3.0}, {"a": 5.0, "b": 2.0}, {"a": math.nan, "b": 1.9}]
    # Beside the best of each, 1 and 1.9 (the last one is told in b): factors 4.7, 2, 5.
    assert select_recommended(figures, TWO) == 1
    # What is wanted counts instead.
    assert select_recommended(figures, (objective("a", 0.1), objective("b", 9.0))) == 0
    # A hundredth of the worst factor is nothing, where the other is far better.
    assert select_recommended([{"a": 1.0, "b": 4.0}, {"a": 1.01, "b": 1.0}], (objective("a"), objective("b", 8.0))) == 1
    assert select_recommended([{"a": 1.0, "b": 4.0}, {"a": 1.2, "b": 1.0}], (objective("a"), objective("b", 8.0))) == 0


def test_a_thinned_front_keeps_its_ends_and_lies_evenly() -> None:
    line = np.stack([np.linspace(0, 1, 101), np.linspace(1, 0, 101)], axis=1)
    assert set(thin_front(line, 5, 50)) == {0, 25, 50, 75, 100}
    assert thin_front(line[:3], 9, 1)[0] == 1
    assert sorted(thin_front(line[:3], 9, 1)) == [0, 1, 2]


def test_rigs_to_simulate_are_far_enough_apart_to_be_told() -> None:
    # Logarithms: three of the front within a tenth of each other, and one beyond; two alternatives.
    front = [[0.0, 0.0], [0.05, -0.02], [-0.05, 0.02], [0.6, -0.1]]
    behind = [[0.02, 0.03], [0.4, 0.5]]
    rigs = np.array(front + behind)
    # The front's that is apart, then the alternative that is apart, then the others of the front, the farthest first.
    assert select_distinguishable(rigs, 4, 2) == [0, 3]
    assert select_distinguishable(rigs, 4, 3) == [0, 3, 5]
    assert select_distinguishable(rigs, 4, 5) == [0, 3, 5, 1, 2]
    assert select_distinguishable(rigs, 4, 9) == [0, 3, 5, 1, 2, 4]
    assert select_distinguishable(rigs, 4, 0) == []
    # One objective: the best, what is apart from it, then the next best.
    assert select_distinguishable(np.array([[0.0], [0.02], [0.1], [0.3]]), 1, 3) == [0, 3, 1]


def planes(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
    """A plane in the logarithm: its elementary effects and variances are known."""
    return {
        "a": math.exp(3 * values["x0"] + values["x1"] + 0.0 * values["x2"]),
        "b": math.exp(values["x0"] * values["x1"]),
    }, []


def test_effects_of_planes_and_products() -> None:
    ledger = Formula(square(3), planes)
    found = analyse_sensitivity(ledger, ledger.space, TWO, 8, 256, 0)  # type: ignore[arg-type]
    assert found.left_out == (0.0, 0.0)
    # Values have four digits, which elementary effects show.
    for name, slope in (("x0", 3.0), ("x1", 1.0), ("x2", 0.0)):
        mean, scatter = found.morris["a", name]
        assert mean == pytest.approx(slope, abs=2e-3)
        assert scatter == pytest.approx(0.0, abs=3e-3)
        # Shares of the variance: 9, 1 and 0 of 10. 256 samples know them to a few hundredths.
        told = found.sobol["a", name]
        assert (told.first, told.total) == pytest.approx((slope**2 / 10, slope**2 / 10), abs=0.05)
        assert told.samples == 256
    # Of x y, each alone has 3/7 of the variance, both together 1/7 (I. M. Sobol', 1993).
    told = found.sobol["b", "x0"]
    assert (told.first, told.total) == pytest.approx((3 / 7, 4 / 7), abs=0.07)
    assert found.morris["b", "x0"][1] > 0.1


def test_the_same_seed_gives_the_same_effects() -> None:
    def torn(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
        """Return effects that depend on the place, so that another trajectory has others."""
        return {"a": math.exp(math.sin(9 * values["x0"]) + values["x1"] ** 3), "b": math.exp(values["x2"] ** 2)}, []

    found = [analyse_sensitivity(Formula(square(3), torn), square(3), TWO, 4, 16, 0) for _ in range(2)]  # type: ignore[arg-type]
    assert found[0] == found[1]


def test_indices_from_few_samples_lie_within_their_intervals() -> None:
    inside, halves = [], {16: [], 64: []}  # type: ignore[var-annotated]
    for samples, several in halves.items():
        for seed in range(12):
            ledger = Formula(square(3), planes)
            found = analyse_sensitivity(ledger, ledger.space, TWO[1:], 0, samples, seed)  # type: ignore[arg-type]
            for name, first, total in (("x0", 3 / 7, 4 / 7), ("x1", 3 / 7, 4 / 7), ("x2", 0.0, 0.0)):
                told = found.sobol["b", name]
                inside += [abs(told.first - first) <= told.first_half + 1e-9]
                inside += [abs(told.total - total) <= told.total_half + 1e-9]
                several.append(told.first_half)
    # Resampled intervals of 95 % are a little short with so few samples.
    assert np.mean(inside) > 0.85
    # Four times the samples, half the width.
    assert np.mean(halves[16]) / np.mean(halves[64]) == pytest.approx(2.0, rel=0.3)


def test_effects_leave_out_what_cannot_be_made() -> None:
    def torn(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
        told, _ = planes(values)
        return {title: math.inf if values["x0"] > 0.9 else value for title, value in told.items()}, []

    ledger = Formula(square(3), torn)
    found = analyse_sensitivity(ledger, ledger.space, TWO, 24, 64, 0)  # type: ignore[arg-type]
    assert 0 < found.left_out[0] < 1
    assert 0 < found.left_out[1] < 0.6
    assert found.morris["a", "x1"][0] == pytest.approx(1.0, abs=2e-3)


@given(some.integers(16, 20_000), some.integers(0, 50), some.integers(0, 1024), some.integers(1, 20))
def test_no_more_predictions_than_asked_for(total: int, morris: int, sobol: int, parameters: int) -> None:
    shares = allocate_evaluations(SearchSpec(predictions=total, morris_trajectories=morris, sobol=sobol), parameters)
    used = shares.even + shares.descents + shares.search
    used += shares.morris * (parameters + 1) + shares.sobol * (parameters + 2)
    assert used == total
    assert shares.search >= 0.05 * total - 1
    assert shares.morris <= morris
    assert shares.sobol <= sobol
