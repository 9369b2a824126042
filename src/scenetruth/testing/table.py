"""Tables as plain text."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["aligned", "times_over"]


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table, its columns padded to the same width.

    Examples
    --------
    >>> aligned([("depth", "rms"), ("disparity", "bias")])
    ['depth      rms', 'disparity  bias']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def times_over(times: float | None) -> str:
    """Spell how much of a limit is used."""
    return "-" if times is None else f"{times:.3g} x"
