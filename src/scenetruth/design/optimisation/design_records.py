"""Records of a design.

Objectives, constraint values, rigs, sensitivities, prediction intervals, and the error of a specification.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from scenetruth.design.prediction import PredictedValue
from scenetruth.errors import DesignSpecError
from scenetruth.scoring.statistics import STATISTIC_TITLES

__all__ = [
    "STATISTICS",
    "ConstraintValue",
    "DesignSpecError",
    "Discrepancy",
    "Objective",
    "PredictionInterval",
    "RankConsistency",
    "RigDesign",
    "RuleOfThumb",
    "Sensitivity",
    "Statistic",
    "StatisticKind",
    "compute_predicted_statistic",
    "compute_prediction_interval",
    "compute_rig_interval",
]


"""What an objective may be of; see `STATISTICS`."""


Statistic = Literal["scaled_median_abs_error", "rmse", "p95_abs_error"]


@dataclass(frozen=True)
class StatisticKind:
    """A statistic of errors that simulations and predictions both tell.

    ``title``: What it is, in words.
    ``scored``: The statistic of a score that it is taken from.
    ``factor``: What that is multiplied with.
    ``of_normal``: What it is of normal errors with a standard deviation of 1.
    """

    title: str
    scored: str
    factor: float
    of_normal: float


STATISTICS: Mapping[str, StatisticKind] = {
    # The median of a normal error's size is 0.6745 of its standard deviation.
    "scaled_median_abs_error": StatisticKind(
        STATISTIC_TITLES["scaled_median_abs_error"], "median_abs_error", 1.4826, 1.0
    ),
    "rmse": StatisticKind(STATISTIC_TITLES["rmse"], "rmse", 1.0, 1.0),
    "p95_abs_error": StatisticKind(STATISTIC_TITLES["p95_abs_error"], "p95_abs_error", 1.0, 1.95996),
}
"""By name. ``scaled_median_abs_error``: 1.4826 times the median of the errors' sizes, the standard deviation of normal
errors with that median; predicted by the median of standard deviations over the region. ``rmse``: predicted by the
root of their mean square. ``p95_abs_error``: predicted for normal errors with these standard deviations."""

assert set(STATISTICS) == set(get_args(Statistic))


def compute_predicted_statistic(figure: PredictedValue, statistic: Statistic) -> float:
    """Return what a prediction says of a statistic, in units for people."""
    told = {"scaled_median_abs_error": figure.value, "rmse": figure.rmse, "p95_abs_error": figure.p95_abs_error}
    return told[statistic]


@dataclass(frozen=True)
class PredictionInterval:
    """A figure from simulations, with the interval in which another recording's figure lies with 95 %.

    ``value``: Root mean square over seeds.
    ``pi_low``, ``pi_high``: Ends of the interval for one further seed; NaN where fewer than two seeds tell.
    ``seeds``: How many recordings were simulated.
    """

    value: float
    pi_low: float
    pi_high: float
    seeds: int


@dataclass(frozen=True)
class ConstraintValue:
    """A constraint at one rig.

    ``kind``: Kind of the constraint: ``field_of_view``, ``motion_blur``, ...
    ``title``: What is bounded, in words.
    ``value``: What the rig has; in ``unit``.
    ``limit``: What is allowed; in ``unit``.
    ``unit``: Unit of ``value`` and ``limit``.
    ``holds``: Whether the rig is allowed.
    ``margin``: Share of the limit that is left: positive where it holds, 0 at the limit.
    ``sense``: ``"at most"`` or ``"at least"``: how ``value`` must lie to ``limit``.
    """

    kind: str
    title: str
    value: float
    limit: float
    unit: str
    holds: bool
    margin: float
    sense: str = "at most"


@dataclass(frozen=True)
class Objective:
    """What is to be known precisely: a statistic of errors that is to be small.

    ``quantity``: Key of `scenetruth.scoring.QUANTITIES`.
    ``region``: Region of the scene: ``all``, ``interior`` or ``object_NAME``.
    ``unit``: Unit of its figures, for people: growth in % per hour.
    ``title``: What it is called everywhere else: keys of ``RigDesign.predicted`` and ``RigDesign.simulated``.
    ``wanted``: The figure that is good enough; None to minimise.
    ``statistic``: Key of `scenetruth.design.optimisation.design_records.STATISTICS`: what predictions and simulations
      are told in.
    """

    quantity: str
    region: str
    unit: str
    title: str
    wanted: float | None = None
    statistic: Statistic = "scaled_median_abs_error"

    @property
    def told_in(self) -> str:
        """The statistic in words."""
        return STATISTICS[self.statistic].title


@dataclass(frozen=True)
class RigDesign:
    """A rig: its parameters, its scene, and what it reaches.

    ``number``: Number of the prediction that found it: row of ``DesignResult.screened``.
    ``parameters``: Design variables: values by path, or names of entries by catalogue (``lens``, ``camera``,
      ``stage``).
    ``scene``: The scene with it, as plain values, ready to run.
    ``predicted``: Predicted statistics of errors, by objective's title.
    ``simulated``: The same statistics of errors against the truth, by objective's title; empty if it was not simulated.
    ``constraints``: Every constraint of the design specification.
    ``price``: Sum of the prices of what is from catalogues; None if one is not known, or none was chosen.
    ``limits``: What limits it, in words.
    ``figures``: All statistics of simulations, by objective's title and statistic: one figure for each seed, NaN where
      nothing was told; ``density`` is the share of the region's pixels that the method tells. The seeds are the same
      for all rigs.
    """

    number: int
    parameters: Mapping[str, Any]
    scene: Mapping[str, Any] = field(repr=False)
    predicted: Mapping[str, float]
    simulated: Mapping[str, PredictionInterval]
    constraints: tuple[ConstraintValue, ...]
    price: float | None
    limits: str
    figures: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict, repr=False)

    def density(self, title: str) -> float:
        """Return the share of an objective's region that simulations tell, in the mean; NaN if there are none."""
        each = [one for one in self.figures.get(title, {}).get("density", ()) if math.isfinite(one)]
        return sum(each) / len(each) if each else math.nan

    @property
    def is_confirmed(self) -> bool:
        """Whether it was simulated."""
        return bool(self.simulated)


