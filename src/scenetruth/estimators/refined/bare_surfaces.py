"""Planes of bare surfaces from the displacement of their outlines in the other views.

A surface without texture has no disparity of its own, but its outlines have. Each outline moves with the nearer of the
two surfaces that meet there. A bare surface is therefore at most as near as any of its outlines, and as near as those
that are its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.bare_surfaces import compare_ends, find_ends
from scenetruth.estimators.refined.other_views import OtherViews

__all__ = ["BarePlane", "find_bare_areas", "fit_bare_surfaces"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEAST_PIXELS = 49  # that of a census square
# An area ends where the gradients of its outline begin: adjacent pixels up to this distance belong to it, whose grey
# value is its own up to these deviations of the noise, in squares of this size: a few pixels may agree by chance.
_BEYOND_PX, _SAME_GREY, _CHANCE_PX = 4, 2.5, 4
_MEAN_PX = 4.0  # window of the mean grey value
# Rows of an area are compared up to this distance from their ends; differences up to these deviations are noise.
_REACH_PX, _TOLERANCE = 32, 3.0
_PIECE_ROWS, _LEAST_ROWS = 24, 6  # largest and smallest number of rows of a piece of an outline
_STEP_PX, _MOST_HYPOTHESES = 0.25, 400  # step of the hypotheses in px of the farthest camera, and their number
# Increase of the cost at which its flanks are measured, and displacement beyond them that must increase it further, in
# px of the farthest camera; smallest of these increases, relative to that of an outline without noise.
_LEVEL_PX, _APART_PX, _CLEAR = 0.5, 2.0, 0.3
_BESIDE_PX = 8  # distance of adjacent surfaces
_AGREE_PX = 1.0  # deviation of outlines from their plane, in px of the farthest camera
_NEARER = 0.15  # largest fraction of outlines that are farther than the plane
_PREFERRED = 1.1  # ratio of the numbers of rows from which another plane is preferred
# Deviation from an adjacent plane in which a bare surface lies, and smallest error of a piece, relative to _AGREE_PX.
_COPLANAR, _ERROR_PX = 0.3, 0.3
_SLOPE = 0.01  # prior deviation of slopes, in px per px
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class BarePlane:
    """Plane of a bare surface."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    """Its pixels."""
    plane: Map
    """Disparity at the origin of the image, and slopes."""
    error: float
    """Deviation of the outlines from the plane, in px per step."""
    enclosed: float
    """Fraction of the area whose rows end at both sides in this plane, times the fraction of outlines in it; 0 at
    the border of the image."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of outlines: surface, centre, number of rows and disparity of each; ends, and piece of each end."""

    label: NDArray[np.int32]
    x: Map
    y: Map
    rows: Map
    disparity: Map
    clear: Mask
    ends: NDArray[np.int32]


def find_bare_areas(grey: Map, noise: float, textured: Mask) -> NDArray[np.int32]:
    """Return the numbers of the bare areas, up to their outlines; 0 elsewhere."""
    from scipy import ndimage

    areas, count = ndimage.label(~textured)
    sizes = np.bincount(areas.ravel(), minlength=count + 1)
    sizes[0] = 0
    areas = np.where(sizes[areas] >= _LEAST_PIXELS, areas, 0).astype(np.int32)
    mean = _local_means(grey, areas > 0)
    apart, nearest = ndimage.distance_transform_edt(areas == 0, return_indices=True)
    same = np.abs(grey - mean[nearest[0], nearest[1]]) < _SAME_GREY * noise
    # Grey values of an adjacent texture are the same by chance in a few pixels only.
    whole = (areas > 0) | ndimage.binary_opening((apart <= _BEYOND_PX) & same, np.ones((_CHANCE_PX, _CHANCE_PX)))
    return np.where(whole, areas[nearest[0], nearest[1]], 0).astype(np.int32)


