"""The value of another field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from scenetruth.dataset.distributions.base import Derived
from scenetruth.model import Name

__all__ = ["SameAs"]


class SameAs(Derived):
    """The value that another field, or another named value, has in the same sample.

    Examples
    --------
    >>> SameAs(of="distance_mm").value({"distance_mm": 600.0})
    600.0
    """

    kind: Literal["same_as"] = "same_as"
    of: Name
    """Name or path of the other value."""

    def needs(self) -> frozenset[str]:
        """Return the other value's name."""
        return frozenset({self.of})

    def value(self, values: Mapping[str, Any]) -> Any:
        """Return the other value."""
        return values[self.of]
