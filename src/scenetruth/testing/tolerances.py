"""Tolerances of accuracy assertions: parsing and evaluation."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from numbers import Real
from typing import Any

from scenetruth.errors import Problem, ScoreError
from scenetruth.scoring import QUANTITIES, STATISTICS
from scenetruth.testing.assertion_context import OutcomeRow
from scenetruth.validation_problems import suggest_word

__all__ = ["KEYS", "Limit", "LimitError", "LimitKey", "LimitOutcome", "evaluate_limit", "read_limits", "suggest_names"]


# An unknown keyword is a TypeError in Python and an invalid value a ValueError; one call may have both, and all
# problems are reported together.
class LimitError(ScoreError, TypeError, ValueError):
    """Invalid limits; lists every problem.

    See Also
    --------
    scenetruth.testing.assert_accuracy : The function that raises it.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.schema import Intrinsics, label
    >>> from scenetruth.testing import assert_accuracy
    >>> camera = Intrinsics(focal_length_px=1000.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> one = np.ones((1, 24, 32))
    >>> truth = label("truth", {"depth": 500 * one, "disparity": 10 * one, "mixed": one == 0}, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 500.1 * one}, camera, t=[0])
    >>> try:
    ...     assert_accuracy(estimate, truth, depth_cm=0.02, disparity_px={"rmes": 0.1, "bias": -1})
    ... except LimitError as error:
    ...     print(error)
    3 problems with the limits:
      - depth_cm: is no quantity with its unit; did you mean 'depth_mm'?
      - disparity_px.rmes: is no statistic of a score; did you mean 'rmse'?
      - disparity_px.bias: must not be negative (got -1)
    """

    _noun = "limits"


@dataclass(frozen=True)
class LimitKey:
    """A keyword that names one or several quantities with a unit; the components of a vector share a limit."""

    quantities: tuple[str, ...]
    factor: float
    units: str


@dataclass(frozen=True)
class Limit:
    """A limit of one statistic of one quantity, in ``units``; ``factor`` converts from the score's unit.

    ``of_bound``: Maximum as a multiple of the Cramér-Rao bound, replacing ``most``.
    """

    quantity: str
    statistic: str
    least: float = -math.inf
    most: float = math.inf
    factor: float = 1.0
    units: str = ""
    of_bound: float | None = None


_SPELLINGS: Mapping[str, tuple[tuple[str, float, str], ...]] = {
    "mm": (("_mm", 1.0, "mm"),),
    "px/step": (("_px", 1.0, "px/step"),),
    "mm/frame": (("_mm", 1.0, "mm/frame"),),
    "px/frame": (("_px", 1.0, "px/frame"),),
    "%/h": (("_percent_per_hour", 1.0, "%/h"), ("_per_hour", 0.01, "1/h")),
    "°": (("_deg", 1.0, "°"),),
    "1": (("", 1.0, ""),),
    "1/mm": (("_per_mm", 1.0, "1/mm"),),
    "1/mm^2": (("_per_mm2", 1.0, "1/mm^2"),),
    "rad/frame": (("_rad", 1.0, "rad/frame"),),
}
"""Endings of keywords by the units of scores: ending, conversion factor, unit."""

_SHORT = {"growth": "growth_rate"}
_IN_UNITS = ("bias", "rmse", "median_abs_error", "p95_abs_error")
_LARGER_IS_BETTER = ("coverage_2_std", "density", "count")
_BOUND_MULTIPLES = re.compile(
    r"\s*(?:(?P<factor>[0-9.]+(?:e[+-]?[0-9]+)?)\s*[x×*]\s*)?bound\s*", re.ASCII | re.IGNORECASE
)


@cache
def _keys() -> dict[str, LimitKey]:
    names: dict[str, list[str]] = {}
    for name, entry in QUANTITIES.items():
        names[name] = [name]
        if entry.component is not None:
            names.setdefault(entry.variable, []).append(name)
    names |= {short: [name] for short, name in _SHORT.items()}
    return {
        f"{name}{ending}": LimitKey(tuple(members), factor, units)
        for name, members in names.items()
        for ending, factor, units in _SPELLINGS[QUANTITIES[members[0]].units]
    }


KEYS: Mapping[str, LimitKey] = _keys()


def read_limits(given: Mapping[str, Any], min_density: object = None) -> tuple[list[Limit], list[Problem]]:
    """Parse the limits of `assert_accuracy`.

    >>> limits, problems = read_limits({"depth_mm": {"rmse": 0.2, "median_abs_error": 0.1}, "dispraity_px": 0.1})
    >>> [(limit.quantity, limit.statistic, limit.most) for limit in limits]
    [('depth', 'rmse', 0.2), ('depth', 'median_abs_error', 0.1)]
    >>> print(problems[0])
    dispraity_px: is no quantity with its unit; did you mean 'disparity_px'?
    """
    problems: list[Problem] = []
    limits: list[Limit] = []
    for name, value in given.items():
        key = KEYS.get(name)
        if key is None:
            problems.append(Problem(name, f"is no quantity with its unit{suggest_names(name, KEYS)}"))
            continue
        for quantity in key.quantities:
            limits += _limits_for_quantity(name, key, quantity, value, problems)
    if not given:
        problems.append(Problem("limits", "are missing: specify at least one, such as depth_mm=0.2"))
    if min_density is not None:
        if not _is_number(min_density) or not 0 <= float(min_density) <= 1:  # type: ignore[arg-type]
            problems.append(Problem("min_density", "must be a number from 0 to 1", min_density))
        else:
            named = dict.fromkeys(limit.quantity for limit in limits)
            limits += [Limit(name, "density", least=float(min_density)) for name in named]  # type: ignore[arg-type]
    # The components of a vector share their problems.
    return limits, list(dict.fromkeys(problems))


def suggest_names(name: str, known: Collection[str]) -> str:
    """Return the closest name as the end of a message, or all names if none is similar."""
    return suggest_word(name, known) or f"; available: {', '.join(known)}"


def _limits_for_quantity(
    name: str, key: LimitKey, quantity: str, value: Any, problems: list[Problem]
) -> Iterator[Limit]:
    if not isinstance(value, Mapping):
        value = {"rmse": value}
    elif not value:
        problems.append(Problem(name, "has no limit: specify a number, or statistics as {'rmse': 0.2}"))
    for word, bounds in value.items():
        statistic = word
        if statistic not in STATISTICS:
            shown = word if isinstance(word, str) else repr(word)
            message = f"is no statistic of a score{suggest_names(shown, STATISTICS)}"
            problems.append(Problem(f"{name}.{shown}", message))
            continue
        units = (key.factor, key.units) if statistic in _IN_UNITS else (1.0, "")
        least, most, of_bound = _bounds(f"{name}.{word}", quantity, statistic, bounds, problems)
        yield Limit(quantity, statistic, least, most, *units, of_bound)


def _bounds(
    path: str, quantity: str, statistic: str, value: Any, problems: list[Problem]
) -> tuple[float, float, float | None]:
    """Return minimum and maximum of a statistic, and the multiple of the bound."""
    if isinstance(value, str):
        return -math.inf, math.inf, _multiple(path, quantity, statistic, value, problems)
    if isinstance(value, tuple | list):
        if len(value) == 2 and all(map(_is_number, value)) and value[0] <= value[1]:
            return float(value[0]), float(value[1]), None
        problems.append(Problem(path, "must be two numbers, minimum and maximum", value))
    elif not _is_number(value):
        message = "must be a number, two numbers (minimum, maximum), or a multiple of the bound as '1.5 x bound'"
        problems.append(Problem(path, message, value))
    elif value < 0:
        problems.append(Problem(path, "must not be negative", value))
    elif statistic in _LARGER_IS_BETTER:
        return float(value), math.inf, None
    else:
        return (-float(value) if statistic == "bias" else -math.inf), float(value), None
    return -math.inf, math.inf, None


def _multiple(path: str, quantity: str, statistic: str, text: str, problems: list[Problem]) -> float | None:
    found = _BOUND_MULTIPLES.fullmatch(text)
    try:
        factor = float((found and found["factor"]) or 1.0)
    except ValueError:
        found, factor = None, 0.0
    if found is None or not 0 < factor < math.inf:
        problems.append(Problem(path, "must be a number, or a multiple of the bound as '1.5 x bound'", text))
    elif statistic != "rmse":
        problems.append(Problem(path, "has no bound; only rmse can be limited by a multiple of the bound", text))
    elif QUANTITIES[quantity].error != "difference":
        problems.append(Problem(path, "has no bound; only scalar quantities have a bound", text))
    else:
        return factor
    return None


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


Values = Mapping[str, float | int | None]


@dataclass(frozen=True)
class LimitOutcome:
    """A limit and the evaluated statistic in its units; ``most`` is the resolved multiple of the bound.

    ``note``: Reason for an undefined result; empty otherwise.
    """

    limit: Limit
    found: float | None
    density: float | None
    count: int
    note: str = ""

    @property
    def kept(self) -> bool:
        """Whether the statistic is defined and within its limits."""
        found, limit = self.found, self.limit
        return not self.note and found is not None and limit.least <= found <= limit.most

    @property
    def times(self) -> float | None:
        """Ratio of the value to its limit, above 1 if violated; None if undefined."""
        found, limit = self.found, self.limit
        if self.note or found is None:
            return None
        if math.isfinite(limit.least) and math.isfinite(limit.most):
            # Two limits: distance from their centre, in units of half their distance.
            return _ratio(abs(2 * found - limit.least - limit.most), limit.most - limit.least)
        return _ratio(found, limit.most) if math.isfinite(limit.most) else _ratio(limit.least, found)

    def row(self, region: str) -> OutcomeRow:
        """Return the outcome as plain values."""
        return {
            "quantity": self.limit.quantity,
            "statistic": self.limit.statistic,
            "region": region,
            "found": self.shown_found,
            "limit": self.shown_limit,
            "times": self.times,
            "kept": self.kept,
        }

    @property
    def shown_found(self) -> str:
        """The statistic with its unit, or the reason for its absence."""
        return self.note or self._spelled(self.found)

    @property
    def shown_limit(self) -> str:
        """The limit, with its unit."""
        limit = self.limit
        if math.isfinite(limit.least) and math.isfinite(limit.most) and limit.statistic != "bias":
            text = f"{limit.least:.4g} .. {self._spelled(limit.most)}"
        elif math.isfinite(limit.most):
            text = f"<= {self._spelled(limit.most)}"
        elif math.isfinite(limit.least):
            text = f">= {self._spelled(limit.least)}"
        else:
            return f"{limit.of_bound:g} x bound"
        return text if limit.of_bound is None else f"{text} ({limit.of_bound:g} x bound)"

    def _spelled(self, value: float | None) -> str:
        return f"{'undefined' if value is None else format(value, '.4g')} {self.limit.units}".strip()


def evaluate_limit(limit: Limit, values: Values | None, bound: float | None = None) -> LimitOutcome:
    """Compare a score with a limit.

    >>> evaluate_limit(Limit("depth", "rmse", most=0.2, units="mm"), {"rmse": 0.3, "density": 0.9, "count": 90}).kept
    False
    """
    if values is None:
        return LimitOutcome(limit, None, None, 0, "not in the estimate")
    if limit.of_bound is not None and bound is not None:
        limit = replace(limit, most=limit.of_bound * bound * limit.factor)
    value, density, count = values.get(limit.statistic), values.get("density"), int(values.get("count") or 0)
    density = None if density is None else float(density)
    note = ""
    if not count:
        note = "no truth in the region" if density is None else "no scored pixels"
    elif value is None or not math.isfinite(value):
        spread = limit.statistic in ("rms_z", "coverage_2_std")
        note = "no standard deviations" if spread else "undefined"
    elif limit.of_bound is not None and bound is None:
        note = "no bound in the region"
    found = None if value is None else float(value) * limit.factor
    return LimitOutcome(limit, found, density, count, note)


def _ratio(one: float, other: float) -> float:
    if other == 0:
        return 0.0 if one == 0 else math.inf
    return one / other if other > 0 else math.inf