def measure_outlines(
    areas: NDArray[np.int32], grey: Map, noise: float, views: OtherViews, limits: tuple[float, float]
) -> Pieces:
    """Return the pieces of the outlines of bare areas, with the disparities with which they move.

    ``limits``: Smallest and largest disparity, positive.
    """
    farthest = float(np.abs(views.positions).max())
    # Along a row, every change of labels ends one run and begins another.
    size = 2 * int((np.diff(areas, axis=1) != 0).sum()) + 2 * len(areas)
    ends = np.zeros((size, 6), dtype=np.int32)
    ends = ends[: find_ends(areas, _PIECE_ROWS, ends)]
    count = int(ends[:, 4].max(initial=-1)) + 1
    rows = np.bincount(ends[:, 4], minlength=count).astype(np.float64)
    x, y = (np.bincount(ends[:, 4], ends[:, n], count) / np.maximum(rows, 1) for n in (0, 1))
    label = np.zeros(count, dtype=np.int32)
    label[ends[:, 4]] = areas[ends[:, 1], ends[:, 0]]
    step = max(_STEP_PX / farthest, (limits[1] - limits[0]) / _MOST_HYPOTHESES)
    hypotheses = np.arange(limits[0], limits[1] + step, step)
    costs, weights = np.zeros((count, len(hypotheses))), np.zeros(count)
    mean = _means_by_area(grey, areas)
    moved = -views.positions[:, None] * hypotheses - views.shifts[:, None]
    compare_ends(ends, _REACH_PX, grey, mean, views.grey, moved, _TOLERANCE * noise, costs, weights)
    # A px per step displaces an outline by this much, on average over the views.
    per_px = float(np.abs(views.positions).mean()) / 2
    costs /= np.maximum(weights, 1e-30)[:, None] * per_px
    best = np.argmin(costs, axis=1) if count else np.zeros(0, dtype=np.int64)
    least = costs[np.arange(count), best]
    disparity, clear = np.empty(count), np.zeros(count, dtype=np.bool_)
    apart = int(np.ceil(_APART_PX / farthest / step))
    for n in range(count):
        sides = []
        for way in (-1, 1):
            # The flanks differ in slope where a view does not contain the outline: their feet are extrapolated.
            near, far = (
                _crossing(costs[n] - least[n] - level * _LEVEL_PX / farthest, int(best[n]), way) for level in (1, 2)
            )
            sides.append(2.0 * near - far if way * (far - near) < apart else near)
        low, high = sides
        disparity[n] = hypotheses[0] + 0.5 * (low + high) * step
        first, last = int(min(low, best[n])), int(np.ceil(max(high, best[n])))
        outside = np.concatenate([costs[n, : max(first - apart, 0)], costs[n, last + apart + 1 :]])
        enough = outside.min(initial=np.inf) - least[n] > _CLEAR * _APART_PX / farthest
        clear[n] = rows[n] >= _LEAST_ROWS and high - low < 4 * apart and enough
        clear[n] &= apart <= first and last < len(hypotheses) - apart
    return Pieces(label, x, y, rows, disparity, clear, ends)


def _crossing(above: Map, start: int, way: int) -> float:
    """Return the fractional index at which values become positive, from an index in one direction."""
    n = start
    while 0 <= n + way < len(above) and above[n + way] <= 0:
        n += way
    if not 0 <= n + way < len(above):
        return float(n)
    return n + way * float(above[n] / (above[n] - above[n + way]))


def fit_bare_surfaces(
    areas: NDArray[np.int32],
    grey: Map,
    noise: float,
    views: OtherViews,
    limits: tuple[float, float],
    surfaces: NDArray[np.int32],
    planes: Map,
) -> Iterator[BarePlane]:
    """Yield the planes of the bare areas whose outlines determine them.

    ``limits``: Smallest and largest disparity, positive.
    ``surfaces``: Number of the textured surface of every pixel, else -1.
    ``planes``: Their planes, as in `BarePlane`, shape (n, 3).
    """
    from scipy.ndimage import find_objects, maximum_filter

    pieces = measure_outlines(areas, grey, noise, views, limits)
    tolerance = _AGREE_PX / float(np.abs(views.positions).max())
    places = find_objects(areas)
    of_ends = pieces.label[pieces.ends[:, 4]]
    order = np.argsort(of_ends, kind="stable")
    for number in np.unique(pieces.label[pieces.clear]):
        part = tuple(slice(max(each.start - _BESIDE_PX, 0), each.stop + _BESIDE_PX) for each in places[number - 1])
        where = areas[part] == number
        beside = np.unique(surfaces[part][maximum_filter(where, 2 * _BESIDE_PX + 1)])
        own = np.flatnonzero((pieces.label == number) & pieces.clear)
        outlines = _Outlines(pieces.x[own], pieces.y[own], pieces.rows[own], pieces.disparity[own])
        plane = _choose_plane(outlines, planes[beside[beside >= 0]], tolerance)
        if plane is None:
            continue
        off = outlines.deviations(plane)
        agree = np.abs(off) < tolerance
        fitting = np.zeros(len(pieces.label), dtype=np.bool_)
        fitting[own[agree]] = True
        ends = pieces.ends[order[slice(*np.searchsorted(of_ends[order], (number, number + 1)))]]
        # Of the rows of the surface, those with both ends in its plane.
        both = fitting[ends[:, 4]] & (ends[:, 5] >= 0)
        both &= fitting[pieces.ends[np.maximum(ends[:, 5], 0), 4]]
        # What reaches the border of the image may be a background, seen between objects in the same plane.
        inner = all(each.start > 0 and each.stop < n for each, n in zip(places[number - 1], areas.shape, strict=True))
        share = outlines.rows[agree].sum() / outlines.rows.sum()
        enclosed = float(share * ends[both, 3].sum() / 2 / where.sum()) if inner else 0.0
        error = float(np.sqrt(np.average(off[agree] ** 2, weights=outlines.rows[agree])))
        y, x = np.nonzero(where)
        yield BarePlane(y + part[0].start, x + part[1].start, plane, error, enclosed)


