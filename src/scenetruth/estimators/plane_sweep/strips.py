"""Strips of rows, which are worked on one by one or at once."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

__all__ = ["MARGIN", "ROWS", "Strip", "strips_of"]

ROWS = 120
"""Rows of a strip's own, about."""
MARGIN = 24
"""Rows that it shares with its neighbours on either side."""


@dataclass(frozen=True)
class Strip:
    """Some rows of an image."""

    first: int
    last: int
    """Rows of its own."""
    top: int
    bottom: int
    """Rows with the margins."""


def strips_of(height: int, rows: int = ROWS) -> list[Strip]:
    """Return the strips of an image; how many there are does not depend on the machine.

    Examples
    --------
    >>> strips_of(240)[1]
    Strip(first=120, last=240, top=96, bottom=240)
    """
    count = max(1, round(height / rows))
    ends = [height * n // count for n in range(count + 1)]
    return [Strip(first, last, max(first - MARGIN, 0), min(last + MARGIN, height)) for first, last in pairwise(ends)]
