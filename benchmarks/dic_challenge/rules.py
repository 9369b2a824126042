"""Rules of the DIC Challenge 2.0: period at 10 % loss, noise, metrological efficiency indicator (MEI).

Reu et al., Experimental Mechanics 62 (2022) 639, doi 10.1007/s11340-021-00806-6. The article itself was not available;
the rules are those of a public validation that reproduces its figures from the submissions of the participants
(iCorrVision-2D 2.0, ``validation/star.py`` and ``validation/resolution.py``):

- Along the centre row, the true displacement is the amplitude in every column, and the period rises linearly.
- The amplitude ratio, measured over true, is fitted with a polynomial of order 12 in the period. The period at 10 %
  loss is where the fit first rises through 0.9.
- The noise is the standard deviation along the centre row of a pair of images at rest.
- MEI of displacement: noise x period, px²; MEI of strain: noise x period², px². A code has one value: the mean of the
  three lowest over its settings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

__all__ = [
    "AMPLITUDE_PX",
    "PUBLISHED",
    "STRAIN",
    "WIDTH_PX",
    "Evaluation",
    "cutoff_periods",
    "evaluate",
    "mean_of_lowest",
    "noise_std",
    "periods_px",
]

AMPLITUDE_PX = 0.5
STRAIN = 0.05
WIDTH_PX = 4000
_SHORTEST_PX, _LONGEST_PX = 10.0, 300.0
_DEGREE = 12
_LEAST_RATIO = 0.9
_LOWEST = 3
_GRID = 20_000

PUBLISHED = {"displacement": (26, 0.356, 0.553, 1.02), "strain": (23, 1.27, 4.34, 11.1)}
"""By quantity: number of codes, then the best, the median and the worst MEI of the participants."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evaluation:
    """Result of one setting of a method.

    Parameters
    ----------
    first_px, last_px
        Period at 10 % loss: the first and the last upward crossing of the fit. Zero: the fit is never below; NaN: it
        never rises through 0.9.
    noise, noise_relative_std
        Standard deviation along the row at rest, px or 1, and the relative standard deviation of that value, which
        neighbouring pixels with a common window limit.
    valid_fraction
        Fraction of the columns with a displacement.
    scatter_ratio
        Standard deviation of the moved row about the fit, from the first crossing to twice its period, over the noise
        at rest. It exceeds 1 where the pattern biases the result, and where a method has smaller windows than at rest.
    """

    first_px: float
    last_px: float
    noise: float
    noise_relative_std: float
    valid_fraction: float
    scatter_ratio: float

    @property
    def mei(self) -> float:
        """MEI of displacement in px², with the first crossing."""
        return self.first_px * self.noise

    @property
    def strain_mei(self) -> float:
        """MEI of strain in px², with the first crossing."""
        return self.first_px**2 * self.noise


def periods_px(columns: Array) -> Array:
    """Return the periods at columns, counted from 0: 10 px at the first, 300 px one beyond the last."""
    return _SHORTEST_PX + (_LONGEST_PX - _SHORTEST_PX) / WIDTH_PX * columns


def cutoff_periods(periods: Array, ratio: Array) -> tuple[float, float]:
    """Return the first and the last period at which the fit of order 12 rises through 0.9."""
    known = np.isfinite(ratio)
    if known.sum() <= _DEGREE:
        return float("nan"), float("nan")
    fit = Polynomial.fit(periods[known], ratio[known], _DEGREE)
    grid = np.linspace(periods[known].min(), periods[known].max(), _GRID)
    above = fit(grid) - _LEAST_RATIO
    if np.all(above >= 0):
        return 0.0, 0.0
    places = np.flatnonzero((above[:-1] < 0) & (above[1:] >= 0))
    if not places.size:
        return float("nan"), float("nan")
    found = grid[places] - above[places] * (grid[1] - grid[0]) / (above[places + 1] - above[places])
    return float(found[0]), float(found[-1])


def noise_std(row: Array) -> tuple[float, float]:
    """Return the standard deviation of a row at rest, and its relative standard deviation.

    Of n correlated normal values with the autocorrelation r, the variance of the sample variance is 2 Σ r² / n times
    the square of the variance.
    """
    values = row[np.isfinite(row)]
    if values.size < 2:
        return float("nan"), float("nan")
    centred = values - values.mean()
    correlation = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * centred.size)) ** 2)[: centred.size]
    if correlation[0] <= 0:
        return 0.0, 0.0
    correlation /= correlation[0]
    # Beyond its first zero, the autocorrelation of a sample is noise.
    negative = np.flatnonzero(correlation <= 0)
    reach = int(negative[0]) if negative.size else centred.size
    repeated = 1 + 2 * float(np.sum(correlation[1:reach] ** 2))
    return float(centred.std()), float(np.sqrt(repeated / (2 * centred.size)))


def evaluate(moving: Array, at_rest: Array, amplitude: float = AMPLITUDE_PX) -> Evaluation:
    """Return period and noise of the displacements or strains along the centre row, shape (width,).

    Parameters
    ----------
    moving, at_rest
        Displacement along y, px, or strain of the moved pair and of the pair at rest; NaN where there is none.
    amplitude
        True value along the centre row.
    """
    periods, known = periods_px(np.arange(moving.size, dtype=np.float64)), np.isfinite(moving)
    first, last = cutoff_periods(periods, moving / amplitude)
    noise, relative = noise_std(at_rest)
    near, scatter = known & (periods >= first) & (periods <= 2 * first), float("nan")
    if near.sum() > _DEGREE:
        rest = moving / amplitude - Polynomial.fit(periods[known], moving[known] / amplitude, _DEGREE)(periods)
        scatter = float(amplitude * rest[near].std())
    return Evaluation(first, last, noise, relative, float(known.mean()), scatter / noise if noise > 0 else float("nan"))


def mean_of_lowest(values: Sequence[float]) -> float:
    """Return the mean of the three lowest values, which is the value of a code; NaN if there are fewer."""
    known = sorted(value for value in values if np.isfinite(value) and value > 0)
    return float(np.mean(known[:_LOWEST])) if len(known) >= _LOWEST else float("nan")
