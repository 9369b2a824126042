"""The context that the pytest plugin gives to accuracy assertions, and tables of plain text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["AssertionContext", "OutcomeRow", "align_columns", "format_multiple", "get_context", "use_context"]


def align_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table, its columns padded to the same width.

    >>> align_columns([("depth", "rmse"), ("disparity", "bias")])
    ['depth      rmse', 'disparity  bias']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def format_multiple(times: float | None) -> str:
    """Spell how much of a limit is used."""
    return "-" if times is None else f"{times:.3g} x"


OutcomeRow = dict[str, Any]
"""The outcome of one limit as plain values, so that it may travel from process to process."""


@dataclass(frozen=True)
class AssertionContext:
    """What a test run offers to the assertions in it.

    ``pictures``: Makes the folder for pictures of what fails, and returns it; not called before something does. Without
      it, no pictures are drawn unless an assertion names a folder.
    ``note``: Takes the outcomes of every assertion.
    """

    pictures: Callable[[], Path] | None = None
    note: Callable[[Sequence[OutcomeRow]], None] | None = None


_EMPTY_CONTEXT = AssertionContext()
_context: ContextVar[AssertionContext] = ContextVar("scenetruth_surroundings", default=_EMPTY_CONTEXT)


def get_context() -> AssertionContext:
    """Return what is around whoever asks; nothing outside of `surrounded`."""
    return _context.get()


@contextmanager
def use_context(
    *, pictures: Callable[[], Path] | None = None, note: Callable[[Sequence[OutcomeRow]], None] | None = None
) -> Iterator[None]:
    """Surround the assertions of a block.

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
