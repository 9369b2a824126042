"""The search: evaluation budget, global search with Optuna, and sensitivity analysis."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.optimisation.design_records import Objective
from scenetruth.design.optimisation.evaluation_log import EvaluationLog
from scenetruth.design.optimisation.rig_evaluation import DesignSpace, Evaluation, Parameter, rank_evaluations
from scenetruth.design.optimisation.specification import SearchSpec
from scenetruth.errors import MachineError, Problem

__all__ = [
    "EvaluationBudget",
    "SensitivityResult",
    "SobolIndices",
    "allocate_evaluations",
    "analyse_sensitivity",
    "require_optional_libraries",
    "search_with_optuna",
]


def import_optional(name: str) -> Any:
    """Return a module of an optional library; raise `MachineError` if it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        message = f"is not installed: pip install 'scenetruth[design]' ({error})"
        raise MachineError([Problem(name.partition(".")[0], message)]) from error


def require_optional_libraries() -> None:
    """Raise `MachineError` unless Optuna and SALib are installed."""
    import_optional("optuna")
    import_optional("SALib.sample.morris")


_EVEN, _DESCENTS = 0.125, 0.5
_LEAST_SEARCHED = 0.08


@dataclass(frozen=True)
class EvaluationBudget:
    """Number of evaluations by phase."""

    even: int  # points of the initial Sobol sequence, a power of two
    descents: int  # of the descents from all choices
    morris: int  # trajectories of the Morris method
    sobol: int  # base samples of Sobol' indices, a power of two; 0 for none
    search: int  # trials of the global search


