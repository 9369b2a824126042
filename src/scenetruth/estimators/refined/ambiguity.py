"""Ambiguous matches: other minima of the photometric cost within the search range that noise does not distinguish.

A texture that repeats fits the images at several disparities or motions. The displacements at which the reference image
resembles itself are candidates for such minima. The images nearest to the reference, along the stage and in time, are
then compared with it at the fitted places and at those of each candidate, after refinement of the candidate. If the
differences of both are equal within noise, or those of the candidate are smaller, the match is ambiguous.

Amid a texture that repeats, and whose windows are mostly ambiguous or do not fit, those that fit do so by chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.aperture import ApertureContext
from scenetruth.estimators.refined.discontinuity_refit import find_hidden
from scenetruth.estimators.refined.fit_maps import extract_fields, find_discontinuities
from scenetruth.estimators.refined.image_stack import NO_DEFECTS, ImageStack
from scenetruth.estimators.refined.kernels.ambiguity import add_similarity, compare_windows
from scenetruth.estimators.refined.mean_image import MeanImage
from scenetruth.estimators.refined.rival_comparison import SAME, ImageComparison, MeanComparison, find_equal_rivals
from scenetruth.estimators.refined.row_bands import NO_OCCLUSION, around, mark_mostly, window_weights
from scenetruth.threads import in_threads

__all__ = ["SEARCHED_PX", "find_ambiguous", "find_chance_fits", "image_motion"]

SEARCHED_PX = 17
"""Largest change of motion that is tested along each axis, in px per frame: the range of the motion search, and one."""
_DISPARITY_SHARE = 0.25  # largest change of disparity in the nearest camera, as a fraction of the image width
_BLOCKS = 2.0  # blocks per standard deviation of a window
# Largest dissimilarity of a candidate, relative to that of unrelated textures: subpixel shifts and slopes, which the
# refinement removes, leave a third.
_CANDIDATE = 0.5
_RIVALS = 16  # candidates per window
_LEAST_INSIDE = 0.8  # smallest fraction of both displaced windows inside the image, of 2
_NEIGHBOURS = 5  # windows along each axis among which most decide
_REPEATING = 9  # windows along each axis among which a texture that repeats is valid in most, or in none
# Smallest share of pixels that fit, in a neighbourhood of this width in standard deviations of a window.
_NEAR, _BY_CHANCE = 8, 0.1
_TEXTURED = 3.0  # smallest variance of the grey values of a textured window, relative to that of noise
_BYTES = 64e6  # of the dissimilarities in memory

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Axis:
    """Images that are compared, and the displacements searched."""

    images: list[tuple[int, int]]
    """Indices of frame and camera."""
    factors: Map
    """Displacement of the images along x and y by a change of 1, shape (n, 2)."""
    nearest: float
    """Smallest of these displacements."""
    offsets: NDArray[np.int64]
    """Displacements (x, y) of the nearest image, shape (m, 2): half of a symmetric set."""
    both: bool


@dataclass(frozen=True, eq=False)
class _Windows:
    """Windows of one width, as a mask of the grid of windows."""

    sigma: float
    where: Mask


@dataclass(frozen=True, eq=False)
class _Repetition:
    """Windows that resemble others of the reference image, whatever their fit."""

    textured: Mask
    """Windows whose texture varies within the search range, as a mask of the grid; to be completed."""
    repeated: Mask
    """Those that resemble a displaced window; to be completed."""
    max_motion_px: float | None

    def add(self, values: NDArray[np.float32], axis: _Axis, places: NDArray[np.intp], powerful: Mask) -> None:
        """Add the windows of some rows of the grid, from their dissimilarities, shape (m, rows, columns)."""
        if axis.both:
            varied, again = _resembling_in_plane(values, axis, self.max_motion_px)
        else:
            # After the first displacement at which the texture has changed.
            changed = np.logical_or.accumulate((values > _CANDIDATE) & (values != 1.0), axis=0)
            varied = np.asarray(changed.any(axis=0))
            again = np.asarray((changed & (values < SAME)).any(axis=0))
        self.textured[places] |= varied & powerful
        self.repeated[places] |= again & powerful


def find_ambiguous(
    images: ImageStack,
    theta: Map,
    sigma_px: float,
    small: Mask,
    small_sigma_px: float,
    noise: float,
    where: Mask,
    aperture: ApertureContext,
    max_motion_px: float | None,
    outlines: Mask | None = None,
) -> Mask:
    """Return where another disparity, or another motion, fits the images as well.

    ``small``: Pixels whose windows have the smaller standard deviation, shape (y, x).
    ``where``: Pixels to be tested.
    ``max_motion_px``: Largest motion in columns per frame; rivals beyond it do not count.
    ``outlines``: Discontinuities, in whose neighbourhood the mean image does not decide; by default those of the fits.
    """
    found = np.zeros(images.shape, dtype=np.bool_)
    if not where.any() or not np.isfinite(noise):
        return found
    step = max(2, round(sigma_px))
    # The same windows in a tile as in the whole image.
    first = [min((step // 2 - at) % step, size - 1) for at, size in zip(images.corner[::-1], images.shape, strict=True)]
    rows, columns = (np.arange(at, size, step) for at, size in zip(first, images.shape, strict=True))
    grid = np.ix_(rows, columns)
    # Windows whose surroundings hold a pixel to be tested.
    tested = around(where, step) & np.isfinite(theta).all(axis=0)
    flags = np.zeros((len(rows), len(columns)), dtype=np.bool_)
    textured, repeated = flags.copy(), flags.copy()
    widths = ((sigma_px, ~small), (small_sigma_px, small))
    outlines = find_discontinuities(images, theta) if outlines is None else outlines
    mean = MeanImage(images, theta, ~around(outlines, math.ceil(2.0 * sigma_px)))
    for axis in (_disparity_axis(images), _motion_axis(images)):
        if axis is None:
            continue
        wanted = [_Windows(sigma, (tested & among)[grid] & ~flags) for sigma, among in widths]
        repetition = _Repetition(textured, repeated, max_motion_px)
        flags |= _rivalled(
            images, theta, axis, wanted, noise, (rows, columns), aperture, repetition, mean, occluded=bool(small.any())
        )
    flags |= mark_mostly(flags, tested[grid], _NEIGHBOURS)
    # Amid a texture that repeats, windows without a fit count as ambiguous.
    doubtful = textured & (flags | ~mark_mostly(where, ~where | where, step)[grid])
    flags |= mark_mostly(repeated, textured, _REPEATING) & mark_mostly(doubtful, textured, _REPEATING)
    # A pixel between the centres of windows is ambiguous if any of them is.
    near = []
    for start, size, count in zip(first, images.shape, flags.shape, strict=True):
        at = np.arange(size) - start
        near.append(np.clip(np.stack([at // step, -(-at // step)]), 0, count - 1))
    for down in near[0]:
        for right in near[1]:
            found |= flags[np.ix_(down, right)]
    found |= mark_mostly(found, where, 4 * step + 1)
    if max_motion_px is not None:
        with np.errstate(invalid="ignore"):
            found |= np.hypot(*image_motion(images, theta)) > max_motion_px
    return found & where


def find_chance_fits(violated: Mask, tested: Mask, sigma_px: float) -> Mask:
    """Return where a pixel fits and most of those around it do not: edges of a pattern, for example, fit in places."""
    size = _NEAR * round(sigma_px) + 1
    return tested & ~violated & mark_mostly(violated, tested, size, 1.0 - _BY_CHANCE)


def image_motion(images: ImageStack, theta: Map) -> Map:
    """Return the motion in the image in columns per frame, shape (2, y, x)."""
    y, x = np.mgrid[: images.shape[0], : images.shape[1]]
    rate = -theta[0] * theta[12] / images.focal
    across = theta[0] * theta[6] + rate * (x - images.centre[0])
    return np.stack([across, theta[0] * theta[9] + rate * (y - images.centre[1])])


def _disparity_axis(images: ImageStack) -> _Axis | None:
    """Return the nearest and the farthest cameras on both sides, at the time of the reference."""
    frame, camera = images.reference()
    s = images.positions - images.positions[camera]
    along = 0 if np.any((s[:, 0] != 0) & (s[:, 1] == 0)) else 1
    line = [n for n in range(len(s)) if s[n, along] != 0 and s[n, 1 - along] == 0]
    line = [n for n in line if (frame, n) not in images.left_out]
    if not line:
        return None
    taken: list[int] = []
    for sign in (-1.0, 1.0):
        side = sorted((n for n in line if sign * s[n, along] > 0), key=lambda n: abs(s[n, along]))
        taken += dict.fromkeys([*side[:1], *side[-1:]])
    nearest = float(np.abs(s[taken, along]).min())
    factors = -s[taken]
    reach = int(_DISPARITY_SHARE * images.shape[1 - along])
    offsets = np.zeros((reach, 2), dtype=np.int64)
    offsets[:, along] = np.arange(1, reach + 1)
    return _Axis([(frame, n) for n in taken], factors, nearest, offsets, both=False)


def _motion_axis(images: ImageStack) -> _Axis | None:
    """Return the frames before and after, and those at twice the distance, of the reference camera."""
    frame, camera = images.reference()
    t = images.times - images.times[frame]
    usable = [n for n in range(len(t)) if t[n] != 0 and (n, camera) not in images.left_out]
    if not usable:
        return None
    nearest = float(np.abs(t[usable]).min())
    taken = [n for n in usable if abs(t[n]) <= 2.0 * nearest + 1e-9]
    reach = max(int(SEARCHED_PX * nearest), 1)
    y, x = np.mgrid[0 : reach + 1, -reach : reach + 1]
    half = (y > 0) | (x > 0)
    offsets = np.stack([x[half], y[half]], axis=-1)
    return _Axis([(n, camera) for n in taken], np.repeat(t[taken, None], 2, axis=1), nearest, offsets, both=True)


def _mean_of_channels(images: ImageStack, frame: int, camera: int) -> NDArray[np.float32]:
    return np.asarray(images.coefficients[frame][:, camera].mean(axis=0), dtype=np.float32)


def _rivalled(
    images: ImageStack,
    theta: Map,
    axis: _Axis,
    wanted: list[_Windows],
    noise: float,
    at: tuple[NDArray[np.int64], NDArray[np.int64]],
    aperture: ApertureContext,
    repetition: _Repetition,
    mean: MeanImage,
    *,
    occluded: bool,
) -> Mask:
    """Return the windows with a rival, of a grid of rows and columns.

    ``occluded``: Whether there may be points behind nearer surfaces.
    """
    frame, camera = images.reference()
    grey = images.reference_grey()
    square = noise**2 * images.variance.at(grey) / images.channels
    flags = np.zeros(wanted[0].where.shape, dtype=np.bool_)
    every = _candidates(grey, square, axis, wanted, at, aperture, repetition)
    every = [_within(images, theta, axis, each, repetition.max_motion_px) for each in every]
    if not any(len(each) for each in every):
        return flags
    places = [n * len(images.positions) + camera for n, camera in axis.images]
    reference = np.repeat(np.where(images.usable(frame, camera), grey, np.nan)[None], len(places), axis=0)
    fields = np.ascontiguousarray(extract_fields(theta))
    # Points behind nearer surfaces fit no image.
    hidden = find_hidden(images, fields, places=places) if occluded else NO_OCCLUSION
    for n, each in enumerate(reference if hidden.size else ()):
        each[(hidden[n // 8] >> (n % 8)) & 1 > 0] = np.nan
    view = images.view_of(places)
    stack = np.stack([_mean_of_channels(images, *image) for image in axis.images])
    bad = np.stack([images.bad[n][camera] for n, camera in axis.images]) if images.bad else NO_DEFECTS
    for windows, candidates in zip(wanted, every, strict=True):
        if not len(candidates):
            continue
        weights = window_weights(windows.sigma)[0, 0]
        compared = ImageComparison(stack, reference, view, fields, bad, axis.factors, axis.both, square, weights)
        margin = np.abs(axis.offsets).max(axis=0).tolist()
        nearest = axis.factors[np.argmin(np.abs(axis.factors).max(axis=1))]
        in_mean = MeanComparison(mean, square, weights, nearest, axis.both, (margin[0], margin[1]))
        find_equal_rivals(candidates, flags, compared, in_mean)
    return flags


def _within(images: ImageStack, theta: Map, axis: _Axis, candidates: Map, max_motion_px: float | None) -> Map:
    """Return the candidates in the search range: disparities of the right sign, and motions up to a prior."""
    if not len(candidates):
        return candidates
    rows, columns = candidates[:, 0].astype(int), candidates[:, 1].astype(int)
    d = theta[0, rows, columns]
    if not axis.both:
        change = candidates[:, 2]
        return np.asarray(candidates[(d + change) * d > 0])
    if max_motion_px is None:
        return candidates
    flow = image_motion(images, theta)[:, rows, columns]
    moved = np.hypot(flow[0] + candidates[:, 2], flow[1] + candidates[:, 3])
    return np.asarray(candidates[moved <= max_motion_px])


def _candidates(
    grey: Map,
    square: Map,
    axis: _Axis,
    wanted: list[_Windows],
    at: tuple[NDArray[np.int64], NDArray[np.int64]],
    aperture: ApertureContext,
    repetition: _Repetition,
) -> list[Map]:
    """Return, for each width, row, column, changes, order, window indices and dissimilarity of candidates, (n, 8)."""
    from scipy.ndimage import gaussian_filter

    if not any(windows.where.any() for windows in wanted):
        return [np.zeros((0, 8)) for _ in wanted]
    sigma = wanted[0].sigma
    # Without the offsets of shading.
    plain = (grey - gaussian_filter(grey, 2.0 * sigma)).astype(np.float32)
    powerful = (gaussian_filter(plain**2, sigma) > _TEXTURED * square)[np.ix_(*at)]
    block = max(1, round(sigma / _BLOCKS))
    count = -(-grey.shape[0] // block)
    margin = int(np.ceil(2.0 * _BLOCKS)) + 1
    size = max(int(_BYTES / (8 * len(axis.offsets) * len(at[1])) * (at[0][-1] // block + 1) / len(at[0])), 8)
    found: list[list[Map]] = [[] for _ in wanted]
    for top in range(0, count, size):
        bottom = min(top + size, count)
        rows = max(top - margin, 0), min(bottom + margin, count)
        places = np.flatnonzero((at[0] // block >= top) & (at[0] // block < bottom))
        among = [windows for n, windows in enumerate(wanted) if n == 0 or windows.where[places].any()]
        similar = _similarity(plain, float(np.mean(square)), axis, among, block, rows, (at[0][places], at[1]))
        repetition.add(similar[0], axis, places, powerful[places])
        for windows, values in zip(among, similar, strict=True):
            number = next(n for n, each in enumerate(wanted) if each is windows)
            found[number].append(_minima(values, axis, places, at, windows.where, aperture))
    return [np.concatenate(each) if each else np.zeros((0, 8)) for each in found]


def _similarity(
    plain: NDArray[np.float32],
    variance: float,
    axis: _Axis,
    wanted: list[_Windows],
    block: int,
    rows: tuple[int, int],
    at: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> list[NDArray[np.float32]]:
    """Return the dissimilarities of windows to those at the displacements, 1 if unrelated, (m, rows, columns) each."""
    first, end = rows
    shape = (2, end - first, -(-plain.shape[1] // block))
    out = [np.empty((len(axis.offsets), len(at[0]), len(at[1])), dtype=np.float32) for _ in wanted]
    by = [
        (
            _block_weights(at[0] // block - first, shape[1], windows.sigma / block),
            _block_weights(at[1] // block, shape[2], windows.sigma / block),
        )
        for windows in wanted
    ]
    # Every other row of a block, two displacements, and two images.
    by_noise = 2.0 * block * -(-block // 2) * variance
    inside = [_insides(axis, weights, block, first, plain.shape) for weights in by]
    bands = [tuple(_band(weights) for weights in pair) for pair in by]

    def work(part: tuple[int, int]) -> None:
        sums = np.empty(shape, dtype=np.float32)
        for n in range(*part):
            sums[:] = 0.0
            right, down = (int(each) for each in axis.offsets[n])
            add_similarity(plain, right, down, block, first, sums)
            add_similarity(plain, -right, -down, block, first, sums)
            for pair, (of_rows, of_columns), values in zip(bands, inside, out, strict=True):
                shares = [
                    np.stack([of[k * step] for k in (1, -1)]) for of, step in ((of_rows, down), (of_columns, right))
                ]
                compare_windows(sums, *pair, *shares, by_noise, _LEAST_INSIDE, values[n])

    if wanted:
        in_threads(work, [(n, min(n + 8, len(axis.offsets))) for n in range(0, len(axis.offsets), 8)])
    return out


def _insides(
    axis: _Axis,
    weights: tuple[NDArray[np.float32], NDArray[np.float32]],
    block: int,
    first: int,
    shape: tuple[int, ...],
) -> tuple[dict[int, NDArray[np.float32]], dict[int, NDArray[np.float32]]]:
    """Return the fractions of windows inside the image after each displacement along y and x."""
    down, right = (sorted({*axis.offsets[:, k].tolist(), *(-axis.offsets[:, k]).tolist()}) for k in (1, 0))
    return (
        {n: _inside(weights[0], n, block, first, shape[0]) for n in down},
        {n: _inside(weights[1], n, block, 0, shape[1]) for n in right},
    )


def _block_weights(centres: NDArray[np.int64], count: int, sigma_blocks: float) -> NDArray[np.float32]:
    """Return the weights of blocks in the windows around some of them, of sum 1, shape (windows, blocks)."""
    distance = np.arange(count) - centres[:, None]
    weights = np.exp(-0.5 * (distance / sigma_blocks) ** 2) * (np.abs(distance) <= 2.0 * sigma_blocks)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float32)


def _band(weights: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the first block of every window and the weights from there on, shapes (windows,) and (windows, taps)."""
    used = weights > 0
    count = int(used.sum(axis=1).max())
    first = np.minimum(used.argmax(axis=1), weights.shape[1] - count).astype(np.int64)
    return first, np.take_along_axis(weights, first[:, None] + np.arange(count), axis=1)


