"""The figures of an error budget: the part of one cause, and the whole."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Part", "Total", "sorted_parts"]


@dataclass(frozen=True)
class Part:
    """What one cause adds to the error of one quantity, rms over the pixels of a region.

    Parameters
    ----------
    cause
        Its kind.
    title
        What it is, in words.
    size
        How large the cause is in this scene, with its unit.
    quantity
        A key of `scenetruth.scoring.QUANTITIES`.
    region
        Where.
    unit
        Of the figures.
    predicted
        By propagation, of one standard deviation of the cause; NaN where no model tells.
    drawn
        By propagation, for the very errors that were simulated; NaN where the cause is no draw, or was not simulated.
    simulated
        Root of the mean square of what the estimate changes by, pixel by pixel, when the cause is switched on; NaN if
        it was not simulated, as surfaces, which cannot be switched off.
    seen
        Share of the pixels known with ideal images that are known with the cause too; NaN if not simulated.
    figure
        What counts: simulated if it was, else predicted; of surfaces, as much of what ideal images leave as goes along
        with the prediction. NaN if nothing is known.
    """

    cause: str
    title: str
    size: str
    quantity: str
    region: str
    unit: str
    predicted: float = math.nan
    drawn: float = math.nan
    simulated: float = math.nan
    seen: float = math.nan
    figure: float = math.nan


@dataclass(frozen=True)
class Total:
    """The error of one quantity, rms over the pixels of a region.

    Parameters
    ----------
    quantity, region, unit
        What and where.
    parts
        Root of the sum of the squares of all parts, as if they were independent.
    added
        Root of the mean square of all that was simulated, added up pixel by pixel with its sign, and of the squares of
        what was predicted only. Biases may cancel each other; NaN if nothing was simulated but ideal images.
    simulated
        The error with everything on; NaN if nothing was told then.
    ideal
        The error with ideal images.
    signal
        Root of the mean square of the true value.
    seen
        Share of the region's pixels that are known with everything on.
    """

    quantity: str
    region: str
    unit: str
    parts: float
    added: float
    simulated: float
    ideal: float
    signal: float
    seen: float

    @property
    def figure(self) -> float:
        """What counts: simulated, or the sum of the parts if nothing was told."""
        return self.simulated if math.isfinite(self.simulated) else self.parts


def sorted_parts(parts: Iterable[Part], quantity: str, region: str) -> list[Part]:
    """Return the parts of one quantity in one region, the largest first; unknown ones last."""
    found = [one for one in parts if (one.quantity, one.region) == (quantity, region)]
    return sorted(found, key=lambda one: -one.figure if math.isfinite(one.figure) else math.inf)
