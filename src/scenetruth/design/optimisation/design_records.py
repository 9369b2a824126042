"""Records of a design: objectives, constraint values, rigs, sensitivities and prediction intervals."""

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
    "STATISTICS", "ConstraintValue", "DesignSpecError", "Discrepancy", "Objective", "PredictionInterval",
    "RankConsistency", "RigDesign", "RuleOfThumb", "Sensitivity", "Statistic", "StatisticKind", "TargetDecision",
    "compute_predicted_statistic", "compute_prediction_interval", "compute_rig_interval", "decide_rig_target",
    "decide_target", "describe_decision",
]  # fmt: skip


Statistic = Literal["scaled_median_abs_error", "rmse", "p95_abs_error"]


@dataclass(frozen=True)
class StatisticKind:
    """A statistic of errors that is available from simulations and predictions."""

    title: str
    scored: str  # underlying statistic of a score
    factor: float  # from the scored statistic to this statistic
    of_normal: float  # value for normal errors with a standard deviation of 1


STATISTICS: Mapping[str, StatisticKind] = {
    # The median absolute value of a normal error is 0.6745 times its standard deviation.
    "scaled_median_abs_error": StatisticKind(
        STATISTIC_TITLES["scaled_median_abs_error"], "median_abs_error", 1.4826, 1.0
    ),
    "rmse": StatisticKind(STATISTIC_TITLES["rmse"], "rmse", 1.0, 1.0),
    "p95_abs_error": StatisticKind(STATISTIC_TITLES["p95_abs_error"], "p95_abs_error", 1.0, 1.95996),
}
"""Statistics by name. ``scaled_median_abs_error``: 1.4826 times the median absolute error; predicted by the median of
the standard deviations over the region. ``rmse``: predicted by their root mean square. ``p95_abs_error``: predicted for
normal errors with these standard deviations."""

assert set(STATISTICS) == set(get_args(Statistic))


def compute_predicted_statistic(figure: PredictedValue, statistic: Statistic) -> float:
    """Return a predicted statistic, in the units of the report."""
    entries = {"scaled_median_abs_error": figure.value, "rmse": figure.rmse, "p95_abs_error": figure.p95_abs_error}
    return entries[statistic]


@dataclass(frozen=True)
class PredictionInterval:
    """RMS of a statistic over ``seeds`` recordings, with the 95 % prediction interval of one further recording."""

    value: float
    pi_low: float  # NaN with fewer than two valid seeds, as ``pi_high``
    pi_high: float
    seeds: int


@dataclass(frozen=True)
class ConstraintValue:
    """A constraint evaluated for one rig."""

    kind: str  # type: ``field_of_view``, ``motion_blur``, ...
    title: str
    value: float  # of the property, in ``unit``
    limit: float  # bound, in ``unit``
    unit: str
    holds: bool
    margin: float  # distance to the bound relative to it: positive if satisfied, 0 at the bound
    sense: str = "at most"  # or ``"at least"``: type of the bound


@dataclass(frozen=True)
class Objective:
    """An objective: a statistic of errors that is minimised."""

    quantity: str  # key of `scenetruth.scoring.QUANTITIES`
    region: str
    unit: str
    title: str  # unique: the key in ``RigDesign.predicted`` and ``RigDesign.simulated``
    wanted: float | None = None  # target value; None to minimise
    statistic: Statistic = "scaled_median_abs_error"  # key of `STATISTICS`

    @property
    def statistic_title(self) -> str:
        """Title of the statistic."""
        return STATISTICS[self.statistic].title


@dataclass(frozen=True)
class RigDesign:
    """A rig with its parameters, scene, and predicted and simulated statistics.

    ``number``: Index of its evaluation: row of ``DesignResult.screened``.
    ``parameters``: Design variables: values by path, or names of catalogue entries (``lens``, ``camera``, ``stage``).
    ``predicted``, ``simulated``: Statistics by title of the objective; ``simulated`` is empty without simulations.
    ``price``: Sum of the prices of the catalogue entries; None without entries or if a price is missing.
    ``limits``: Description of the limiting factors.
    ``figures``: Simulated values by title of the objective and statistic, one for each seed, NaN where invalid;
      ``density`` is the fraction of the region that is valid. The seeds are the same for all rigs.
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
        """Return the mean simulated density in the region of an objective; NaN without simulations."""
        each = [one for one in self.figures.get(title, {}).get("density", ()) if math.isfinite(one)]
        return sum(each) / len(each) if each else math.nan

    @property
    def is_confirmed(self) -> bool:
        """Whether the rig was simulated."""
        return bool(self.simulated)


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of an objective to a parameter; NaN where not computed.

    ``morris_mu_star``, ``morris_sigma``: Mean absolute value and standard deviation of the elementary effects over the
      whole range (Morris 1991, Campolongo 2007), for the natural logarithm of the objective: 0.7 is a factor of two.
    ``sobol_first``, ``sobol_total``: First-order and total Sobol' index of the logarithm. Estimates from few samples
      may be outside 0 to 1, and the first-order index above the total.
    ``ten_percent``, ``ten_percent_less``: Relative change of the objective of the recommended rig if the parameter is
      increased or decreased by 10 %; -0.09 is 9 % better. NaN for non-numeric choices.
    ``sobol_first_half``, ``sobol_total_half``: Half widths of the 95 % intervals of the indices, by bootstrap.
    ``sobol_samples``: Number of base samples of the indices.
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
    """Comparison of the predicted and simulated rank of two rigs.

    ``better``, ``worse``: Numbers of the rigs with the better and the worse prediction.
    ``predicted``: Ratio of the predictions, worse over better: above 1.
    ``simulated``: The same ratio of simulations, geometric mean over seeds; NaN with fewer than two common valid seeds.
    ``ci_low``, ``ci_high``: 95 % confidence interval of the mean ratio.
    ``seeds``: Number of seeds that are valid for both rigs.
    ``verdict``: ``"kept"`` or ``"swapped"`` if the interval is on one side of 1, else ``"undecided"``.
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
    """A rule of thumb with its text and reference, evaluated for the recommended rig (``here``, ``holds``)."""

    title: str
    source: str
    says: str
    here: str
    holds: bool