@dataclass(frozen=True)
class Sensitivity:
    """What a parameter does to an objective.

    ``parameter``: Path, or catalogue.
    ``objective``: Title of the objective.
    ``morris_mu_star``, ``morris_sigma``: Mean size and scatter of the elementary effects over the whole range (Morris
      1991, Campolongo 2007), of the natural logarithm of the objective: 0.7 is a factor of two. NaN if not computed.
    ``sobol_first``, ``sobol_total``: Shares of the logarithm's variance: of the parameter alone, and with all its
      interactions. NaN if not computed. Estimates from few samples may lie outside of 0 to 1, and the first above the
      total.
    ``ten_percent``, ``ten_percent_less``: Relative change of the objective at the recommended rig for 10 % more of the
      parameter, and for 10 % less: -0.09 is 9 % better. NaN of choices that have no size.
    ``sobol_first_half``, ``sobol_total_half``: Half widths of the indices' intervals of 95 %, from resampling. NaN if
      not computed.
    ``sobol_samples``: Base samples from which the indices are estimated.
    """

    parameter: str
    objective: str
    morris_mu_star: float
    morris_sigma: float
    sobol_first: float
    sobol_total: float
    ten_percent: float
    ten_percent_less: float = math.nan
    sobol_first_half: float = math.nan
    sobol_total_half: float = math.nan
    sobol_samples: int = 0


@dataclass(frozen=True)
class RankConsistency:
    """Two rigs that were simulated, and whether simulations keep the order that was predicted.

    ``objective``: Title of the objective.
    ``better``, ``worse``: Numbers of the rigs: which is predicted to be better, which worse.
    ``predicted``: Prediction of the worse one over that of the better one: above 1.
    ``simulated``: The same of simulations, geometric mean over seeds; NaN if fewer than two seeds tell both.
    ``ci_low``, ``ci_high``: Interval of that mean, 95 %.
    ``seeds``: How many seeds tell both.
    ``verdict``: ``"kept"`` or ``"swapped"`` if the interval is on one side of 1, else ``"cannot be told"``.
    """

    objective: str
    better: int
    worse: int
    predicted: float
    simulated: float
    ci_low: float
    ci_high: float
    seeds: int
    verdict: str


@dataclass(frozen=True)
class RuleOfThumb:
    """A rule of thumb of the field, and whether the recommended rig keeps it.

    ``title``: What it is about.
    ``source``: Who says so.
    ``says``: The rule in words.
    ``here``: What the recommended rig has, in words with its unit.
    ``holds``: Whether it is kept.
    """

    title: str
    source: str
    says: str
    here: str
    holds: bool


@dataclass(frozen=True)
class Discrepancy:
    """Prediction beside simulation at one rig.

    ``rig``: Number of the rig.
    ``objective``: Title of the objective.
    ``predicted``: What is predicted of the images that were simulated: the objective's statistic.
    ``simulated``: What it is compared with: ``RigDesign.simulated``.
    ``ratio``: Simulated over predicted.
    ``notable``: Whether the two differ by more than the prediction claims to know, and the interval allows.
    ``says``: That in words.
    """

    rig: int
    objective: str
    predicted: float
    simulated: PredictionInterval
    ratio: float
    notable: bool
    says: str


_LEVEL = 0.975


def compute_rig_interval(rig: RigDesign, title: str, statistic: str) -> PredictionInterval:
    """Return what simulations say of any statistic of a rig."""
    figures = rig.figures.get(title, {}).get(statistic, ())
    return compute_prediction_interval([one for one in figures if math.isfinite(one)])


def compute_prediction_interval(values: Sequence[float]) -> PredictionInterval:
    """Return the root mean square of figures, and the interval of one further figure with 95 %.

    Logarithms of figures are taken for normal. The next of them lies within t s √(1 + 1/n) of their mean, with
    Student's t of n - 1 degrees of freedom and their standard deviation s.

    >>> found = compute_prediction_interval([0.9, 1.0, 1.1, 1.0])
    >>> round(found.value, 3), round(found.pi_low, 2), round(found.pi_high, 2), found.seeds
    (1.002, 0.75, 1.34, 4)
    """
    from scipy.special import stdtrit

    each = np.asarray(values, dtype=np.float64)
    count = len(each)
    if not count:
        return PredictionInterval(math.nan, math.nan, math.nan, 0)
    number = float(np.sqrt(np.mean(each**2)))
    if count < 2 or not (each > 0).all():
        return PredictionInterval(number, math.nan, math.nan, count)
    logs = np.log(each)
    half = float(stdtrit(count - 1, _LEVEL) * logs.std(ddof=1) * math.sqrt(1 + 1 / count))
    middle = float(logs.mean())
    return PredictionInterval(number, math.exp(middle - half), math.exp(min(middle + half, 700.0)), count)