@dataclass(frozen=True, eq=False)
class _Outlines:
    """Pieces of the outlines of one area: centre, number of rows, and disparity."""

    x: Map
    y: Map
    rows: Map
    disparity: Map

    @property
    def places(self) -> Map:
        """1, x and y of every piece."""
        return np.stack([np.ones(len(self.x)), self.x, self.y], axis=1)

    def deviations(self, plane: Map) -> Map:
        """Return the differences from a plane."""
        return np.asarray(self.disparity - self.places @ plane)


def _choose_plane(outlines: _Outlines, planes: Map, tolerance: float) -> Map | None:
    """Return the plane of most outlines that is not nearer than any other outline; None if there is none.

    ``planes``: Planes of adjacent surfaces, which are preferred.
    """
    flat = outlines.disparity[:, None] * np.array([1.0, 0.0, 0.0])
    rows = outlines.rows
    most, chosen, of_surface = 0.0, None, False
    for adjacent, candidates in ((True, planes), (False, flat)):
        for each in candidates:
            off = outlines.deviations(each)
            support = float(rows[np.abs(off) < tolerance].sum())
            nearer = rows[off < -tolerance].sum() > _NEARER * rows.sum()
            if not nearer and support > (_PREFERRED if most > 0 else 1.0) * most:
                most, chosen, of_surface = support, each, adjacent
    if chosen is None:
        return None
    off = outlines.deviations(chosen)
    agree = np.abs(off) < tolerance
    if of_surface and abs(np.average(off[agree], weights=rows[agree])) < _COPLANAR * tolerance:
        return np.asarray(chosen)
    plane = chosen
    for _ in range(_ROUNDS):
        fitted = _fit(outlines, agree, chosen, _ERROR_PX * tolerance)
        agree = np.abs(outlines.deviations(fitted)) < tolerance
        if not agree.any():
            break
        plane = fitted
    return np.asarray(plane)


def _fit(outlines: _Outlines, among: Mask, plane: Map, error: float) -> Map:
    """Return the plane through pieces of outlines, with the slopes of another plane as prior.

    ``error``: Smallest standard deviation of a disparity.
    """
    places, rows, rest = outlines.places[among], outlines.rows[among], outlines.deviations(plane)[among]
    centre = np.average(places, axis=0, weights=rows)
    offset = (places - centre)[:, 1:]
    mean = np.average(rest, weights=rows)
    variance = max(float(np.average((rest - mean) ** 2, weights=rows)), error**2)
    normal = (offset * rows[:, None]).T @ offset + rows.mean() * variance / _SLOPE**2 * np.eye(2)
    slopes = np.linalg.solve(normal, (offset * rows[:, None]).T @ (rest - mean))
    return np.asarray(plane + np.array([mean - slopes @ centre[1:], *slopes]))


def _means_by_area(grey: Map, areas: NDArray[np.int32]) -> Map:
    """Return smoothed grey values within the areas."""
    from scipy import ndimage

    mean = np.zeros_like(grey)
    for number, place in enumerate(ndimage.find_objects(areas), start=1):
        if place is not None:
            mask = areas[place] == number
            mean[place] = np.where(mask, _local_means(grey[place], mask), mean[place])
    return mean


def _local_means(grey: Map, mask: Mask) -> Map:
    """Return means of the grey values in a mask, within Gaussian windows."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(mask.astype(np.float64), _MEAN_PX)
    return np.asarray(gaussian_filter(np.where(mask, grey, 0.0), _MEAN_PX) / np.maximum(weight, 1e-12))
