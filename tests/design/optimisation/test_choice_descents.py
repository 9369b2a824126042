"""Descents from all choices, on problems whose answers are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from scenetruth.design.optimisation import (
    DesignSpace,
    Parameter,
    descend_from_choices,
    find_pareto_front,
    search_with_optuna,
)
from tests.helpers.nightly import nightly
from tests.helpers.rig_formula import CHOICES, leaf_rig, rig_space
from tests.helpers.small_specification import Formula, objective

ONE = (objective("a"),)
TWO = (objective("a"), objective("b"))


def trap(values: dict[str, Any]) -> tuple[dict[str, float], list[float]]:
    """Powers of three variables: lens "b" is the best by a factor of 2, but at another place than the others.

    With x y at most the bound of the lens, 1 / (x y^2) is least for the largest y, and x = bound / y: 1 / (10 bound).
    """
    x, y = values["x"], values["y"]
    bound, low = {"a": (1.0, 0.05), "b": (2.0, 0.18), "c": (0.9, 0.05)}[values["lens"]]
    return {"a": 1 / (x * y**2)}, [1 - x * y / bound, (x - low) / low]


def traps() -> Formula:
    lens = Parameter("lens", choices=("a", "b", "c"))
    return Formula(
        DesignSpace((lens, Parameter("x", 0.01, 10, logarithmic=True), Parameter("y", 0.01, 10, logarithmic=True))),
        trap,
    )


@pytest.mark.parametrize("seed", range(5))
def test_another_choice_is_found_with_all_that_it_needs(seed: int) -> None:
    ledger = traps()
    ledger.ask(np.random.default_rng(seed).random((8, 3)).tolist(), "even")
    assert descend_from_choices(ledger, ledger.space, ONE, 300, seed)  # type: ignore[arg-type]
    best = ledger.evaluations[find_pareto_front(ledger.evaluations, ONE)[0]]
    assert best.values["lens"] == "b"
    # Values have four digits, and steps end at a radius of 0.003 of a range of three decades: 2 %.
    assert best.predicted["a"] == pytest.approx(1 / 20, rel=0.02)


def test_searches_take_no_more_rigs_than_asked_for_and_are_repeated() -> None:
    for count in (0, 3, 20, 90):
        found = []
        for _ in range(2):
            ledger = traps()
            ledger.ask(np.random.default_rng(0).random((8, 3)).tolist(), "even")
            confirmed = descend_from_choices(ledger, ledger.space, ONE, count, 7)  # type: ignore[arg-type]
            found.append([one.values for one in ledger.evaluations])
            assert len(ledger) <= 8 + count
            # With so few, nothing is confirmed.
            assert not confirmed or count == 90
        assert found[0] == found[1]


def product(ledger: Formula) -> float:
    """Return the least root of the product of both objectives within the constraints."""
    held = [one.predicted for one in ledger.evaluations if one.holds]
    return min((math.sqrt(one["a"] * one["b"]) for one in held), default=math.inf)


@nightly
def test_the_best_rig_does_not_depend_on_the_seed() -> None:
    # The best of every choice by another algorithm: differential evolution with a penalty.
    space = rig_space()

    def penalised(place: Any, choice: tuple[str, str, str]) -> float:
        values = dict(zip(("lens", "camera", "stage"), choice, strict=True))
        values |= {one.name: one.value(float(unit)) for one, unit in zip(space.parameters[3:], place, strict=True)}
        predicted, margins = leaf_rig(values)
        over = sum(min(-margin, 10.0) for margin in margins if margin < 0)
        return 0.5 * math.log(predicted["a"] * predicted["b"]) + 20 * over

    ends = [
        differential_evolution(penalised, [(0.0, 0.999)] * 5, args=(choice,), seed=0, maxiter=80, polish=False).fun
        for choice in CHOICES
    ]
    best = math.exp(min(ends))
    former, found = [], []
    for seed in range(12):
        ledger = Formula(space, leaf_rig)
        ledger.ask(qmc.Sobol(8, seed=np.random.default_rng(seed)).random(256).tolist(), "even")
        descend_from_choices(ledger, space, TWO, 1200, seed)  # type: ignore[arg-type]
        found.append(product(ledger) / best)
        ledger = Formula(space, leaf_rig)
        ledger.ask(qmc.Sobol(8, seed=np.random.default_rng(seed)).random(256).tolist(), "even")
        search_with_optuna(ledger, space, TWO, 1200, seed)  # type: ignore[arg-type]
        former.append(product(ledger) / best)
    print(f"over the best: descents {np.sort(found).round(3)}, NSGA-II {np.sort(former).round(2)}")
    assert min(found) > 0.99
    # Of twelve seeds, nine come within 3 %; the evolution alone comes no nearer than 10 % in any.
    assert np.sort(found)[8] < 1.03
    assert min(former) > 1.1
