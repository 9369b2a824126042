"""Registration: integer image shifts along s and t, the cells in which each is tried, and the tiles of the threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from scenetruth.compilation import thread_count
from scenetruth.threads import bands, in_threads

__all__ = [
    "CELL",
    "Rectangle",
    "Registration",
    "find_working_point",
    "find_working_point_of_flow",
    "registrations_along_surfaces",
    "registrations_from_coarse",
    "split_into_tiles",
]


CELL = 16
"""Side length in px of the cells for which registrations are selected."""

_SMALLEST_RANGE = 16
# A disparity far from the current best must have less than this fraction of its cost: a false match in a periodic
# texture has about the same cost.
_CLEARLY_BETTER = 0.5
_STILL = 0.75  # flows up to this are estimated without registration, px per frame
# Offsets from the nearest disparity that are also tried: at some of them, the divergence has a smaller uncertainty.
_OFF = (0, -1, 1, -2, 2)
_SHARE = 0.15  # a registration must fit in more than this fraction of a cell to be tried there


@dataclass(frozen=True, eq=False)
class Registration:
    """A registration: integer disparity and integer flow, and the cells of the image in which it is tried."""

    disparity: int
    """Disparity, px per step of s: image s is read ``disparity s`` columns to the left."""
    flow: tuple[int, int] = (0, 0)
    """Flow along x and y, px per frame: frame t is read ``flow t`` further."""
    cells: NDArray[np.bool_] | None = None
    """Cells of `CELL` px in which it is tried; None for all."""
    fits: NDArray[np.bool_] | None = None
    """Cells in which it fits, rather than being tried next to another that fits; None if not determined."""


def find_working_point(grey: NDArray[Any], positions: NDArray[np.float64] | None = None) -> int:
    """Return the integer disparity at which the images of all cameras agree best.

    The horizontal differences of neighbouring cameras, and of cameras two steps apart, are correlated along x over all
    rows, and the correlations are summed over all pairs. The surface with the most texture determines the result.

    ``grey``: Images of one frame, shape (s, y, x), in order of s; any scale. Channels are additional rows.
    Returns: Disparity in px per step of s (positive: x_s = x_0 - disparity s); 0 for images without texture.
    """
    count, _, width = grey.shape
    if count < 2:
        return 0
    steps = np.arange(count, dtype=np.float64) if positions is None else positions
    detail = np.diff(grey.astype(np.float64), axis=2)
    detail[np.isnan(detail)] = 0.0  # at invalid pixels
    padded = fft.next_fast_len(2 * width, real=True)
    spectra = fft.rfft(detail, padded, axis=2, workers=thread_count())
    limit = int((width - 1) // (2 * np.diff(steps).min()))
    candidates = np.arange(-limit, limit + 1)
    total = np.zeros(len(candidates))
    for step in (1, 2):
        for first in range(count - step):
            cross = np.sum(spectra[first] * np.conj(spectra[first + step]), axis=0)
            correlation = fft.irfft(cross, padded)
            moved = np.rint(candidates * (steps[first + step] - steps[first])).astype(np.int64)
            inside = np.abs(moved) < width
            total[inside] += correlation[moved[inside] % padded] / (count - step)
    return int(candidates[_best(total, np.abs(candidates))])


def find_working_point_of_flow(grey: NDArray[Any]) -> tuple[int, int]:
    """Return the integer flow (x, y), px per frame, at which frames ([channel,] t, y, x) agree best; (0, 0) if none."""
    count, height, width = grey.shape[-3:]
    if count < 2:
        return 0, 0
    images = grey.astype(np.float32).reshape(-1, count, height, width)
    detail = images[..., 1:-1, 1:-1] * 4 - images[..., :-2, 1:-1] - images[..., 2:, 1:-1]
    detail -= images[..., 1:-1, :-2] + images[..., 1:-1, 2:]
    detail[np.isnan(detail)] = 0.0  # at invalid pixels
    shape = [fft.next_fast_len(size + size // 2, real=True) for size in detail.shape[-2:]]
    spectra = fft.rfft2(detail, shape, workers=thread_count())
    cross = np.sum(np.conj(spectra[:, :-1]) * spectra[:, 1:], axis=(0, 1))
    correlation = fft.irfft2(cross, shape, workers=thread_count())
    reach_y, reach_x = height // 4, width // 4
    rows, columns = np.arange(-reach_y, reach_y + 1), np.arange(-reach_x, reach_x + 1)
    near = correlation[np.ix_(rows % shape[0], columns % shape[1])]
    distance = np.hypot(rows[:, None], columns[None, :])
    at = _best(near.ravel(), distance.ravel(), margin=1e-3)
    y, x = np.unravel_index(at, near.shape)
    return int(columns[x]), int(rows[y])


def _best(total: NDArray[Any], distance: NDArray[Any], margin: float = 1e-9) -> int:
    """Return the index of the highest peak; of equal peaks (periodic patterns) the smallest displacement."""
    peak = total.max()
    peaks = np.flatnonzero(total >= peak * (1 - margin)) if peak > 0 else np.arange(total.size)
    return int(peaks[np.argmin(distance[peaks])])


def registrations_along_surfaces(
    images: NDArray[Any], positions: NDArray[np.float64], largest: int
) -> list[Registration]:
    """Return the disparities at which the images (channel, s, y, x) of a frame agree, with the cells of each."""
    # Those of a store cannot be written to: with those of memory likewise, kernels have one signature.
    channels = np.ascontiguousarray(images, dtype=np.float32).view()
    channels.flags.writeable = False
    middle = find_working_point(np.concatenate(channels, axis=1), positions)
    reach = max(_SMALLEST_RANGE, images.shape[-1] // 16)
    wanted = [middle + offset for offset in sorted(range(-reach, reach + 1), key=abs)]
    disparities = np.array([value for value in wanted if abs(value) <= largest] or [0], dtype=np.int64)
    chosen, step = _sweep(channels, positions, disparities)
    return _for_cells([(int(value), 0, 0) for value in disparities], chosen, step, images.shape[-2:], largest)


def _sweep(
    images: NDArray[np.float32], positions: NDArray[np.float64], disparities: NDArray[np.int64]
) -> tuple[NDArray[np.int64], int]:
    """Return the index of the best disparity (if distant, clearly the best) at grid points, and the grid step in px."""
    from scenetruth.estimators.structure_tensor.registration_kernels import STEP, matching_costs

    height, width = images.shape[2:]
    offsets = -np.rint(disparities[:, None] * positions).astype(np.int64)
    # Distant cameras have larger shifts: their differences are weighted by the inverse square of the distance.
    weights = (1 / np.diff(positions) ** 2).astype(np.float32)
    costs = np.empty((len(disparities), -(-height // STEP), -(-width // STEP)), dtype=np.float32)
    in_threads(partial(matching_costs, images, offsets, weights, costs), bands(len(disparities)))
    best = np.zeros(costs.shape[1:], dtype=np.int64)
    least = costs[0].copy()
    for index in range(1, len(disparities)):
        near = np.abs(disparities[index] - disparities[best]) <= 1
        better = costs[index] < least * np.where(near, 1.0, _CLEARLY_BETTER)
        best[better] = index
        least[better] = costs[index][better]
    return best, STEP


def registrations_from_coarse(
    disparity: NDArray[Any], flow: NDArray[Any], known: NDArray[np.bool_], shape: Sequence[int], largest: int
) -> list[Registration]:
    """Return the registrations for an estimate at half resolution: disparity (y, x), flow (2, y, x) and validity."""
    if not known.any():
        return [Registration(0)]
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    triple = np.stack([disparity, flow[0], flow[1]])[:, *nearest] * 2
    triple = ndimage.median_filter(triple, size=(1, 5, 5))
    triple[0] = np.clip(triple[0], -largest, largest)
    triple[1:][np.abs(triple[1:]) < _STILL] = 0
    whole = np.rint(triple).astype(np.int64)
    found, chosen = np.unique(whole.reshape(3, -1), axis=1, return_inverse=True)
    wanted = [(int(w), int(x), int(y)) for w, x, y in found.T]
    return _for_cells(wanted, chosen.reshape(disparity.shape), 2, shape, largest)


def _for_cells(
    wanted: Sequence[tuple[int, int, int]], chosen: NDArray[Any], scale: int, shape: Sequence[int], largest: int
) -> list[Registration]:
    """Return the registrations with their cells, from a map of choices on a grid of every ``scale``-th pixel."""
    rows, columns = (-(-size // CELL) for size in shape)
    step = CELL // scale
    gathered: dict[tuple[int, int, int], NDArray[np.bool_]] = {}
    fits: dict[tuple[int, int, int], NDArray[np.bool_]] = {}
    for index, (disparity, flow_x, flow_y) in enumerate(wanted):
        here = np.zeros((rows * step, columns * step), dtype=np.float32)
        part = chosen[: rows * step, : columns * step] == index
        if not part.any():
            continue
        here[: part.shape[0], : part.shape[1]] = part
        share = here.reshape(rows, step, columns, step).mean(axis=(1, 3))
        cells = share > _SHARE
        if cells.any():
            # Pixels at the border of a cell also view the surfaces of its neighbours.
            grown = ndimage.binary_dilation(cells)
            fits[disparity, flow_x, flow_y] = grown
            for off in _OFF:
                near = (int(np.clip(disparity + off, -largest, largest)), flow_x, flow_y)
                gathered[near] = gathered.get(near, False) | grown
    nowhere = np.zeros((rows, columns), dtype=bool)
    return [Registration(key[0], key[1:], cells, fits.get(key, nowhere)) for key, cells in gathered.items()]


class Rectangle(NamedTuple):
    """A part of the image; ``bottom`` and ``right`` are the last row and column + 1."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def is_empty(self) -> bool:
        """Whether it contains no pixel."""
        return self.bottom <= self.top or self.right <= self.left


