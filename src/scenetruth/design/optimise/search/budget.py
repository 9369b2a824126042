"""How predictions are shared out: an even design, sensitivity, the search itself, and its last steps."""

from __future__ import annotations

from dataclasses import dataclass

from scenetruth.design.optimise.goal.parts import Search

__all__ = ["Shares", "shares_of"]

_EVEN, _LAST = 0.25, 0.15
_LEAST_SEARCHED = 0.3


@dataclass(frozen=True)
class Shares:
    """Numbers of predictions.

    Parameters
    ----------
    even
        Sobol's points, a power of two.
    morris
        Trajectories.
    sobol
        Base samples of Sobol' indices, a power of two; 0 for none.
    search
        Trials of the search.
    last
        Steps around the best.
    """

    even: int
    morris: int
    sobol: int
    search: int
    last: int


def shares_of(search: Search, parameters: int) -> Shares:
    """Return how many predictions everything gets.

    Sensitivity gets less than asked for where it would leave too few for the search.

    Parameters
    ----------
    search
        What the goal says.
    parameters
        How many are free.

    Examples
    --------
    >>> shares_of(Search(), 8)
    Shares(even=512, morris=10, sobol=64, search=798, last=360)
    """
    total = search.predictions
    even = _power(int(_EVEN * total))
    last = int(_LAST * total)
    room = total - even - last - int(_LEAST_SEARCHED * total)
    morris = min(search.morris, max(room, 0) // (parameters + 1))
    room -= morris * (parameters + 1)
    # Below eight base samples, indices say nothing.
    sobol = _power(min(search.sobol, max(room, 0) // (parameters + 2)))
    sobol = sobol if sobol >= 8 else 0
    used = even + last + morris * (parameters + 1) + sobol * (parameters + 2)
    return Shares(even, morris, sobol, total - used, last)


def _power(number: int) -> int:
    """Return the largest power of two that is not above a number; 0 below 1."""
    return 1 << (number.bit_length() - 1) if number >= 1 else 0
