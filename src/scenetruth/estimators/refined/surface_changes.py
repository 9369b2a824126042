"""Changes between two fits that are linear over a whole surface, as those of a rigid surface that turns unevenly.

Around an axis of rotation the change of the velocity has both signs and is zero on the axis, so that local means hide
it in noise. A linear function has three parameters over all windows of the surface, which determine it far better.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["LinearChange", "fit_linear_changes"]

# Chi-squared of three degrees of freedom that noise reaches once in a thousand.
_SIGNIFICANT = 16.27
# Independent windows per pixel: neighbours at r have a correlation of exp(-r² / 4σ²), whose integral is 4 π σ².
_AREA = 4.0 * math.pi
_LEAST_WINDOWS = 4.0  # smallest number of independent windows that test three parameters
_MOST = 3.0  # largest residual of a window, in multiples of its noise and scatter
_ROUNDS = 5

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


class LinearChange(NamedTuple):
    """Linear part of the changes of quantities, shape (n, y, x)."""

    significant: NDArray[np.bool_]
    """Where the linear function of the surface exceeds noise."""
    square: Map
    """Square of its value plus its variance; 0 without a fit."""


def fit_linear_changes(change: Map, noise: Map, among: Mask, sigma: float) -> LinearChange:
    """Fit a linear function of the place to the changes on each connected surface.

    ``noise``: Variance of the changes due to noise. ``sigma``: Standard deviation of the windows in pixels of the maps.
    """
    from scipy.ndimage import find_objects, label

    significant, square = np.zeros(change.shape, dtype=np.bool_), np.zeros_like(change)
    surfaces, _ = label(among)
    for number, box in enumerate(find_objects(surfaces), 1):
        own = surfaces[box] == number
        if own.sum() < _LEAST_WINDOWS * _AREA * sigma**2:
            continue
        for n in range(len(change)):
            part = (n, *box)
            used = own & np.isfinite(change[part]) & np.isfinite(noise[part]) & (noise[part] > 0.0)
            if used.sum() < _LEAST_WINDOWS * _AREA * sigma**2:
                continue
            differs, value = _fit(change[part], noise[part], used, sigma)
            significant[part] |= own & differs
            square[part] = np.where(own, value, square[part])
    return LinearChange(significant, square)


def _fit(change: Map, noise: Map, used: Mask, sigma: float) -> tuple[bool, Map]:
    """Return whether the linear part of a change is significant, and its mean square at all pixels."""
    places = np.indices(used.shape, dtype=np.float64)
    centre = places[:, used].mean(axis=1)
    terms = np.concatenate([np.ones((1, *used.shape)), places - centre[:, None, None]])
    weight, values = 1.0 / noise[used], change[used]
    design = terms[:, used]
    inverse = np.linalg.inv((design * weight) @ design.T)
    found = inverse @ (design @ (weight * values))
    scatter = 1.0
    for _ in range(_ROUNDS):
        left = (values - found @ design) * np.sqrt(weight)
        scatter = max(1.0, float(np.median(np.abs(left))) / 0.6745)
        kept = found @ design + np.clip(left, -_MOST * scatter, _MOST * scatter) / np.sqrt(weight)
        found = inverse @ (design @ (weight * kept))
    covariance = _AREA * (sigma * scatter) ** 2 * inverse
    differs = bool(found @ np.linalg.solve(covariance, found) > _SIGNIFICANT)
    value = np.tensordot(found, terms, 1) ** 2 + np.einsum("iyx,ij,jyx->yx", terms, covariance, terms)
    return differs, value
