"""Detection of grids of dots with three hollow dots, as programs for digital image correlation (DIC) use them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.boards import DotGrid
from scenetruth.capture.calibration.start_values import fit_homography

__all__ = ["Blobs", "find_blobs", "match_marked_grid"]

Array = NDArray[np.float64]

_LEAST_AREA_PX = 12.0
_ROUND = 0.88
"""Least ratio of the area of a blob to that of the ellipse with its extent: dots have 0.95 to 1."""
_HOLES = (0.005, 0.6)
"""Range of the area of the hole of a hollow dot, relative to the dot."""
_CONCENTRIC = 0.3
"""Largest distance of a hole from the centre of its dot, in radii."""
_DOT_RADIUS, _GROUND_RADIUS, _HOLE_CONTRAST = 0.6, 1.4, 0.2
"""Radii at which the dot and its ground are seen, and least contrast of a hole relative to theirs."""
_NEAR = 0.3
"""Largest distance of a dot from its expected place, in units of the distance to its neighbours."""
_FEWEST = 12
_MISFIT = 0.15
"""Largest 90th percentile of the distance of dots from a plane grid, in units of their distances."""
_LEAST_SHARE = 0.6
"""Least share of the dots within the extent of a grid that belong to it."""
_BLOCKS = (8, 20)
"""The local threshold averages over the longer side of the image divided by these."""
_MOST_MARKERS = 8


@dataclass(frozen=True, eq=False)
class Blobs:
    """Round dark spots of an image.

    ``centres``: Centres, shape (n, 2).
    ``areas``: Areas in px², holes included, shape (n,).
    ``hollow``: Which of them have a hole, shape (n,).
    """

    centres: Array
    areas: Array
    hollow: NDArray[np.bool_]


def find_blobs(grey: NDArray[np.uint8], block: int) -> Blobs:
    """Return round dark spots: darker than the mean over a square of ``block`` px about each pixel."""
    import cv2

    size = max(block | 1, 3)
    black = cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, size, 12)
    contours, hierarchy = cv2.findContours(black, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    centres, areas, hollow = [], [], []
    for number, contour in enumerate(contours):
        if hierarchy[0][number][3] >= 0:
            continue
        seen = _moments(contour)
        if seen is None or not _is_inside(contour, grey.shape):
            continue
        centre, area, roundness = seen
        if roundness < _ROUND:
            continue
        centres.append(centre)
        areas.append(area)
        hollow.append(_has_hole(contours, hierarchy[0], number, centre, area) or _is_bright_inside(grey, contour))
    return Blobs(np.array(centres).reshape(-1, 2), np.array(areas), np.array(hollow, dtype=bool))


def _moments(contour: Any) -> tuple[Array, float, float] | None:
    """Return centre, area, and the ratio of the area to that of the ellipse with the same second moments."""
    import cv2

    m = cv2.moments(contour)
    if m["m00"] < _LEAST_AREA_PX:
        return None
    centre = np.array([m["m10"], m["m01"]]) / m["m00"]
    determinant = (m["mu20"] * m["mu02"] - m["mu11"] ** 2) / m["m00"] ** 2
    # An ellipse has the area 4 pi times the root of the determinant of its second moments.
    return centre, float(m["m00"]), float(m["m00"] / (4 * np.pi * np.sqrt(max(determinant, 1e-12))))


def _is_inside(contour: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a contour does not touch the border of the image."""
    x, y = contour[:, 0, 0], contour[:, 0, 1]
    return bool(x.min() > 0 and y.min() > 0 and x.max() < shape[1] - 1 and y.max() < shape[0] - 1)


def _has_hole(contours: Sequence[Any], hierarchy: Any, number: int, centre: Array, area: float) -> bool:
    """Return whether a contour has one hole about its centre."""
    child, radius = int(hierarchy[number][2]), np.sqrt(area / np.pi)
    while child >= 0:
        found = _moments(contours[child])
        small = found is None
        if found is not None and _HOLES[0] * area < found[1] < _HOLES[1] * area:
            return bool(np.hypot(*(found[0] - centre)) < _CONCENTRIC * radius)
        if small:
            inside = contours[child][:, 0].mean(axis=0)
            size = len(contours[child])
            if size >= 4 and np.hypot(*(inside - centre)) < _CONCENTRIC * radius and size**2 > _HOLES[0] * area:
                return True
        child = int(hierarchy[child][0])
    return False