# The rows of a tile share the work at its border; the tiles of all threads may require 256 MB of scratch memory.
_ROWS, _COLUMNS = 256, 512
_ROWS_OF_ALL_THREADS, _BORDER = 1900, 28
# Tiles of scattered cells are lower, to follow their outline; runs closer than the border of a window are joined.
_LOW_ROWS, _JOIN = 4 * CELL, 32


def split_into_tiles(area: Rectangle, cells: NDArray[np.bool_] | None, threads: int) -> NDArray[np.int64]:
    """Return tiles (n, 4) of the cells (None: all), several per thread: first and last + 1 row, then column, int64."""
    top, bottom, left, right = area
    if area.is_empty:
        return np.empty((0, 4), dtype=np.int64)
    tiles: list[Rectangle] = []
    if cells is None:
        most = min(max(_ROWS_OF_ALL_THREADS // threads - _BORDER, 32), _ROWS)
        row_edges = _edges(top, bottom, max(threads, -(-(bottom - top) // most)))
        column_edges = _edges(left, right, -(-(right - left) // _COLUMNS))
        tiles = [Rectangle(*rows, *columns) for rows in pairwise(row_edges) for columns in pairwise(column_edges)]
    else:
        for first in range(top - top % _LOW_ROWS, bottom, _LOW_ROWS):
            rows = max(first, top), min(first + _LOW_ROWS, bottom)
            wanted = np.any(cells[first // CELL : -(-rows[1] // CELL)], axis=0, keepdims=True)[0]
            for start, stop in _runs(wanted):
                columns = max(start, left), min(stop, right)
                if columns[0] < columns[1]:
                    edges = _edges(*columns, -(-(columns[1] - columns[0]) // _COLUMNS))
                    tiles += [Rectangle(*rows, *part) for part in pairwise(edges)]
    return np.array(tiles, dtype=np.int64).reshape(-1, 4)


def _edges(first: int, last: int, count: int) -> list[int]:
    return [int(edge) for edge in np.linspace(first, last, min(count, last - first) + 1)]


def _runs(wanted: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the runs of requested cells in px, with close runs joined."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for start, stop in zip(steps[::2] * CELL, steps[1::2] * CELL, strict=True):
        if runs and start - runs[-1][1] < _JOIN:
            runs[-1] = (runs[-1][0], int(stop))
        else:
            runs.append((int(start), int(stop)))
    return runs