def _inside(weights: NDArray[np.float32], offset: int, block: int, first: int, size: int) -> NDArray[np.float32]:
    """Return the fraction of each window that lies inside the image after a displacement along one axis."""
    centres = (first + np.arange(weights.shape[1]) + 0.5) * block + offset
    return np.asarray(weights @ ((centres >= 0) & (centres <= size)).astype(np.float32))


def _minima(
    values: NDArray[np.float32],
    axis: _Axis,
    places: NDArray[np.intp],
    at: tuple[NDArray[np.int64], NDArray[np.int64]],
    wanted: Mask,
    aperture: ApertureContext,
) -> Map:
    """Return the candidates: the lowest minima of the dissimilarity of each window, and their opposites."""
    from scipy.ndimage import minimum_filter

    windows = np.argwhere(wanted[places])
    curves = values[:, windows[:, 0], windows[:, 1]].T
    rows, columns = places[windows[:, 0]], windows[:, 1]
    if axis.both:
        reach = int(axis.offsets[:, 0].max())
        plane = np.zeros((len(windows), 2 * reach + 1, 2 * reach + 1), dtype=np.float32)
        for sign in (1, -1):
            plane[:, reach + sign * axis.offsets[:, 1], reach + sign * axis.offsets[:, 0]] = curves
        lowest = (plane == minimum_filter(plane, (1, 3, 3), mode="nearest")) & (plane < _CANDIDATE)
        lowest[:, reach, reach] = False
        line = aperture.normal[at[0][rows], at[1][columns]]
        if line.any():
            lowest[line] = _along_line(plane[line], aperture.direction[:, at[0][rows[line]], at[1][columns[line]]])
        number, y, x = np.nonzero(lowest)
        cost = plane[number, y, x]
        offsets = np.stack([x - reach, y - reach], axis=-1) / axis.nearest
    else:
        curves = np.concatenate([np.zeros((len(windows), 1), dtype=np.float32), curves], axis=1)
        lowest = (curves == minimum_filter(curves, (1, 3), mode="nearest")) & (curves < _CANDIDATE)
        lowest[:, 0] = False
        number, which = np.nonzero(lowest)
        cost = np.tile(curves[number, which], 2)
        change = which / axis.nearest
        number = np.tile(number, 2)
        change = np.concatenate([change, -change])
        offsets = np.stack([change, np.zeros_like(change)], axis=-1)
    # Lowest first, and the nearest of equals.
    order = np.lexsort((np.hypot(*offsets.T), cost + 0.02 * np.hypot(*offsets.T) / SEARCHED_PX, number))
    number, offsets, cost = number[order], offsets[order], cost[order]
    rank = np.arange(len(number)) - np.searchsorted(number, number)
    keep = rank < _RIVALS
    number, offsets, rank, cost = number[keep], offsets[keep], rank[keep], cost[keep]
    of_rows, of_columns = rows[number], columns[number]
    return np.column_stack([at[0][of_rows], at[1][of_columns], offsets, rank, of_rows, of_columns, cost])


