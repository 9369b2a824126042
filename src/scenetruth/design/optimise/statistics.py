"""The statistics that objectives may be of: what scores call each, and what is predicted of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from scenetruth.design.predict import Figure

__all__ = ["STATISTICS", "Statistic", "StatisticKind", "predicted_of"]

Statistic = Literal["typical", "rms", "percentile_95"]
"""What an objective may be of; see `STATISTICS`."""


@dataclass(frozen=True)
class StatisticKind:
    """A statistic of errors that simulations and predictions both tell.

    Parameters
    ----------
    title
        What it is, in words.
    scored
        The statistic of a score that it is taken from.
    factor
        What that is multiplied with.
    of_normal
        What it is of normal errors with a standard deviation of 1.
    """

    title: str
    scored: str
    factor: float
    of_normal: float


STATISTICS: Mapping[str, StatisticKind] = {
    # The median of a normal error's size is 0.6745 of its standard deviation.
    "typical": StatisticKind("typical error", "median_abs", 1.4826, 1.0),
    "rms": StatisticKind("rms error", "rms", 1.0, 1.0),
    "percentile_95": StatisticKind("95th percentile of the errors' sizes", "p95_abs", 1.0, 1.95996),
}
"""By name. ``typical``: 1.4826 times the median of the errors' sizes, the standard deviation of normal errors with that
median; predicted by the median of standard deviations over the region. ``rms``: predicted by the root of their mean
square. ``percentile_95``: predicted for normal errors with these standard deviations."""

assert set(STATISTICS) == set(get_args(Statistic))


def predicted_of(figure: Figure, statistic: Statistic) -> float:
    """Return what a prediction says of a statistic, in units for people.

    Parameters
    ----------
    figure
        The figure of a quantity in a region.
    statistic
        Key of `STATISTICS`.
    """
    told = {"typical": figure.value, "rms": figure.rms, "percentile_95": figure.percentile_95}
    return told[statistic]
