"""What one axis of a chart of rigs shows: an objective, or a parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from scenetruth.design.optimise.result import Interval, Objective, Rig
from scenetruth.design.page.words import length

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Way", "axis_of", "finite", "wanted_on"]

_WIDE = 8.0
"""Values that span more than this factor are drawn on a logarithmic scale."""
_BEYOND = 3.0
"""Bars widen an axis by no more than this factor, or this share of what the points span."""
_FEW_DECADES = 2.5
_SPARE = 0.05
_LEAST = 1e-30
"""Smaller values have no place on a logarithmic scale."""
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Way:
    """What an axis shows.

    Parameters
    ----------
    name
        The objective's title, or the parameter's path; its column among the predictions.
    objective
        The objective; None of a parameter.
    """

    name: str
    objective: Objective | None = None

    @property
    def title(self) -> str:
        """What stands at the axis."""
        return self.name if self.objective is None else f"{self.name}: {self.objective.told_in}, {self.objective.unit}"

    def predicted(self, rig: Rig) -> float:
        """Return where a rig's prediction is drawn."""
        return float(rig.parameters[self.name] if self.objective is None else rig.predicted[self.name])

    def simulated(self, rig: Rig) -> Interval | None:
        """Return where its simulations are; None if there are none."""
        if self.objective is None:
            return Interval(self.predicted(rig), math.nan, math.nan, 0)
        return rig.simulated.get(self.name)

    def screened(self, table: pd.DataFrame) -> list[float]:
        """Return where predictions are drawn; NaN where one has no such number."""
        import pandas as pd

        return [float(value) for value in pd.to_numeric(table[self.name], errors="coerce")]


def axis_of(way: Way, points: Sequence[float | None], ends: Sequence[float | None]) -> dict[str, Any]:
    """Return an axis that holds all points, and the ends of bars as far as they do not push the points together.

    Parameters
    ----------
    way
        What it shows.
    points
        All points on it.
    ends
        Ends of bars.
    """
    axis: dict[str, Any] = {"title": {"text": way.title}, "automargin": True}
    known = [value for value in points if value is not None]
    if way.objective is not None and way.objective.wanted is not None:
        known.append(way.objective.wanted)
    if not known:
        return {**axis, "type": "linear"}
    low, high = min(known), max(known)
    bars = [value for value in ends if value is not None]
    if low > _LEAST and (high > _WIDE * low or any(not low / 2 < value < 2 * high for value in bars)):
        first = min([low, *(max(value, low / _BEYOND) for value in bars)])
        last = max([high, *(min(value, high * _BEYOND) for value in bars)])
        spare = _SPARE * max(math.log10(last) - math.log10(first), 0.1)
        span = [math.log10(first) - spare, math.log10(last) + spare]
        # One, two and five of each decade are labelled where there is room.
        ticks = "D2" if span[1] - span[0] < _FEW_DECADES else 1
        return {**axis, "type": "log", "tickformat": "~g", "dtick": ticks, "range": span}
    # What differs by rounding alone is one place.
    nothing = max(_ROUNDING * max(abs(low), abs(high)), _LEAST)
    wide = high - low if high - low > nothing else abs(high) if abs(high) > nothing else 1.0
    first = min([low, *(max(value, low - _BEYOND * wide) for value in bars)])
    last = max([high, *(min(value, high + _BEYOND * wide) for value in bars)])
    spare = _SPARE * (last - first if last - first > nothing else wide)
    return {**axis, "type": "linear", "exponentformat": "power", "range": [first - spare, last + spare]}


def wanted_on(way: Way, axis: str, drawn: Mapping[str, Any]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return a line at what is wanted, and its words; nothing if nothing is.

    Parameters
    ----------
    way
        What the axis shows.
    axis
        ``"x"`` or ``"y"``.
    drawn
        The axis, as plotly has it.
    """
    wanted = None if way.objective is None else way.objective.wanted
    if way.objective is None or wanted is None:
        return [], []
    other = "y" if axis == "x" else "x"
    shape = {
        "type": "line",
        f"{axis}0": wanted,
        f"{axis}1": wanted,
        f"{other}0": 0,
        f"{other}1": 1,
        f"{other}ref": "paper",
        "line": {"color": "#009E73", "width": 1.5, "dash": "dash"},
    }
    words = {
        # Places of words on logarithmic axes are logarithms.
        axis: math.log10(wanted) if drawn["type"] == "log" else wanted,
        other: 1,
        f"{other}ref": "paper",
        f"{other}anchor": "top" if axis == "x" else "right",
        f"{axis}anchor": "left" if axis == "x" else "bottom",
        "text": f"wanted: {length(wanted)} {way.objective.unit}",
        "showarrow": False,
        "bgcolor": "rgba(255,255,255,0.85)",
    }
    return [shape], [words]


def finite(value: float) -> float | None:
    """Return a number, or None if it is not finite: JSON has no others."""
    return value if math.isfinite(value) else None
