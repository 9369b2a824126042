"""Rates of outliers after the KITTI scene flow benchmark, and whether they say anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.differences import difference, length
from scenetruth.scoring.quantities import Pair, stacked

__all__ = ["OUTLIER_FRACTION", "OUTLIER_PX", "RATES", "meaningful_rates", "outlier_rates"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATES = ("disparity_rate", "flow_rate", "scene_flow_rate", "count")
"""The statistics of outliers, in the order in which they are reported."""

OUTLIER_PX = 3.0
"""An outlier's error is above this many pixels ..."""

OUTLIER_FRACTION = 0.05
"""... and above this fraction of the true value's magnitude."""

_PARTS: Mapping[str, tuple[str, ...]] = {"disparity_rate": ("disparity",), "flow_rate": ("flow_x", "flow_y")}
"""The quantities that each rate is made of; that of scene flow takes all."""


def outlier_rates(pairs: Mapping[str, Pair], rates: Sequence[str] = RATES[:-1]) -> dict[str, float | int | None]:
    """Return the shares of outliers, as the KITTI scene flow benchmark defines them (Menze and Geiger, CVPR 2015).

    A disparity is an outlier if its error is above 3 px and above 5 % of the true disparity's magnitude. A flow is one
    if its endpoint error is above 3 px and above 5 % of the true flow's length. A pixel is an outlier of scene flow if
    either is. All rates are shares of the same pixels: those where all quantities are scored that the rates need.

    Parameters
    ----------
    pairs
        By name: ``disparity`` in px per step of s, ``flow_x`` and ``flow_y`` in px per frame, any shape. Others are
        not looked at.
    rates
        The rates to return, names of `RATES`.

    Returns
    -------
    dict
        The rates, shares between 0 and 1 or None with no scored pixel, and the ``count`` of scored pixels.

    Examples
    --------
    >>> disparity = Pair(np.array([10.0, 14.0]), np.array([10.0, 10.0]))
    >>> outlier_rates({"disparity": disparity}, ["disparity_rate"])
    {'disparity_rate': 0.5, 'count': 2}
    """
    wanted = [name for name in RATES[:-1] if name in rates]
    parts = [part for part in _PARTS if part in wanted or "scene_flow_rate" in wanted]
    vectors = {part: stacked(pairs, _PARTS[part]) for part in parts}
    scored = np.logical_and.reduce([_scored(vector) for vector in vectors.values()])
    count = int(scored.sum())
    if count == 0:
        return dict.fromkeys(wanted, None) | {"count": 0}
    found = {part: _is_outlier(vector.estimate[:, scored], vector.truth[:, scored]) for part, vector in vectors.items()}
    found["scene_flow_rate"] = np.logical_or.reduce(list(found.values()))
    return {**{name: float(found[name].mean()) for name in wanted}, "count": count}


def meaningful_rates(pairs: Mapping[str, Pair], region: Mask) -> tuple[str, ...]:
    """Return the rates of outliers that can tell a good estimate from a poor one.

    Where all true disparities are alike, even a guess keeps within the thresholds, so that a rate of zero says nothing.
    A rate is meaningful if the estimate has an outlier, or if a guess would have one: the median of the truth, the same
    at every pixel. The rate of scene flow is meaningful if that of disparity or that of flow is.

    Parameters
    ----------
    pairs
        What `read_pairs` returns, shape (t, y, x).
    region
        Where to look, same shape.

    Returns
    -------
    tuple of str
        Names of `RATES` without ``count``; empty if none is meaningful, or the estimate has neither disparity nor flow.

    Examples
    --------
    >>> truth, everywhere = np.array([38.0, 38.1, 38.4]), np.ones(3, dtype=bool)
    >>> meaningful_rates({"disparity": Pair(truth + 0.01, truth)}, everywhere)
    ()
    >>> meaningful_rates({"disparity": Pair(truth + [0.0, 0.0, 9.0], truth)}, everywhere)
    ('disparity_rate',)
    """
    there = {part: names for part, names in _PARTS.items() if all(name in pairs for name in names)}
    rates = [part for part, names in there.items() if _may_fail(stacked(pairs, names), region)]
    both = len(there) == len(_PARTS)
    return (*rates, "scene_flow_rate") if rates and both else tuple(rates)


def _may_fail(vectors: Pair, region: Mask) -> bool:
    scored = region & _scored(vectors)
    if not scored.any():
        return False
    truth = vectors.truth[:, scored]
    guess = np.broadcast_to(np.median(truth, axis=1, keepdims=True), truth.shape)
    return any(bool(_is_outlier(values, truth).any()) for values in (guess, vectors.estimate[:, scored]))


def _scored(vectors: Pair) -> Mask:
    finite = np.isfinite(vectors.estimate).all(axis=0) & np.isfinite(vectors.truth).all(axis=0)
    return np.asarray(finite if vectors.full is None else finite & vectors.full)


def _is_outlier(estimate: Map, truth: Map) -> Mask:
    error = length(difference(estimate, truth))
    return np.asarray((error > OUTLIER_PX) & (error > OUTLIER_FRACTION * length(truth)))
