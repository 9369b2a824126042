"""Sizes of errors with 95 % confidence intervals: neighbours err alike, so that whole blocks are drawn again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.randomness import generator_for

__all__ = ["BLOCK_PX", "Size", "sizes_of"]

BLOCK_PX = 18
"""Side of a block: three standard deviations of the usual window, over which errors have become independent."""
_DRAWS = 400
_FEWEST_BLOCKS = 6
"""With fewer blocks an interval says nothing."""

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Size:
    """A figure with its 95 % confidence interval, NaN where there are too few blocks for one."""

    number: float
    low: float = float("nan")
    high: float = float("nan")


def sizes_of(errors: Map, kept: NDArray[np.bool_]) -> dict[str, Size]:
    """Return bias, root of the mean square, standard deviation and median of the absolute errors.

    Parameters
    ----------
    errors
        Estimate minus truth, shape (seed, y, x).
    kept
        Which of them count, same shape; all of these are finite.

    Returns
    -------
    dict
        By the names of the statistics; empty if no pixel counts. Intervals are of blocks drawn again with replacement
        (B. Efron: Bootstrap methods, Annals of Statistics 7, 1979), the same draws each time.
    """
    values = errors[kept]
    if not values.size:
        return {}
    blocks, number = _blocks_of(kept)
    median = float(np.median(np.abs(values)))
    count = np.bincount(blocks, minlength=number).astype(np.float64)
    sums = [np.bincount(blocks, each, number).astype(np.float64) for each in (values, values**2)]
    found = {name: Size(float(each(count.sum(), *(one.sum() for one in sums)))) for name, each in _FIGURES.items()}
    found["median"] = Size(median)
    if number >= _FEWEST_BLOCKS:
        drawn = generator_for(0, "blocks", number).multinomial(number, np.full(number, 1 / number), size=_DRAWS)
        with np.errstate(invalid="ignore", divide="ignore"):
            totals: list[Map] = [drawn @ one for one in (count, *sums)]
            for name, each in _FIGURES.items():
                low, high = np.nanpercentile(each(*totals), [2.5, 97.5])
                found[name] = Size(found[name].number, float(low), float(high))
    return found


def _blocks_of(kept: NDArray[np.bool_]) -> tuple[NDArray[np.intp], int]:
    """Return the number of its block for each pixel that counts, and how many blocks have any."""
    seed, y, x = np.nonzero(kept)
    wide = kept.shape[2] // BLOCK_PX + 1
    high = kept.shape[1] // BLOCK_PX + 1
    names, number = np.unique((seed * high + y // BLOCK_PX) * wide + x // BLOCK_PX, return_inverse=True)
    return number, len(names)


def _rms(count: Map, total: Map, squares: Map) -> Map:
    return np.sqrt(squares / count)


def _std(count: Map, total: Map, squares: Map) -> Map:
    return np.sqrt(np.maximum(squares / count - (total / count) ** 2, 0.0))


_FIGURES: Mapping[str, Callable[[Map, Map, Map], Map]] = {
    "bias": lambda count, total, squares: total / count,
    "rms": _rms,
    "std": _std,
}