@dataclass(frozen=True)
class Discrepancy:
    """Comparison of prediction and simulation of an objective for one rig.

    ``predicted``: Prediction for the simulated images.
    ``ratio``: Simulated over predicted.
    ``notable``: Whether the difference exceeds the uncertainty of the prediction and the interval.
    """

    rig: int
    objective: str
    predicted: float
    simulated: PredictionInterval
    ratio: float
    notable: bool
    says: str


Answer = Literal["yes", "no", "undecided"]


@dataclass(frozen=True)
class TargetDecision:
    """Whether a rig reaches the target of an objective.

    ``answer``: ``"yes"`` or ``"no"`` if the 95 % confidence interval of the RMS over recordings is on one side of the
    target, else ``"undecided"``: more seeds decide, unless the rig is at the target.
    ``ci_low``, ``ci_high``: The interval; NaN with fewer than two valid seeds.
    ``chance``: Probability that a further recording reaches the target; NaN with fewer than two valid seeds.
    ``seeds``: Number of valid seeds.
    """

    answer: Answer
    ci_low: float
    ci_high: float
    chance: float
    seeds: int


_LEVEL = 0.975


def decide_target(values: Sequence[float], target: float) -> TargetDecision:
    """Decide from the values of several recordings whether a target is reached.

    The logarithms are assumed to be normal, with mean m and standard deviation s. The root mean square is then
    exp(m + s²), and the variance of the estimate of its logarithm is s²/n + 2 s⁴/(n - 1) (as by Cox for the mean; see
    Zhou and Gao 1997). The chance of a further recording follows from Student's t for its logarithm.

    >>> found = decide_target([0.9, 1.0, 1.1, 1.0], 1.2)
    >>> found.answer, round(found.ci_low, 2), round(found.ci_high, 2), round(found.chance, 2)
    ('yes', 0.88, 1.15, 0.93)
    """
    from scipy.special import stdtr, stdtrit

    each = np.asarray([one for one in values if math.isfinite(one)], dtype=np.float64)
    count = len(each)
    if count < 2 or not (each > 0).all():
        return TargetDecision("undecided", math.nan, math.nan, math.nan, count)
    logs = np.log(each)
    middle, variance = float(logs.mean()), float(logs.var(ddof=1))
    half = float(stdtrit(count - 1, _LEVEL)) * math.sqrt(variance / count + 2 * variance**2 / (count - 1))
    low, high = (math.exp(min(middle + variance + side * half, 700.0)) for side in (-1, 1))
    away = math.log(target) - middle
    scatter = math.sqrt(variance * (1 + 1 / count))
    chance = float(stdtr(count - 1, away / scatter)) if scatter > 0 else float(away >= 0)
    answer: Answer = "yes" if high <= target else "no" if low > target else "undecided"
    return TargetDecision(answer, low, high, chance, count)


def decide_rig_target(rig: RigDesign, objective: Objective) -> TargetDecision | None:
    """Return the decision on the target of an objective for a simulated rig; None without a target or simulations."""
    if objective.wanted is None or objective.title not in rig.simulated:
        return None
    return decide_target(rig.figures.get(objective.title, {}).get(objective.statistic, ()), objective.wanted)


def describe_decision(found: TargetDecision, unit: str) -> str:
    """Return a decision in words: the answer, the interval, and the chance of a further recording."""
    recordings = "one recording" if found.seeds == 1 else f"{found.seeds} recordings"
    if not math.isfinite(found.ci_low):
        return f"Undecided: {recordings} cannot decide it"
    chance = f"of {100 * found.chance:.0f} %" if 0.01 <= found.chance <= 0.99 else "above 99 %"
    chance = "below 1 %" if found.chance < 0.01 else chance
    further = f"a further recording reaches the target with a probability {chance}"
    if found.answer == "yes":
        return f"Yes: at most {found.ci_high:.3g} {unit} with 95 % confidence; {further}"
    if found.answer == "no":
        return f"No: at least {found.ci_low:.3g} {unit} with 95 % confidence; {further}"
    between = f"{found.ci_low:.3g} to {found.ci_high:.3g} {unit} with 95 % confidence, from {recordings}"
    return f"Undecided: {between}; more seeds decide it. Now {further}"


def compute_rig_interval(rig: RigDesign, title: str, statistic: str) -> PredictionInterval:
    """Return the prediction interval of any simulated statistic of a rig."""
    figures = rig.figures.get(title, {}).get(statistic, ())
    return compute_prediction_interval([one for one in figures if math.isfinite(one)])


def compute_prediction_interval(values: Sequence[float]) -> PredictionInterval:
    """Return the root mean square of values with the 95 % prediction interval of one further value.

    The logarithms are assumed to be normal. The interval is ± t s √(1 + 1/n) about their mean, with Student's t for
    n - 1 degrees of freedom and their standard deviation s.

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
