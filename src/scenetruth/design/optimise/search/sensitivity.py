"""What parameters do: elementary effects of Morris and indices of Sobol', on the logarithm of objectives."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.optimise.parts import Objective
from scenetruth.design.optimise.rig.evaluate import Evaluation
from scenetruth.design.optimise.rig.space import Space
from scenetruth.design.optimise.search.ledger import Ledger
from scenetruth.design.optimise.search.libraries import library

__all__ = ["Effects", "SobolIndices", "effects_of"]

Array = NDArray[np.float64]

_LEVELS = 4
_FEWEST = 2
_FEWEST_BASE = 8


@dataclass(frozen=True)
class SobolIndices:
    """Sobol' indices of a parameter.

    Parameters
    ----------
    first, total
        Of the parameter alone, and with all its interactions.
    first_half, total_half
        Half widths of their intervals of 95 %, from resampling the base samples.
    samples
        Base samples that tell.
    """

    first: float
    total: float
    first_half: float
    total_half: float
    samples: int


@dataclass(frozen=True)
class Effects:
    """What sensitivity analyses say, by objective's title and parameter's name.

    Parameters
    ----------
    morris
        Mean size and scatter of elementary effects.
    sobol
        Sobol' indices.
    left_out
        Share of the trajectories and of the base samples that held a rig that cannot be made.
    """

    morris: Mapping[tuple[str, str], tuple[float, float]]
    sobol: Mapping[tuple[str, str], SobolIndices]
    left_out: tuple[float, float]


def effects_of(
    ledger: Ledger, space: Space, objectives: Sequence[Objective], morris: int, sobol: int, seed: int
) -> Effects:
    """Return what parameters do to objectives, over their whole ranges and without regard to constraints.

    Trajectories and base samples that hold a rig that cannot be made are left out.

    Parameters
    ----------
    ledger
        Where predictions come from.
    space, objectives
        What is designed.
    morris
        Trajectories of Morris' method, 0 for none.
    sobol
        Base samples of Sobol' indices, a power of two; 0 for none.
    seed
        Of the samples.
    """
    problem = {"num_vars": len(space), "names": space.names, "bounds": [[0.0, 1.0]] * len(space)}
    found_morris: dict[tuple[str, str], tuple[float, float]] = {}
    found_sobol: dict[tuple[str, str], SobolIndices] = {}
    left_out = [0.0, 0.0]
    if morris:
        points = _quiet(library("SALib.sample.morris").sample, problem, morris, num_levels=_LEVELS, seed=seed)
        values = ledger.ask(points, "morris")
        left_out[0] = _each(values, objectives, len(space) + 1, points, found_morris, problem, _morris)
    if sobol:
        points = _quiet(library("SALib.sample.sobol").sample, problem, sobol, calc_second_order=False, seed=seed)
        values = ledger.ask(points, "sobol")
        left_out[1] = _each(values, objectives, len(space) + 2, points, found_sobol, problem, _sobol)
    return Effects(found_morris, found_sobol, (left_out[0], left_out[1]))


def _each(
    values: Sequence[Evaluation],
    objectives: Sequence[Objective],
    block: int,
    points: Array,
    found: dict[tuple[str, str], Any],
    problem: Mapping[str, Any],
    analysed: Any,
) -> float:
    """Analyse every objective; return the largest share of blocks that were left out."""
    lost = 0.0
    for one in objectives:
        logs = np.array([_log(each.predicted[one.title]) for each in values])
        whole = np.isfinite(logs).reshape(-1, block).all(axis=1)
        lost = max(lost, 1.0 - float(whole.mean()))
        kept = np.repeat(whole, block)
        if whole.sum() >= _FEWEST:
            for name, told in zip(problem["names"], analysed(problem, points[kept], logs[kept]), strict=True):
                found[one.title, name] = told
    return lost


def _morris(problem: Mapping[str, Any], points: Array, logs: Array) -> list[tuple[float, float]]:
    told = _quiet(library("SALib.analyze.morris").analyze, dict(problem), points, logs, num_levels=_LEVELS, seed=0)
    return [(float(mean), float(scatter)) for mean, scatter in zip(told["mu_star"], told["sigma"], strict=True)]


def _sobol(problem: Mapping[str, Any], points: Array, logs: Array) -> list[SobolIndices]:
    samples = len(logs) // (problem["num_vars"] + 2)
    if samples < _FEWEST_BASE or float(logs.std()) < 1e-12:
        return [SobolIndices(math.nan, math.nan, math.nan, math.nan, samples)] * problem["num_vars"]
    told = _quiet(library("SALib.analyze.sobol").analyze, dict(problem), logs, calc_second_order=False, seed=0)
    each = zip(*(told[name] for name in ("S1", "ST", "S1_conf", "ST_conf")), strict=True)
    return [
        SobolIndices(float(s1), float(st), float(s1_half), float(st_half), samples) for s1, st, s1_half, st_half in each
    ]


def _quiet(work: Any, *arguments: Any, **named: Any) -> Any:
    """Call a library that warns of what is no concern of ours."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return work(*arguments, **named)


def _log(value: float) -> float:
    return math.log(value) if 0 < value < math.inf else math.nan