def _resembling_in_plane(values: NDArray[np.float32], axis: _Axis, max_motion_px: float | None) -> tuple[Mask, Mask]:
    """Return the windows that vary within the search range, and those of them that resemble displaced windows."""
    from scipy.ndimage import label

    reach = int(axis.offsets[:, 0].max())
    plane = np.zeros((2 * reach + 1, 2 * reach + 1, *values.shape[1:]), dtype=np.float32)
    for sign in (1, -1):
        plane[reach + sign * axis.offsets[:, 1], reach + sign * axis.offsets[:, 0]] = values
    # Displacements between which the texture does not change are the same minimum.
    together = np.zeros((3, 3, 3, 3), dtype=np.bool_)
    together[:, :, 1, 1] = True
    areas, _ = label(plane < _CANDIDATE, together)
    again = (plane < SAME) & (areas != areas[reach, reach])
    if max_motion_px is not None:
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        again &= (np.hypot(x, y) <= max_motion_px * axis.nearest)[:, :, None, None]
    return ((plane > _CANDIDATE) & (plane != 1.0)).any(axis=(0, 1)), again.any(axis=(0, 1))


def _along_line(plane: NDArray[np.float32], direction: Map) -> Mask:
    """Return the minima along one direction, for textures that vary in this direction only."""
    reach = plane.shape[1] // 2
    steps = np.arange(-reach, reach + 1)
    x = np.rint(reach + direction[0][:, None] * steps).astype(np.intp)
    y = np.rint(reach + direction[1][:, None] * steps).astype(np.intp)
    number = np.arange(len(plane))[:, None]
    curve = plane[number, y, x]
    inner = np.zeros(curve.shape, dtype=np.bool_)
    inner[:, 1:-1] = (
        (curve[:, 1:-1] <= curve[:, :-2]) & (curve[:, 1:-1] <= curve[:, 2:]) & (curve[:, 1:-1] < _CANDIDATE)
    )
    inner[:, reach - 1 : reach + 2] = False
    out = np.zeros(plane.shape, dtype=np.bool_)
    out[np.broadcast_to(number, inner.shape)[inner], y[inner], x[inner]] = True
    return out
