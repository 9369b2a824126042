"""Arithmetic on other values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from scenetruth.dataset.distributions.base import Derived
from scenetruth.dataset.expression import Expression

__all__ = ["Formula"]


def _readable(text: str) -> str:
    Expression(text)
    return text


class Formula(Derived):
    """A number computed from named values; in a recipe also written as a text that begins with an equals sign.

    Examples
    --------
    >>> Formula(formula="distance_mm * tan(pi / 6)").value({"distance_mm": 600.0})
    346.41016151377545
    """

    kind: Literal["formula"] = "formula"
    formula: Annotated[str, Field(max_length=1000), AfterValidator(_readable)]
    """The formula: numbers, names of values, + - * / // % **, comparisons, ``a if b else c``, and the functions of
    `scenetruth.dataset.expression`."""
    whole: bool = False
    """Whether the result is rounded to a whole number."""

    def needs(self) -> frozenset[str]:
        """Return the names in the formula."""
        return Expression(self.formula).names

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the result."""
        found = Expression(self.formula).value(values)
        return round(found) if self.whole else found

    @property
    def is_number(self) -> bool:
        """Whether it is always a number: it is."""
        return True
