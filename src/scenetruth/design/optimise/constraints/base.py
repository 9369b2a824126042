"""What all constraints have in common: a number that a rig has, and bounds of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Self

from pydantic import model_validator

from scenetruth.design.optimise.parts import Constraint
from scenetruth.model import Finite, FrozenModel

if TYPE_CHECKING:
    from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["Limit", "bounded"]

_FAR = -10.0
"""Margin where there is no number at all."""


class Limit(FrozenModel):
    """Bounds of what a rig has; derive from it in a module of its own, with a ``kind``, and write `value`."""

    unit: ClassVar[str]
    """Unit of the number."""

    at_least: Finite | None = None
    """It must not be less."""
    at_most: Finite | None = None
    """It must not be more."""

    @model_validator(mode="after")
    def _some_bound(self) -> Self:
        if self.at_least is None and self.at_most is None:
            msg = "bounds nothing: give at_least, at_most, or both"
            raise ValueError(msg)
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            msg = f"can never hold: at_least = {self.at_least:g} is more than at_most = {self.at_most:g}"
            raise ValueError(msg)
        return self

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        raise NotImplementedError

    def value(self, facts: Facts) -> float:
        """Return what a rig has, in `unit`.

        Parameters
        ----------
        facts
            The rig.

        Returns
        -------
        float
            NaN where it has none, which no bound allows.
        """
        raise NotImplementedError

    def checked(self, facts: Facts) -> Iterator[Constraint]:
        """Give the bounds at a rig, each with what is left."""
        kind, value = str(getattr(self, "kind", "")), float(self.value(facts))
        for sense, limit in (("at least", self.at_least), ("at most", self.at_most)):
            if limit is not None:
                yield bounded(kind, self.title, value, sense, limit, self.unit)


def bounded(kind: str, title: str, value: float, sense: str, limit: float, unit: str) -> Constraint:
    """Return a bound at a rig.

    Parameters
    ----------
    kind, title, value, limit, unit
        As of `Constraint`.
    sense
        ``"at most"`` or ``"at least"``.
    """
    left = limit - value if sense == "at most" else value - limit
    margin = left / (abs(limit) or 1.0) if math.isfinite(left) else (_FAR if not left > 0 else -_FAR)
    # What differs by rounding alone is the same.
    holds = margin >= -1e-9
    return Constraint(kind, title, value, limit, unit, holds, margin, sense)
