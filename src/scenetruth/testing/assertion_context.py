"""The context that the pytest plugin provides to accuracy assertions, and plain-text tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["AssertionContext", "OutcomeRow", "align_columns", "format_multiple", "get_context", "use_context"]


def align_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table with padded columns.

    >>> align_columns([("depth", "rmse"), ("disparity", "bias")])
    ['depth      rmse', 'disparity  bias']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def format_multiple(times: float | None) -> str:
    """Format the ratio of a value to its limit."""
    return "-" if times is None else f"{times:.3g} x"


OutcomeRow = dict[str, Any]
"""The outcome of one limit as plain values, for transfer between processes."""


@dataclass(frozen=True)
class AssertionContext:
    """Services of a test run for the assertions in it.

    ``pictures``: Creates and returns the directory for figures of violated limits; only called when needed.
    ``note``: Receives the outcomes of every assertion.
    """

    pictures: Callable[[], Path] | None = None
    note: Callable[[Sequence[OutcomeRow]], None] | None = None


_EMPTY_CONTEXT = AssertionContext()
_context: ContextVar[AssertionContext] = ContextVar("scenetruth_surroundings", default=_EMPTY_CONTEXT)


def get_context() -> AssertionContext:
    """Return the current context; it is empty outside of `use_context`."""
    return _context.get()


@contextmanager
def use_context(
    *, pictures: Callable[[], Path] | None = None, note: Callable[[Sequence[OutcomeRow]], None] | None = None
) -> Iterator[None]:
    """Provide a context for the assertions of a block.

    >>> with use_context(pictures=lambda: Path("pictures")):
    ...     get_context().pictures is None
    ...     with use_context():
    ...         get_context().pictures is None
    False
    True
    """
    token = _context.set(AssertionContext(pictures, note))
    try:
        yield
    finally:
        _context.reset(token)
