"""Continuous surfaces of a depth map: pixels between which the depth has no step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["STEEPEST_DEG", "fill_std", "label_surfaces"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEEPEST_DEG = 80.0
"""Angle between the normal and the ray above which neighbouring pixels belong to different surfaces."""
_JUMP_STDS = 4.0
_LEAST_SHARE, _LEAST_PIXELS, _LEAST_ENCLOSED = 1e-3, 64, 225
"""Least surfaces; those in a hole of another are wrong matches if they are smaller than half a window of 6 px."""
_STEEPEST_GAP_DEG, _WIDEST_GAP_PX = 60.0, 40.0
"""Slope and width of gaps over which surfaces continue."""


def label_surfaces(depth_mm: Floats, std_mm: Floats, focal_px: float) -> NDArray[np.int64]:
    """Return the numbers of the surfaces of a depth map from 1, the largest first; 0 where there is none.

    Neighbouring pixels belong to one surface unless the slope between them exceeds 80° by more than the noise. Surfaces
    on both sides of a gap are one if their depths agree.

    ``depth_mm``: NaN where the depth is invalid. ``std_mm``: Its standard deviations without gaps, see `fill_std`.
    """
    return _join(_label(depth_mm, std_mm, np.isfinite(depth_mm), focal_px), depth_mm, std_mm, focal_px)


def fill_std(std: Floats, known: Mask) -> Floats:
    """Return standard deviations without zeros and gaps; where they are missing, the nearest if above the median."""
    valid = known & np.isfinite(std) & (std > 0)
    if not valid.any():
        return np.ones(std.shape)
    typical = float(np.median(std[valid]))
    rows, columns = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.where(valid, np.maximum(std, 0.3 * typical), np.maximum(std[rows, columns], typical))


def _label(depth: Floats, std: Floats, known: Mask, focal_px: float) -> NDArray[np.int64]:
    """Return numbers of continuous surfaces from 1, by size; 0 where there is none."""
    index = np.arange(depth.size).reshape(depth.shape)
    steep, ends = np.tan(np.deg2rad(STEEPEST_DEG)) / focal_px, []
    for axis in (0, 1):
        one, other = _neighbours(axis)
        limit = steep * np.fmin(depth[one], depth[other]) + _JUMP_STDS * np.hypot(std[one], std[other])
        with np.errstate(invalid="ignore"):
            joined = known[one] & known[other] & (np.abs(depth[one] - depth[other]) <= limit)
        ends.append((index[one][joined], index[other][joined]))
    first, second = (np.concatenate(each) for each in zip(*ends, strict=True))
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(depth.size, depth.size))
    _, numbers = connected_components(graph, directed=False)
    numbers = np.where(known, numbers.reshape(depth.shape), -1)
    values, sizes = np.unique(numbers[known], return_counts=True)
    least = max(_LEAST_PIXELS, _LEAST_SHARE * depth.size)
    labels, place = np.zeros(depth.shape, dtype=np.int64), 0
    for which in np.argsort(-sizes, kind="stable"):
        inside = numbers == values[which]
        if sizes[which] >= least and not (sizes[which] < _LEAST_ENCLOSED and _is_enclosed(inside, labels)):
            place += 1
            labels[inside] = place
    return labels


def _join(labels: NDArray[np.int64], depth: Floats, std: Floats, focal_px: float) -> NDArray[np.int64]:
    """Return labels in which surfaces on both sides of a gap are one if their depths agree, the largest first.

    Half of the pairs of nearest pixels across the gap must differ by less than a slope of 60° over their distance.
    """
    if labels.max() < 2:
        return labels
    places = np.stack(ndimage.distance_transform_edt(labels == 0, return_distances=False, return_indices=True))
    owner, near, deviation = (each[tuple(places)] for each in (labels, depth, std))
    votes: dict[tuple[int, int], list[NDArray[np.bool_]]] = {}
    for axis in (0, 1):
        one, other = _neighbours(axis)
        meets = owner[one] != owner[other]
        here, there = (np.stack([each[side][meets] for each in (owner, near, deviation)]) for side in (one, other))
        gap = np.hypot(*(places[(slice(None), *one)][:, meets] - places[(slice(None), *other)][:, meets]))
        limit = np.tan(np.deg2rad(_STEEPEST_GAP_DEG)) / focal_px * np.minimum(here[1], there[1]) * gap
        agrees = np.abs(here[1] - there[1]) <= limit + _JUMP_STDS * np.hypot(here[2], there[2])
        agrees &= gap <= _WIDEST_GAP_PX
        first, second = (
            each.astype(np.int64) for each in (np.minimum(here[0], there[0]), np.maximum(here[0], there[0]))
        )
        for pair in np.unique(np.stack([first, second]), axis=1).T.tolist():
            votes.setdefault((pair[0], pair[1]), []).append(agrees[(first == pair[0]) & (second == pair[1])])
    joined = [pair for pair, each in votes.items() if np.concatenate(each).mean() >= 0.5]
    ends = np.array(joined, dtype=np.int64).reshape(-1, 2).T
    size = int(labels.max()) + 1
    graph = coo_array((np.ones(ends.shape[1], dtype=np.int8), (ends[0], ends[1])), shape=(size, size))
    _, group = connected_components(graph, directed=False)
    merged = np.where(labels > 0, group[labels], -1)
    values, sizes = np.unique(merged[labels > 0], return_counts=True)
    found = np.zeros_like(labels)
    for place, which in enumerate(np.argsort(-sizes, kind="stable")):
        found[merged == values[which]] = place + 1
    return found


def _is_enclosed(inside: Mask, labels: NDArray[np.int64]) -> bool:
    """Return whether a surface fills a hole of a larger one."""
    return any(
        bool(ndimage.binary_fill_holes(labels == number)[inside].all()) for number in range(1, int(labels.max()) + 1)
    )


def _neighbours(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    first, second = [slice(None)] * 2, [slice(None)] * 2
    first[axis], second[axis] = slice(None, -1), slice(1, None)
    return tuple(first), tuple(second)
