"""Velocities of a simpler motion than that of their surroundings: their difference from it, as a systematic error.

A surface that accelerates does so everywhere. Where windows keep a simpler model, because noise, few images or the
edge of the images hides the acceleration, their velocities may be biased by many of their standard deviations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.fit_maps import STEADY_PLACES
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.row_bands import window_weights
from scenetruth.estimators.refined.systematic_error import list_spans
from scenetruth.schema.variables import MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART

__all__ = ["add_neighbouring_motion", "neighbouring_differences"]

_REACH = 2  # largest distance of the other windows, in half-widths of the full window
_LEAST_SIDE = 5  # smallest side of an area of these windows in px: single pixels may have the model by chance
_SAME_PX = 0.25  # largest difference of disparities of one surface, extrapolated
_LEAST = 1.0  # smallest difference that counts, in standard deviations of the extrapolated velocity
_VELOCITY = slice(3, 6)  # variances of the velocity

Map = NDArray[np.float64]


def add_neighbouring_motion(refined: RefinedState, settings: RefinedSettings) -> RefinedState:
    """Return the fit with the differences from accelerated windows nearby in the variances of its velocities."""
    sigma = settings.window_sigma_px
    if not (refined.motion >= MOTION_ACCELERATED).any():
        return refined
    counts = np.array([part.count for part in list_spans(refined.images)])
    span = np.argmin(np.abs(counts[:, None, None] - np.nan_to_num(refined.fit.images)), axis=0)
    rank = np.where(refined.motion == MOTION_ACCELERATED_IN_PART, 1 + span, refined.motion == MOTION_ACCELERATED)
    reach = _REACH * (window_weights(sigma).shape[2] // 2)
    variance = refined.fit.variance.copy()
    added = neighbouring_differences(refined.fit.theta, variance[_VELOCITY], rank, reach, sigma)
    variance[_VELOCITY] += refined.images.transfer**2 * added
    return replace(refined, fit=refined.fit._replace(variance=variance))


def neighbouring_differences(theta: Map, variance: Map, rank: NDArray[np.integer], reach: int, sigma: float) -> Map:
    """Return the squared differences of velocities from those of windows of a higher rank nearby, shape (3, y, x).

    The nearest window of each rank counts if its surface continues to the pixel, and its velocity is extrapolated along
    its slopes. The slope of a Gaussian window has 1 / (2 σ²) of the variance of its mean.

    ``theta``: Parameters, NaN where invalid. ``variance``: Variances of the velocity. ``rank``: 0 for steady motions,
    1 for accelerations over all frames, more for those over ever fewer frames. ``reach``: Largest distance in px.
    """
    from scipy.ndimage import distance_transform_edt, grey_opening

    found, known = np.zeros((3, *rank.shape)), np.isfinite(theta).all(axis=0)
    for level in np.unique(rank[rank > 0]):
        richer = grey_opening(((rank == level) & known).astype(np.uint8), _LEAST_SIDE) > 0
        if not richer.any():
            continue
        distance, nearest = distance_transform_edt(~richer, return_indices=True)
        rows, columns = np.nonzero(known & (rank < level) & (distance <= reach))
        row, column = nearest[:, rows, columns]
        changes = [
            theta[place, row, column]
            + theta[place + 1, row, column] * (columns - column)
            + theta[place + 2, row, column] * (rows - row)
            - theta[place, rows, columns]
            for place in STEADY_PLACES
        ]
        same = np.abs(changes[0]) < _SAME_PX
        farther = 1.0 + distance[rows, columns] ** 2 / (2.0 * sigma**2)
        for k, change in enumerate(changes[1:]):
            counts = same & (change**2 > _LEAST**2 * farther * variance[k, row, column])
            found[k, rows, columns] += np.where(counts, change**2, 0.0)
    return found
