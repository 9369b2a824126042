"""What is around an assertion of accuracy: where its pictures go, and who takes note of its outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Row", "Surroundings", "around", "surrounded"]

Row = dict[str, Any]
"""The outcome of one limit as plain values, so that it may travel from process to process."""


@dataclass(frozen=True)
class Surroundings:
    """What a test run offers to the assertions in it.

    Parameters
    ----------
    pictures
        Makes the folder for pictures of what fails, and returns it; not called before something does. Without it, no
        pictures are drawn unless an assertion names a folder.
    note
        Takes the outcomes of every assertion.
    """

    pictures: Callable[[], Path] | None = None
    note: Callable[[Sequence[Row]], None] | None = None


_NOTHING = Surroundings()
_around: ContextVar[Surroundings] = ContextVar("scenetruth_surroundings", default=_NOTHING)


def around() -> Surroundings:
    """Return what is around whoever asks; nothing outside of `surrounded`."""
    return _around.get()


@contextmanager
def surrounded(
    *, pictures: Callable[[], Path] | None = None, note: Callable[[Sequence[Row]], None] | None = None
) -> Iterator[None]:
    """Surround the assertions of a block.

    Parameters
    ----------
    pictures, note
        As of `Surroundings`.

    Examples
    --------
    >>> with surrounded(pictures=lambda: Path("pictures")):
    ...     around().pictures is None
    ...     with surrounded():
    ...         around().pictures is None
    False
    True
    """
    token = _around.set(Surroundings(pictures, note))
    try:
        yield
    finally:
        _around.reset(token)
