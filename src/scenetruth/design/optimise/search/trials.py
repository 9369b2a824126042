"""The search by Optuna: it is asked for rigs in batches of one size, and told what they are worth.

A sampler with a seed that is asked and told in the same order asks for the same rigs. With the predictions that are
kept, a search that was killed is thus replayed in seconds, and goes on as if nothing had happened.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

from scenetruth.design.optimise.parts import Objective
from scenetruth.design.optimise.rig.evaluate import Evaluation, sorted_by_worth
from scenetruth.design.optimise.rig.space import Parameter, Space
from scenetruth.design.optimise.search.ledger import Ledger
from scenetruth.design.optimise.search.libraries import library

__all__ = ["search_by_trials"]

_BATCH = 16
_POPULATION = 48
_STARTS = 48
_FAR = 1e3
"""Logarithm of the objectives of what cannot be made; finite, for samplers reckon with it."""
_MOST_TPE = 400
"""Trials of the tree-structured Parzen estimator, whose own time grows with their number."""


def search_by_trials(ledger: Ledger, space: Space, objectives: Sequence[Objective], trials: int, seed: int) -> None:
    """Search for rigs that are good in all objectives and satisfy the constraints.

    One objective is searched by the tree-structured Parzen estimator, and from its 400th trial on by NSGA-II, as
    several are from the first.

    Parameters
    ----------
    ledger
        Where predictions come from, and what was found before: the best of it is where the search starts.
    space, objectives
        What is designed.
    trials
        How many.
    seed
        Of the sampler.
    """
    if trials <= 0:
        return
    first = min(trials, _MOST_TPE) if len(objectives) == 1 else 0
    if first:
        _study(ledger, space, objectives, first, seed, evolving=False)
    if trials > first:
        _study(ledger, space, objectives, trials - first, seed + 1, evolving=True)


def _study(
    ledger: Ledger, space: Space, objectives: Sequence[Objective], trials: int, seed: int, *, evolving: bool
) -> None:
    optuna = library("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        samplers = optuna.samplers
        if evolving:
            sampler = samplers.NSGAIISampler(population_size=_POPULATION, constraints_func=_told_excess, seed=seed)
        else:
            sampler = samplers.TPESampler(
                multivariate=True, constant_liar=True, n_startup_trials=1, constraints_func=_told_excess, seed=seed
            )
        study = optuna.create_study(directions=["minimize"] * len(objectives), sampler=sampler)
        distributions = {one.name: _distribution(optuna, one) for one in space.parameters}
        for one in _starts(ledger.evaluations):
            _enqueue(study, space, one)
        started = min(_STARTS, len(ledger.evaluations))
        left = trials + started
        while left > 0:
            asked = [study.ask(distributions) for _ in range(min(_BATCH, left))]
            points = [[_unit(one, trial.params[one.name]) for one in space.parameters] for trial in asked]
            for trial, found in zip(asked, ledger.ask(points, "search"), strict=True):
                trial.set_user_attr(_EXCESS, found.excess)
                study.tell(trial, [_log(found.predicted[one.title]) for one in objectives])
            left -= len(asked)


_EXCESS = "excess"


def _told_excess(trial: Any) -> tuple[float]:
    return (float(trial.user_attrs[_EXCESS]),)


def _distribution(optuna: Any, parameter: Parameter) -> Any:
    if parameter.choices:
        return optuna.distributions.CategoricalDistribution(list(range(len(parameter.choices))))
    if parameter.levels:
        return optuna.distributions.IntDistribution(0, parameter.levels - 1)
    return optuna.distributions.FloatDistribution(0.0, 1.0)


def _unit(parameter: Parameter, told: float) -> float:
    """Return the number from 0 to 1 that stands for what a sampler says."""
    return (told + 0.5) / parameter.levels if parameter.levels else float(told)


def _enqueue(study: Any, space: Space, one: Evaluation) -> None:
    place = space.point(one.values)
    told = {
        parameter.name: min(int(unit * parameter.levels), parameter.levels - 1)
        if parameter.levels
        else min(max(unit, 0.0), 1.0)
        for parameter, unit in zip(space.parameters, place, strict=True)
    }
    study.enqueue_trial(told)


def _starts(found: Sequence[Evaluation]) -> list[Evaluation]:
    """Return the best rigs so far: what the search starts from."""
    return sorted_by_worth(found)[:_STARTS]


def _log(value: float) -> float:
    return math.log(value) if 0 < value < math.inf else _FAR
