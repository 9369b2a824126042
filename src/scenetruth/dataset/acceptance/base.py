"""What all bounds have in common: something is measured on the geometry, and must lie between two numbers."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, ClassVar, Self

from pydantic import model_validator

from scenetruth.model import Finite, FrozenModel, Name

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["Bound", "ObjectBound"]


class Bound(FrozenModel):
    """Bounds of something that geometry tells."""

    unit: ClassVar[str] = ""
    """Unit of what is measured, with a space before it, for messages."""

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

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return what is measured: each value with what it is of, as ``("visible share of leaf-3", 0.2)``."""
        raise NotImplementedError

    def refusal(self, look: Look) -> str:
        """Return why a draw is refused, the same text for the same cause; empty if it is not."""
        for what, value in self.measured(look):
            if self.at_least is not None and not value >= self.at_least:
                return f"{what} under {self.at_least:g}{self.unit}"
            if self.at_most is not None and not value <= self.at_most:
                return f"{what} over {self.at_most:g}{self.unit}"
        return ""


class ObjectBound(Bound):
    """Bounds of something that geometry tells of single objects."""

    object: Name = "*"
    """Names of the objects; ``*`` stands for any letters."""

    def _matching(self, look: Look) -> list[int]:
        return [number for number, name in enumerate(look.names) if fnmatchcase(name, self.object)]
