"""The parts of a design: objectives, constraints, rigs, figures from simulations, orders, sensitivities, rules."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scenetruth.design.optimise.statistics import STATISTICS, Statistic

__all__ = ["Constraint", "Discrepancy", "Interval", "Objective", "Order", "Rig", "Rule", "Sensitivity"]


@dataclass(frozen=True)
class Interval:
    """A figure from simulations, with the interval in which another recording's figure lies with 95 %.

    Parameters
    ----------
    number
        Root mean square over seeds.
    low, high
        Ends of the interval for one further seed; NaN where fewer than two seeds tell.
    seeds
        How many recordings were simulated.
    """

    number: float
    low: float
    high: float
    seeds: int


@dataclass(frozen=True)
class Constraint:
    """A constraint at one rig.

    Parameters
    ----------
    kind
        Kind of the constraint: ``field_of_view``, ``motion_blur``, ...
    title
        What is bounded, in words.
    value
        What the rig has; in ``unit``.
    limit
        What is allowed; in ``unit``.
    unit
        Unit of ``value`` and ``limit``.
    holds
        Whether the rig is allowed.
    margin
        Share of the limit that is left: positive where it holds, 0 at the limit.
    sense
        ``"at most"`` or ``"at least"``: how ``value`` must lie to ``limit``.
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

    Parameters
    ----------
    quantity
        Key of `scenetruth.scoring.QUANTITIES`.
    region
        Region of the scene: ``all``, ``interior`` or ``object_NAME``.
    unit
        Unit of its figures, for people: growth in % per hour.
    title
        What it is called everywhere else: keys of ``Rig.predicted`` and ``Rig.simulated``.
    wanted
        The figure that is good enough; None to minimise.
    statistic
        Key of `scenetruth.design.optimise.statistics.STATISTICS`: what predictions and simulations are told in.
    """

    quantity: str
    region: str
    unit: str
    title: str
    wanted: float | None = None
    statistic: Statistic = "typical"

    @property
    def told_in(self) -> str:
        """The statistic in words."""
        return STATISTICS[self.statistic].title


@dataclass(frozen=True)
class Rig:
    """A rig: its parameters, its scene, and what it reaches.

    Parameters
    ----------
    number
        Number of the prediction that found it: row of ``Design.screened``.
    parameters
        What was free: values by path, or names of entries by catalogue (``lens``, ``camera``, ``stage``).
    scene
        The scene with it, as plain values, ready to run.
    predicted
        Predicted statistics of errors, by objective's title.
    simulated
        The same statistics of errors against the truth, by objective's title; empty if it was not simulated.
    constraints
        Every constraint of the goal.
    price
        Sum of the prices of what is from catalogues; None if one is not known, or none was chosen.
    limits
        What limits it, in words.
    figures
        All statistics of simulations, by objective's title and statistic: one figure for each seed, NaN where nothing
        was told; ``density`` is the share of the region's pixels that the method tells. The seeds are the same for all
        rigs.
    """

    number: int
    parameters: Mapping[str, Any]
    scene: Mapping[str, Any] = field(repr=False)
    predicted: Mapping[str, float]
    simulated: Mapping[str, Interval]
    constraints: tuple[Constraint, ...]
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

    Parameters
    ----------
    parameter
        Path, or catalogue.
    objective
        Title of the objective.
    morris_mu_star, morris_sigma
        Mean size and scatter of the elementary effects over the whole range (Morris 1991, Campolongo 2007), of the
        natural logarithm of the objective: 0.7 is a factor of two. NaN if not computed.
    sobol_first, sobol_total
        Shares of the logarithm's variance: of the parameter alone, and with all its interactions. NaN if not computed.
        Estimates from few samples may lie outside of 0 to 1, and the first above the total.
    ten_percent, ten_percent_less
        Relative change of the objective at the recommended rig for 10 % more of the parameter, and for 10 % less: -0.09
        is 9 % better. NaN of choices that have no size.
    sobol_first_half, sobol_total_half
        Half widths of the indices' intervals of 95 %, from resampling. NaN if not computed.
    sobol_samples
        Base samples from which the indices are estimated.
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
class Order:
    """Two rigs that were simulated, and whether simulations keep the order that was predicted.

    Parameters
    ----------
    objective
        Title of the objective.
    better, worse
        Numbers of the rigs: which is predicted to be better, which worse.
    predicted
        Prediction of the worse one over that of the better one: above 1.
    simulated
        The same of simulations, geometric mean over seeds; NaN if fewer than two seeds tell both.
    low, high
        Interval of that mean, 95 %.
    seeds
        How many seeds tell both.
    verdict
        ``"kept"`` or ``"swapped"`` if the interval is on one side of 1, else ``"cannot be told"``.
    """

    objective: str
    better: int
    worse: int
    predicted: float
    simulated: float
    low: float
    high: float
    seeds: int
    verdict: str


@dataclass(frozen=True)
class Rule:
    """A rule of thumb of the field, and whether the recommended rig keeps it.

    Parameters
    ----------
    title
        What it is about.
    source
        Who says so.
    says
        The rule in words.
    here
        What the recommended rig has, in words with its unit.
    holds
        Whether it is kept.
    """

    title: str
    source: str
    says: str
    here: str
    holds: bool


@dataclass(frozen=True)
class Discrepancy:
    """Prediction beside simulation at one rig.

    Parameters
    ----------
    rig
        Number of the rig.
    objective
        Title of the objective.
    predicted
        What is predicted of the images that were simulated: the objective's statistic.
    simulated
        What it is compared with: ``Rig.simulated``.
    ratio
        Simulated over predicted.
    notable
        Whether the two differ by more than the prediction claims to know, and the interval allows.
    says
        That in words.
    """

    rig: int
    objective: str
    predicted: float
    simulated: Interval
    ratio: float
    notable: bool
    says: str
