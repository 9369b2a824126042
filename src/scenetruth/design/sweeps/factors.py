"""Factors of a sweep: scene fields and their levels, as lists, ranges or text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from scenetruth.errors import Problem
from scenetruth.scene.yaml_reader import read_yaml

__all__ = ["Factor", "format_level", "parse_factors", "split_assignments"]

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"(?P<low>{_NUMBER})\.\.(?P<high>{_NUMBER})(?::(?:(?P<count>\d+)(?P<log>log)?|(?P<only>log)))?")
_MEANT_AS_RANGE = re.compile(rf"\s*{_NUMBER}\s*\.\.")
_SPELLING = "must have the form 1,2,5 or 1..10:4 (four levels) or 1..10:4log"
_MOST_VALUES = 10_000
_DIGITS = 12  # significant digits of the levels of a range: 0.1 instead of 0.1000000000000001


@dataclass(frozen=True)
class Factor:
    """A varied field."""

    path: str
    values: tuple[Any, ...] = ()  # levels given as a list; empty for a range
    ends: tuple[float, float] | None = None  # lower and upper end of a range
    count: int = 0  # levels of a range; 0 if it is sampled by Sobol points
    logarithmic: bool = False  # levels or points are evenly spaced on a logarithmic scale

    @property
    def is_filled(self) -> bool:
        """Whether the range is sampled by Sobol points."""
        return self.ends is not None and not self.count

    def listed(self, *, whole: bool) -> tuple[Any, ...]:
        """Return the levels; rounded to integers and without duplicates if ``whole``."""
        if self.ends is None:
            return self.values
        numbers = (np.geomspace if self.logarithmic else np.linspace)(*self.ends, self.count).tolist()
        shortened = [float(f"{number:.{_DIGITS}g}") for number in numbers]
        return tuple(dict.fromkeys(round(number) for number in shortened)) if whole else tuple(shortened)


def format_level(value: Any) -> str:
    """Return the label of a level in tables and plots: a number with six digits, any other value as YAML.

    >>> format_level(0.30000000000000004), format_level("ideal"), format_level({"kind": "box"})
    ('0.3', 'ideal', '{kind: box}')
    """
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str | int) and not isinstance(value, bool):
        return str(value)
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**9, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")


def split_assignments(given: Sequence[str]) -> tuple[dict[str, str], list[Problem]]:
    """Parse texts PATH=VALUES; return the values by path, and the problems.

    >>> split_assignments(["stage.baseline_mm=1,2,5", "sensor.noise_std=0.001..0.02:4log"])[0]
    {'stage.baseline_mm': '1,2,5', 'sensor.noise_std': '0.001..0.02:4log'}
    """
    found: dict[str, str] = {}
    problems = []
    for text in given:
        path, separator, values = (part.strip() for part in text.partition("="))
        if not (path and separator and values):
            problems.append(
                Problem("--vary", "must have the form PATH=VALUES, for example stage.baseline_mm=1,2,5", text)
            )
        elif path in found:
            problems.append(Problem(f"vary.{path}", "is given twice; list all values in one option", text))
        else:
            found[path] = values
    return found, problems


def parse_factors(vary: Mapping[str, Any], sobol: int) -> tuple[list[Factor], list[Problem]]:
    """Return the factors, and the problems that can be detected without the scene."""
    found, problems = [], []
    for path, given in vary.items():
        here: list[Problem] = []
        factor = _factor(path, given, here)
        if factor is not None:
            here += _list_problems(factor, sobol)
        problems += here
        if factor is not None and not here:
            found.append(factor)
    if not vary:
        problems.append(Problem("vary", "is missing; specify a factor, for example stage.baseline_mm=1,2,5"))
    elif sobol and not problems and not any(factor.is_filled for factor in found):
        message = "requires a range without a number of levels; specify one, for example 1..10 or 1..10:log"
        problems.append(Problem("sobol", message, sobol))
    return found, problems


def _factor(path: str, given: Any, problems: list[Problem]) -> Factor | None:
    where = f"vary.{path}"
    if isinstance(given, str):
        return _spelled(path, given.strip(), problems)
    if not isinstance(given, Sequence | np.ndarray) or isinstance(given, bytes):
        problems.append(Problem(where, "must be a list of values or a text such as '1..10:4'", given))
        return None
    return Factor(path, tuple(value.item() if isinstance(value, np.generic) else value for value in given))


def _spelled(path: str, text: str, problems: list[Problem]) -> Factor | None:
    where = f"vary.{path}"
    parts = _RANGE.fullmatch(text)
    if parts is not None:
        ends = (float(parts["low"]), float(parts["high"]))
        return Factor(path, (), ends, int(parts["count"] or 0), bool(parts["log"] or parts["only"]))
    if _MEANT_AS_RANGE.match(text):
        problems.append(Problem(where, _SPELLING, text))
        return None
    values, wrong = read_yaml(f"[{text}]")
    if wrong or not isinstance(values, list):
        line = "; ".join(problem.message for problem in wrong)
        problems.append(Problem(where, f"{_SPELLING}: {line}" if line else _SPELLING, text))
        return None
    return Factor(path, tuple(map(_as_number, values)))


def _as_number(value: Any) -> Any:
    # YAML reads 1e-3 as a text because it has no decimal point.
    return float(value) if isinstance(value, str) and re.fullmatch(_NUMBER, value) else value


def _list_problems(factor: Factor, sobol: int) -> list[Problem]:
    where, ends = f"vary.{factor.path}", factor.ends
    if ends is None:
        return _list_level_problems(where, factor.values)
    shown = "..".join(map(format_level, ends))
    if not all(map(math.isfinite, ends)) or not ends[0] < ends[1]:
        return [Problem(where, "must have a lower end below its upper end", shown)]
    if factor.logarithmic and ends[0] <= 0:
        return [Problem(where, "is logarithmic and must be above 0; omit log for a linear range", shown)]
    if factor.is_filled and not sobol:
        return [Problem(where, f"requires a number of levels, for example {shown}:4, or Sobol points", shown)]
    if not factor.is_filled and not 2 <= factor.count <= _MOST_VALUES:
        return [Problem(where, f"must have 2 to {_MOST_VALUES:,} levels", factor.count)]
    return []


def _list_level_problems(where: str, values: Sequence[Any]) -> list[Problem]:
    twice = [format_level(value) for number, value in enumerate(values) if value in values[:number]]
    if twice:
        return [Problem(where, f"has duplicate levels: {', '.join(twice)}")]
    if len(values) < 2:
        return [Problem(where, "must have at least two levels; set a constant in the scene instead", list(values))]
    if len(values) > _MOST_VALUES:
        return [Problem(where, f"must have 2 to {_MOST_VALUES:,} levels", len(values))]
    return []
