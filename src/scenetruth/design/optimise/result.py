"""The rig that is recommended: what it is, what it reaches, what limits it, and what else there is on the front."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.design.optimise.parts import Constraint, Discrepancy, Interval, Objective, Rig, Rule, Sensitivity
from scenetruth.design.optimise.words import words_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Constraint", "Design", "Discrepancy", "Interval", "Objective", "Rig", "Rule", "Sensitivity"]


@dataclass(frozen=True, eq=False)
class Design:
    """The answer: a rig, the alternatives, and what stands behind them.

    Parameters
    ----------
    goal
        The goal file as plain values.
    title
        What is designed.
    objectives
        What is to be known precisely.
    recommended
        The best rig.
    front
        Rigs of which no other is better in every objective; if these are few, some that are nearly as good and differ
        from them. The recommended one is among them. Sorted by the first objective; confirmed ones have ``simulated``.
    screened
        Every prediction: parameters by path, objectives by title, ``holds``, ``excess`` and ``phase``.
    sensitivities
        What parameters do to objectives.
    rules
        Rules of thumb, at the recommended rig.
    assumptions
        What was taken for granted, in words.
    discrepancies
        Prediction beside simulation, of every rig that was simulated.
    folder
        Where it lies; None if it was not kept.
    seconds
        What took how long: seconds by name.
    """

    goal: Mapping[str, Any] = field(repr=False)
    title: str
    objectives: tuple[Objective, ...]
    recommended: Rig
    front: tuple[Rig, ...]
    screened: pd.DataFrame = field(repr=False)
    sensitivities: tuple[Sensitivity, ...]
    rules: tuple[Rule, ...]
    assumptions: tuple[str, ...]
    discrepancies: tuple[Discrepancy, ...]
    folder: Path | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)

    def to_frame(self) -> pd.DataFrame:
        """Return the front, a rig each row.

        Returns
        -------
        pandas.DataFrame
            ``rig``, ``recommended``, a column for each parameter; for each objective ``TITLE``, ``TITLE simulated``,
            ``TITLE low``, ``TITLE high`` (missing where it was not simulated); ``price`` and ``limits``.
        """
        import pandas as pd

        nothing = Interval(math.nan, math.nan, math.nan, 0)
        rows = []
        for rig in self.front:
            row: dict[str, Any] = {"rig": rig.number, "recommended": rig.number == self.recommended.number}
            row |= rig.parameters
            for objective in self.objectives:
                title, found = objective.title, rig.simulated.get(objective.title, nothing)
                row |= {title: rig.predicted[title], f"{title} simulated": found.number}
                row |= {f"{title} low": found.low, f"{title} high": found.high}
            rows.append({**row, "price": rig.price, "limits": rig.limits})
        return pd.DataFrame(rows)

    def words(self) -> tuple[str, ...]:
        """Return the answer in words, a line each."""
        return words_of(self.objectives, self.recommended, self.sensitivities, self.discrepancies, self.rules)
