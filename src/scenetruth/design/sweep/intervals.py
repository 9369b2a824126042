"""Figures of several seeds, with their 95 % confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["Interval", "mean_of", "root_mean_square_of", "scatter_of", "size_of"]

Interval = tuple[float, float, float]
"""A figure, and the low and high end of its interval: NaN where too few seeds tell."""
_LEVEL = 0.975
_LARGEST_EXPONENT = 100.0
"""An interval that is so wide tells nothing, and must not overflow."""
_FEWEST_LEFT_OUT = 3
"""With fewer seeds, those that are left when one is left out have no scatter."""


def mean_of(values: Sequence[float]) -> Interval:
    """Return the mean over seeds, with the interval of Student's t.

    Parameters
    ----------
    values
        A figure of each seed.

    Examples
    --------
    >>> [round(one, 3) for one in mean_of([1.0, 2.0, 3.0])]
    [2.0, -0.484, 4.484]
    """
    each = np.asarray(values, dtype=np.float64)
    centre = float(each.mean())
    if len(each) < 2:
        return centre, math.nan, math.nan
    half = _student(len(each) - 1) * float(each.std(ddof=1)) / math.sqrt(len(each))
    return centre, centre - half, centre + half


def size_of(values: Sequence[float]) -> Interval:
    """Return the mean over seeds of what is never negative; the interval is that of its logarithm.

    Examples
    --------
    >>> [round(one, 3) for one in size_of([1.0, 2.0, 3.0])]
    [2.0, 0.578, 6.926]
    """
    centre, low, _ = mean_of(values)
    return _on_logarithm(centre, centre - low)


def root_mean_square_of(values: Sequence[float]) -> Interval:
    """Return the root of the mean square over seeds; the interval is that of the mean square's logarithm."""
    return _root(size_of(np.square(values).tolist()))


def scatter_of(errors: NDArray[np.floating]) -> Interval | None:
    """Return the standard deviation between seeds: the root of the mean variance over pixels.

    Its interval is that of the jackknife: each seed is left out once (B. Efron and C. Stein, Annals of Statistics 9,
    1981); on the logarithm of the variance.

    Parameters
    ----------
    errors
        Errors at the same pixels with each seed, shape (seed, n); NaN where nothing is told. Pixels that are not told
        with every seed do not count.

    Returns
    -------
    tuple or None
        None with a single seed, or without pixels.
    """
    always = np.isfinite(errors).all(axis=0)
    count = len(errors)
    if count < 2 or not always.any():
        return None
    kept = np.asarray(errors[:, always], dtype=np.float64)
    variance = float(kept.var(axis=0, ddof=1).mean())
    if count < _FEWEST_LEFT_OUT:
        return math.sqrt(variance), math.nan, math.nan
    without = np.array([np.delete(kept, seed, axis=0).var(axis=0, ddof=1).mean() for seed in range(count)])
    spread = math.sqrt((count - 1) / count * float(np.square(without - without.mean()).sum()))
    return _root(_on_logarithm(variance, _student(count - 1) * spread))


def _on_logarithm(centre: float, half: float) -> Interval:
    """Return the interval whose logarithm reaches so far to either side, as far as a small one does without."""
    if centre <= 0:
        return centre, math.nan, math.nan
    factor = math.exp(min(half / centre, _LARGEST_EXPONENT)) if math.isfinite(half) else math.nan
    return centre, centre / factor, centre * factor


def _root(interval: Interval) -> Interval:
    number, low, high = map(math.sqrt, interval)
    return number, low, high


def _student(freedom: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, _LEVEL))
