"""Some draws of a recipe, taken all over it."""

from __future__ import annotations

from dataclasses import dataclass, field

from scenetruth.dataset.checking import Trial, try_draws
from scenetruth.dataset.sampler import Draw, Sampler
from scenetruth.progress import Progress
from scenetruth.randomness import generator_for

__all__ = ["Drawn", "draw_some", "some_numbers"]

_FREE, _BOUNDED = 500, 48
"""Draws that are shown if not given: looking at the geometry of each takes a thousand times as long."""


@dataclass(frozen=True)
class Drawn:
    """Some draws that were accepted, and what became of the others.

    Parameters
    ----------
    trial
        How many draws it took, and why others were refused.
    draws
        Those that were accepted, by number.
    """

    trial: Trial
    draws: list[Draw] = field(default_factory=list)

    def values(self) -> dict[str, list[object]]:
        """Return the values of all draws by key."""
        keys = self.draws[0].values if self.draws else {}
        return {key: [draw.values[key] for draw in self.draws] for key in keys}


def draw_some(sampler: Sampler, count: int | None = None, progress: Progress | None = None, workers: int = 0) -> Drawn:
    """Draw some samples of a recipe, the same each time.

    Parameters
    ----------
    sampler
        The recipe with its base scenes.
    count
        How many; if not given, 500, or 48 if the geometry of each must be looked at.
    progress
        Called with (what, done, total).
    workers
        Processes that look at the geometry; 0 for this one.
    """
    wanted = count or (_BOUNDED if sampler.recipe.accept else _FREE)
    draws: list[Draw] = []
    trial = try_draws(sampler, some_numbers(sampler.recipe.samples, wanted), progress, draws.append, workers)
    return Drawn(trial, draws)


def some_numbers(total: int, wanted: int) -> list[int]:
    """Return some of the numbers from 0 to a total in order: at random, so that no grid or list is met in step.

    Examples
    --------
    >>> some_numbers(3, 5), some_numbers(10**9, 3) == some_numbers(10**9, 3)
    ([0, 1, 2], True)
    """
    if wanted >= total:
        return list(range(total))
    chosen = generator_for(0, "some", total, wanted)
    found: set[int] = set()
    while len(found) < wanted:
        found.update(chosen.integers(total, size=wanted - len(found)).tolist())
    return sorted(found)