def allocate_evaluations(search: SearchSpec, parameters: int) -> EvaluationBudget:
    """Return the allocation of evaluations; the search takes precedence over the sensitivity analysis.

    >>> allocate_evaluations(SearchSpec(), 8)
    EvaluationBudget(even=256, descents=1200, morris=10, sobol=64, search=214)
    """
    total = search.predictions
    even = _floor_power_of_two(int(_EVEN * total))
    descents = int(_DESCENTS * total)
    room = total - even - descents - int(_LEAST_SEARCHED * total)
    morris = min(search.morris_trajectories, max(room, 0) // (parameters + 1))
    room -= morris * (parameters + 1)
    # With fewer than eight base samples, the indices are not significant.
    sobol = _floor_power_of_two(min(search.sobol, max(room, 0) // (parameters + 2)))
    sobol = sobol if sobol >= 8 else 0
    used = even + descents + morris * (parameters + 1) + sobol * (parameters + 2)
    return EvaluationBudget(even, descents, morris, sobol, total - used)


def _floor_power_of_two(number: int) -> int:
    """Return the largest power of two that is not above a number; 0 below 1."""
    return 1 << (number.bit_length() - 1) if number >= 1 else 0


_BATCH = 16
_POPULATION = 48
_SEARCH_STARTS = 48
_FAR = 1e3  # log objective of an invalid candidate; finite, as the samplers require
_MOST_TPE = 400  # most trials of the tree-structured Parzen estimator, whose overhead grows with their number


def search_with_optuna(
    ledger: EvaluationLog, space: DesignSpace, objectives: Sequence[Objective], trials: int, seed: int
) -> None:
    """Search for feasible candidates with small objectives.

    A single objective is searched by the tree-structured Parzen estimator for up to 400 trials, then by NSGA-II;
    several objectives by NSGA-II only.
    """
    if trials <= 0:
        return
    first = min(trials, _MOST_TPE) if len(objectives) == 1 else 0
    if first:
        _study(ledger, space, objectives, first, seed, evolving=False)
    if trials > first:
        _study(ledger, space, objectives, trials - first, seed + 1, evolving=True)


def _study(
    ledger: EvaluationLog,
    space: DesignSpace,
    objectives: Sequence[Objective],
    trials: int,
    seed: int,
    *,
    evolving: bool,
) -> None:
    optuna = import_optional("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        samplers = optuna.samplers
        if evolving:
            sampler = samplers.NSGAIISampler(population_size=_POPULATION, constraints_func=_recorded_excess, seed=seed)
        else:
            sampler = samplers.TPESampler(
                multivariate=True, constant_liar=True, n_startup_trials=1, constraints_func=_recorded_excess, seed=seed
            )
        study = optuna.create_study(directions=["minimize"] * len(objectives), sampler=sampler)
        distributions = {one.name: _distribution(optuna, one) for one in space.parameters}
        for one in _search_starts(ledger.evaluations):
            _enqueue(study, space, one)
        started = min(_SEARCH_STARTS, len(ledger.evaluations))
        left = trials + started
        while left > 0:
            asked = [study.ask(distributions) for _ in range(min(_BATCH, left))]
            points = [[_unit(one, trial.params[one.name]) for one in space.parameters] for trial in asked]
            for trial, found in zip(asked, ledger.ask(points, "search"), strict=True):
                trial.set_user_attr(_EXCESS, found.excess)
                study.tell(trial, [_log_objective(found.predicted[one.title]) for one in objectives])
            left -= len(asked)


_EXCESS = "excess"


def _recorded_excess(trial: Any) -> tuple[float]:
    return (float(trial.user_attrs[_EXCESS]),)


def _distribution(optuna: Any, parameter: Parameter) -> Any:
    if parameter.choices:
        return optuna.distributions.CategoricalDistribution(list(range(len(parameter.choices))))
    if parameter.levels:
        return optuna.distributions.IntDistribution(0, parameter.levels - 1)
    return optuna.distributions.FloatDistribution(0.0, 1.0)


def _unit(parameter: Parameter, sampled: float) -> float:
    """Return the coordinate in the unit cube of a sampler's value."""
    return (sampled + 0.5) / parameter.levels if parameter.levels else float(sampled)


def _enqueue(study: Any, space: DesignSpace, one: Evaluation) -> None:
    place = space.point(one.values)
    entries = {
        parameter.name: min(int(unit * parameter.levels), parameter.levels - 1)
        if parameter.levels
        else min(max(unit, 0.0), 1.0)
        for parameter, unit in zip(space.parameters, place, strict=True)
    }
    study.enqueue_trial(entries)


def _search_starts(found: Sequence[Evaluation]) -> list[Evaluation]:
    return rank_evaluations(found)[:_SEARCH_STARTS]


def _log_objective(value: float) -> float:
    return math.log(value) if 0 < value < math.inf else _FAR


Array = NDArray[np.float64]

_LEVELS = 4
_FEWEST = 2
_FEWEST_BASE = 8


@dataclass(frozen=True)
class SobolIndices:
    """First-order and total Sobol' index of a parameter, from ``samples`` valid base samples."""

    first: float
    total: float
    first_half: float  # half widths of the 95 % intervals, by bootstrap of the base samples
    total_half: float
    samples: int


@dataclass(frozen=True)
class SensitivityResult:
    """Sensitivities by title of the objective and name of the parameter."""

    morris: Mapping[tuple[str, str], tuple[float, float]]  # mean absolute elementary effect, and standard deviation
    sobol: Mapping[tuple[str, str], SobolIndices]
    left_out: tuple[float, float]  # fractions of trajectories and base samples with an invalid candidate


def analyse_sensitivity(
    ledger: EvaluationLog, space: DesignSpace, objectives: Sequence[Objective], morris: int, sobol: int, seed: int
) -> SensitivityResult:
    """Return the sensitivities over the whole design space, without blocks with an invalid candidate."""
    problem = {"num_vars": len(space), "names": space.names, "bounds": [[0.0, 1.0]] * len(space)}
    found_morris: dict[tuple[str, str], tuple[float, float]] = {}
    found_sobol: dict[tuple[str, str], SobolIndices] = {}
    left_out = [0.0, 0.0]
    if morris:
        # SALib before 1.6 takes the number 0 for no seed, and a list for a seed.
        points = _quiet(import_optional("SALib.sample.morris").sample, problem, morris, num_levels=_LEVELS, seed=[seed])
        values = ledger.ask(points, "morris")
        left_out[0] = _each(values, objectives, len(space) + 1, points, found_morris, problem, _morris)
    if sobol:
        points = _quiet(
            import_optional("SALib.sample.sobol").sample, problem, sobol, calc_second_order=False, seed=seed
        )
        values = ledger.ask(points, "sobol")
        left_out[1] = _each(values, objectives, len(space) + 2, points, found_sobol, problem, _sobol)
    return SensitivityResult(found_morris, found_sobol, (left_out[0], left_out[1]))


def _each(
    values: Sequence[Evaluation],
    objectives: Sequence[Objective],
    block: int,
    points: Array,
    found: dict[tuple[str, str], Any],
    problem: Mapping[str, Any],
    analysed: Any,
) -> float:
    """Analyse every objective; return the largest fraction of excluded blocks."""
    lost = 0.0
    for one in objectives:
        logs = np.array([_log_finite(each.predicted[one.title]) for each in values])
        whole = np.isfinite(logs).reshape(-1, block).all(axis=1)
        lost = max(lost, 1.0 - float(whole.mean()))
        kept = np.repeat(whole, block)
        if whole.sum() >= _FEWEST:
            for name, entries in zip(problem["names"], analysed(problem, points[kept], logs[kept]), strict=True):
                found[one.title, name] = entries
    return lost


def _morris(problem: Mapping[str, Any], points: Array, logs: Array) -> list[tuple[float, float]]:
    entries = _quiet(
        import_optional("SALib.analyze.morris").analyze, dict(problem), points, logs, num_levels=_LEVELS, seed=[0]
    )
    return [(float(mean), float(scatter)) for mean, scatter in zip(entries["mu_star"], entries["sigma"], strict=True)]


def _sobol(problem: Mapping[str, Any], points: Array, logs: Array) -> list[SobolIndices]:
    samples = len(logs) // (problem["num_vars"] + 2)
    if samples < _FEWEST_BASE or float(logs.std()) < 1e-12:
        return [SobolIndices(math.nan, math.nan, math.nan, math.nan, samples)] * problem["num_vars"]
    entries = _quiet(
        import_optional("SALib.analyze.sobol").analyze, dict(problem), logs, calc_second_order=False, seed=[0]
    )
    each = zip(*(entries[name] for name in ("S1", "ST", "S1_conf", "ST_conf")), strict=True)
    return [
        SobolIndices(float(s1), float(st), float(s1_half), float(st_half), samples) for s1, st, s1_half, st_half in each
    ]


def _quiet(work: Any, *arguments: Any, **named: Any) -> Any:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return work(*arguments, **named)


def _log_finite(value: float) -> float:
    return math.log(value) if 0 < value < math.inf else math.nan