def _is_bright_inside(grey: NDArray[np.uint8], contour: Any) -> bool:
    """Return whether the middle of a dot is brighter than the dot about it; small holes do not reach the threshold."""
    import cv2

    m = cv2.moments(contour)
    centre = np.array([m["m10"], m["m01"]]) / m["m00"]
    spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
    values, vectors = np.linalg.eigh(spread)
    # The semi-axes of an ellipse are twice the roots of its second moments.
    axes = 2 * vectors * np.sqrt(np.maximum(values, 0.0))
    around = np.array([[np.cos(angle), np.sin(angle)] for angle in np.arange(16) * np.pi / 8]) @ axes.T
    places = np.concatenate([centre[None], centre + _DOT_RADIUS * around, centre + _GROUND_RADIUS * around])
    x, y = places.astype(np.float32).T
    values = cv2.remap(grey, x[None], y[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0].astype(np.float64)
    middle, dot, ground = values[0], float(np.median(values[1:17])), float(np.median(values[17:]))
    return bool(middle - dot > _HOLE_CONTRAST * max(ground - dot, 1.0))


def match_marked_grid(grey: NDArray[np.uint8], board: DotGrid) -> tuple[NDArray[np.int64], Array, str]:
    """Return indices and centres of the dots of a grid with three hollow dots, or the reason why there are none."""
    assert board.markers is not None
    reason = ""
    for share in _BLOCKS:
        blobs = find_blobs(grey, max(grey.shape) // share)
        markers = np.flatnonzero(blobs.hollow).tolist()
        if not 3 <= len(markers) <= _MOST_MARKERS:
            reason = reason or f"{len(blobs.areas)} dots and {len(markers)} hollow dots detected, of 3"
            continue
        best: dict[tuple[int, int], int] = {}
        for chosen in permutations(markers, 3):
            grid = _grow(blobs, tuple(_to_lattice(place, board) for place in board.markers), chosen)
            if len(grid) > len(best):
                best = grid
        named = {_from_lattice(place, board): blob for place, blob in best.items()}
        kept = {place: blob for place, blob in named.items() if _is_on(place, board.dots)}
        if len(kept) >= _FEWEST:
            places = np.array(sorted(kept, key=lambda place: (place[1], place[0])))
            found = np.array([kept[tuple(place)] for place in places.tolist()])
            return places[:, 1] * board.dots[0] + places[:, 0], blobs.centres[found], ""
        reason = f"{len(kept)} dots about three hollow dots, of at least {_FEWEST}; check board.markers"
    return np.empty(0, dtype=np.int64), np.empty((0, 2)), reason


def _to_lattice(place: tuple[int, int], board: DotGrid) -> tuple[int, int]:
    """Return the place of a dot on a square lattice; that of an asymmetric grid runs along its diagonals."""
    column, row = place
    if board.kind == "dots":
        return place
    across = 2 * column + row % 2
    return (across + row) // 2, (row - across) // 2


def _from_lattice(place: tuple[int, int], board: DotGrid) -> tuple[int, int]:
    """Return column and row of a place on the lattice."""
    if board.kind == "dots":
        return place
    across, row = place[0] - place[1], place[0] + place[1]
    return (across - row % 2) // 2, row


def _is_on(place: tuple[int, int], dots: tuple[int, int]) -> bool:
    return 0 <= place[0] < dots[0] and 0 <= place[1] < dots[1]


def _grow(blobs: Blobs, places: tuple[tuple[int, int], ...], chosen: tuple[int, ...]) -> dict[tuple[int, int], int]:
    """Return the dots of a grid by their column and row, from three of them; empty if the grid is mirrored."""
    origin, *others = (blobs.centres[index] for index in chosen)
    steps = np.array(places[1:], dtype=np.float64) - places[0]
    u, v = np.linalg.solve(steps, np.array(others) - origin)
    if u[0] * v[1] - u[1] * v[0] <= 0:
        return {}
    grid = dict(zip(places, chosen, strict=True))
    taken, before = set(grid.values()), 0
    expect: Callable[[Array], Array] = lambda where: origin + (where - places[0]) @ np.stack([u, v])  # noqa: E731
    while len(grid) > before:
        before = len(grid)
        for place in list(grid):
            for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                near = (place[0] + step[0], place[1] + step[1])
                if near in grid:
                    continue
                # The difference of the expectations is more exact than the expectation itself.
                guess = blobs.centres[grid[place]] + expect(np.array(near)) - expect(np.array(place))
                away = np.hypot(*(blobs.centres - guess).T)
                nearest = int(away.argmin())
                if away[nearest] < _NEAR * min(np.hypot(*u), np.hypot(*v)) and nearest not in taken:
                    grid[near] = nearest
                    taken.add(nearest)
        if len(grid) >= _FEWEST:
            where = np.array(list(grid), dtype=np.float64)
            homography = fit_homography(where, blobs.centres[list(grid.values())])
            expect = _through(homography)
    return grid if _is_lattice(blobs, grid, expect) else {}


def _is_lattice(blobs: Blobs, grid: dict[tuple[int, int], int], expect: Callable[[Array], Array]) -> bool:
    """Return whether dots are a plane grid, and no dot lies half-way between neighbours."""
    if len(grid) < _FEWEST:
        return False
    where, seen = np.array(list(grid), dtype=np.float64), blobs.centres[list(grid.values())]
    shown = np.array([expect(place) for place in where])
    step = np.array([expect(place + [1.0, 0.0]) for place in where]) - shown
    other = np.array([expect(place + [0.0, 1.0]) for place in where]) - shown
    away = np.hypot(*(seen - shown).T) / np.minimum(np.hypot(*step.T), np.hypot(*other.T))
    if np.percentile(away, 90) > _MISFIT:
        return False
    # Every dot within the grid is a part of it.
    low, high = seen.min(axis=0), seen.max(axis=0)
    inside = ((blobs.centres > low) & (blobs.centres < high)).all(axis=1)
    return bool(len(grid) > _LEAST_SHARE * inside.sum())


def _through(homography: Array) -> Callable[[Array], Array]:
    def expect(where: Array) -> Array:
        image = homography @ np.append(where, 1.0)
        return np.asarray(image[:2] / image[2])

    return expect
