"""The rig that is recommended: what it is, what it reaches, what limits it, and what else there is on the front."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.design.optimise.answer.plain import made_of, plain_of
from scenetruth.design.optimise.answer.screened import read_screened
from scenetruth.design.optimise.parts import (
    Constraint,
    Discrepancy,
    Interval,
    Objective,
    Order,
    Rig,
    Rule,
    Sensitivity,
)
from scenetruth.design.optimise.words import words_of
from scenetruth.errors import StoreError
from scenetruth.plain import parse_json

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "ANSWER",
    "SCREENED",
    "Constraint",
    "Design",
    "Discrepancy",
    "Interval",
    "Objective",
    "Order",
    "Rig",
    "Rule",
    "Sensitivity",
]

ANSWER, SCREENED = "design.json", "screened.csv"
"""Files of a folder: the answer as plain values, and all predictions."""
_FORMAT = 2
_PARTS: Mapping[str, Any] = {
    "title": str,
    "objectives": tuple[Objective, ...],
    "front": tuple[Rig, ...],
    "alternatives": tuple[Rig, ...],
    "orders": tuple[Order, ...],
    "sensitivities": tuple[Sensitivity, ...],
    "rules": tuple[Rule, ...],
    "assumptions": tuple[str, ...],
    "discrepancies": tuple[Discrepancy, ...],
    "seconds": Mapping[str, float],
}


@dataclass(frozen=True, eq=False)
class Design:
    """The answer: a rig, the front, alternatives, and what stands behind them.

    Parameters
    ----------
    goal
        The goal file as plain values.
    title
        What is designed.
    objectives
        What is to be known precisely.
    recommended
        The best rig: one of the front or of the alternatives.
    front
        Rigs of which no other is predicted to be better in every objective; sorted by the first objective. Those that
        were simulated have ``simulated``.
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
    alternatives
        Rigs behind the front that are nearly as good and differ from those on it; none where the front has enough.
    orders
        Whether simulations keep the order of predictions: all pairs of rigs that were simulated.

    See Also
    --------
    scenetruth.design.optimise.optimise : Makes it.
    scenetruth.design.page.write.write_design_page : A page of it.

    Examples
    --------
    >>> from scenetruth.design.optimise import optimise
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [4, 16]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 4}, "frames": {"count": 3}, "sensor": {"noise_std": 0.01}}
    >>> goal = {"title": "A wall", "scene": scene, "free": {"stage.baseline_mm": {"values": [4, 6, 8, 10]}}}
    >>> goal |= {"constraints": [{"kind": "stage_travel", "at_most": 16}], "objectives": [{"quantity": "depth"}]}
    >>> goal |= {"search": {"predictions": 16, "morris": 0, "sobol": 0}, "confirm": {"rigs": 0}}
    >>> design = optimise(goal, workers=0)
    >>> print(design.words()[1])
    Depth: typical error, predicted 0.162 mm
    >>> for rig in design.rigs:
    ...     print(f"baseline {rig.parameters['stage.baseline_mm']} mm: depth to {rig.predicted['Depth']:.2f} mm")
    baseline 8 mm: depth to 0.16 mm
    baseline 6 mm: depth to 0.22 mm
    baseline 4 mm: depth to 0.32 mm

    What does not keep the constraints was screened too:

    >>> design.screened[["stage.baseline_mm", "holds"]].sort_values("stage.baseline_mm").values.tolist()
    [[4, True], [6, True], [8, True], [10, False]]
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
    alternatives: tuple[Rig, ...] = ()
    orders: tuple[Order, ...] = ()

    @property
    def rigs(self) -> tuple[Rig, ...]:
        """The front and the alternatives, sorted by the first objective."""
        titles = [one.title for one in self.objectives]
        return tuple(sorted((*self.front, *self.alternatives), key=lambda rig: [rig.predicted[one] for one in titles]))

    def to_frame(self) -> pd.DataFrame:
        """Return the front and the alternatives, a rig each row.

        Returns
        -------
        pandas.DataFrame
            ``rig``, ``recommended``, ``front`` (whether it is on it), a column for each parameter; for each objective
            ``TITLE``, ``TITLE simulated``, ``TITLE low``, ``TITLE high`` (missing where it was not simulated);
            ``price`` and ``limits``.
        """
        import pandas as pd

        nothing = Interval(math.nan, math.nan, math.nan, 0)
        first = {rig.number for rig in self.front}
        rows = []
        for rig in self.rigs:
            row: dict[str, Any] = {"rig": rig.number, "recommended": rig.number == self.recommended.number}
            row |= {"front": rig.number in first, **rig.parameters}
            for objective in self.objectives:
                title, found = objective.title, rig.simulated.get(objective.title, nothing)
                row |= {title: rig.predicted[title], f"{title} simulated": found.number}
                row |= {f"{title} low": found.low, f"{title} high": found.high}
            rows.append({**row, "price": rig.price, "limits": rig.limits})
        return pd.DataFrame(rows)

    def words(self) -> tuple[str, ...]:
        """Return the answer in words, a line each."""
        return words_of(
            self.objectives, self.recommended, self.sensitivities, self.discrepancies, self.rules, self.orders
        )

    def to_plain(self) -> dict[str, Any]:
        """Return all but the screened predictions as plain values: what ``design.json`` holds.

        Numbers that are not finite are None (not a number), ``"inf"`` and ``"-inf"``.
        """
        told = {name: plain_of(getattr(self, name)) for name in _PARTS}
        more = {"recommended": self.recommended.number, "words": list(self.words())}
        return {"format": _FORMAT, "goal": plain_of(self.goal), **told, **more}

    @classmethod
    def load(cls, folder: str | Path) -> Design:
        """Load what `optimise` left in a folder.

        Parameters
        ----------
        folder
            The folder; ``design.json`` and ``screened.csv`` of it are read.

        Raises
        ------
        StoreError
            If one of them is missing, damaged, or of another version.

        Examples
        --------
        To write the page again, without optimising:

        >>> from scenetruth.design.page.write import write_design_page
        >>> write_design_page(Design.load("outputs/rig"), "outputs/rig")  # doctest: +SKIP
        """
        place = Path(folder)
        file = place / ANSWER
        remedy = "run 'scenetruth design optimise' again; what is kept of predictions and simulations is used"
        try:
            plain = parse_json(file.read_bytes())
            if isinstance(plain, dict) and plain.get("format") != _FORMAT:
                raise StoreError(file, f"is of format {plain.get('format')}, and not {_FORMAT}: {remedy}")
            parts = {name: made_of(kind, plain[name]) for name, kind in _PARTS.items()}
            goal = dict(plain["goal"])
            (best,) = (rig for rig in (*parts["front"], *parts["alternatives"]) if rig.number == plain["recommended"])
            file = place / SCREENED
            table = read_screened(file, goal.get("free", {}))
        except FileNotFoundError as error:
            raise StoreError(file, f"is missing: {remedy}") from error
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError(file, f"is damaged ({type(error).__name__}: {error}): {remedy}") from error
        return cls(goal=goal, recommended=best, screened=table, folder=place, **parts)
