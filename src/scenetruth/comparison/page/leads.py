"""Who is ahead, in words and numbers: first of all where the algorithms of others are better than scenetruth's own."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scenetruth.comparison.result import Comparison
from scenetruth.comparison.standing import Standing, Standings
from scenetruth.scoring.quantities import title_of

__all__ = ["STATISTIC_TITLES", "Ahead", "Leads", "leads_of"]

STATISTIC_TITLES = {
    "rms": "rms error",
    "bias": "bias",
    "median": "median of the absolute error",
    "noise": "noise",
    "share_left": "share that is left",
    "density": "share of the pixels that is told",
    "period_at_10_percent_loss_first": "period at 10 % loss",
}
"""Statistics in words."""


@dataclass(frozen=True)
class Ahead:
    """A figure by which methods of others are ahead of scenetruth's own.

    Parameters
    ----------
    kind, title
        The case, and which value of it if it is of one.
    what
        Which figure, in words.
    others
        Methods of others that are ahead, each with its figure, the best first.
    own
        The best of scenetruth's own with its figure; empty if none of them told anything.
    """

    kind: str
    title: str
    what: str
    others: Sequence[tuple[str, str]]
    own: Sequence[str]


@dataclass(frozen=True)
class Leads:
    """Who is ahead.

    Parameters
    ----------
    own, others
        Labels of scenetruth's own methods and of those of others.
    cases
        How many cases methods of others tell; none if there are none of either.
    ahead
        The cases in which others are ahead, by what stands for the case.
    figures
        How many figures methods of others tell: of each quantity of a case, and of each value that has a name.
    ahead_by_figures
        Those of them by which others are ahead.
    best
        For each method, the titles of the cases of which it is the best; a method that is alone leads nothing.
    """

    own: Sequence[str]
    others: Sequence[str]
    cases: int
    ahead: Sequence[Ahead]
    figures: int
    ahead_by_figures: Sequence[Ahead]
    best: Sequence[tuple[str, Sequence[str]]]

    @property
    def lines(self) -> list[list[str]]:
        """The figures by which others are ahead as lines of a table: case, figure, others, the best of our own."""
        return [
            [one.title, one.what, ", ".join(map(" ".join, one.others)), " ".join(one.own) or "–"]
            for one in self.ahead_by_figures
        ]


def leads_of(found: Comparison) -> Leads:
    """Return who is ahead; equal figures put nobody ahead.

    Parameters
    ----------
    found
        The comparison.
    """
    others = [label for label in found.methods if label not in found.own]
    best = {label: list[str]() for label in found.methods}
    headlines, figures = found.headlines(), list(_figures(found))
    for one in headlines:
        first, *further = one.of_methods.items() or [("", math.nan)]
        if further and further[0][1] > first[1]:
            best[first[0]].append(one.case.title)
    told, all_told = ([one for one in some if _can_lead(one, found)] for some in (headlines, figures))
    return Leads(
        found.own,
        others,
        len(told),
        [ahead for one in told if (ahead := _ahead(one, found)) is not None],
        len(all_told),
        [ahead for one in all_told if (ahead := _ahead(one, found)) is not None],
        [(label, titles) for label, titles in best.items() if titles],
    )


def _figures(found: Comparison) -> Iterator[Standing]:
    """Give all that can be set side by side, quantity by quantity, and name by name where values have some."""
    standings = Standings(found.rows, found.methods)
    for case in found.cases:
        kinds = [case.headline, *((name, "rms") for name in (*case.quantities, "growth_rate_windowed"))]
        for quantity, statistic in dict.fromkeys(kinds):
            for value in case.labels() or [None]:
                one = standings.standing(case, quantity, statistic, value)
                if one is not None:
                    yield one


def _can_lead(one: Standing, found: Comparison) -> bool:
    return bool(found.own) and any(label not in found.own for label in one.of_methods)


def _ahead(one: Standing, found: Comparison) -> Ahead | None:
    numbers = one.of_methods
    ours = [label for label in numbers if label in found.own]
    least = numbers[ours[0]] if ours else math.nan
    before = [label for label in numbers if label not in found.own and not numbers[label] >= least]
    if not before:
        return None
    title = f"{one.case.title}, {one.label}" if one.label else one.case.title
    what = f"{title_of(one.quantity)}, {STATISTIC_TITLES.get(one.statistic, one.statistic)}"
    told = [(label, _words(one, found, numbers[label])) for label in before]
    return Ahead(one.case.kind, title, what, told, [ours[0], _words(one, found, least)] if ours else [])


def _words(one: Standing, found: Comparison, number: float) -> str:
    unit = "" if one.unit in ("", "1") else f" {one.unit}"
    if one.statistic.startswith("period"):
        values = [row.value for row in found.rows if row.case == one.case.kind and math.isfinite(row.value)]
        # Outside of what was measured there is no figure.
        if number == 0:
            return f"under {min(values, default=math.nan):g}{unit}"
        if number == math.inf:
            return f"over {max(values, default=math.nan):g}{unit}"
    return f"{number:.3g}{unit}"
