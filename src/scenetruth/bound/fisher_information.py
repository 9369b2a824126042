"""Fisher information of every pixel, its sums over analysis windows, and the resulting covariance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.image_gradients import SignedTexture
from scenetruth.bound.surface_geometry import ImageTimes, ReferencePoints
from scenetruth.bound.unknowns import (
    MOTION,
    Columns,
    Vector,
    WindowUnknowns,
    add_error_products,
    compute_columns,
    compute_functionals,
)
from scenetruth.schema import Intrinsics

__all__ = [
    "GROWTH_BIAS",
    "Window",
    "WindowSums",
    "compute_bias",
    "compute_brightness_modes",
    "compute_pixel_information",
    "compute_sensitivity",
    "compute_variances",
    "compute_window_deviations",
    "compute_window_sums",
    "index_pairs",
    "normal_matrix",
    "window_weights",
]


Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROWS_PER_BAND = 16  # rows per band: their arrays fit into the cache of the processor
# Least area of a pixel in another image, as a fraction of its area in the reference; it vanishes at grazing incidence.
_LEAST_AREA = 1e-3


def index_pairs(fields: int) -> dict[tuple[int, int], int]:
    """Return an index for each pair (k, m) of fields with k <= m."""
    return {pair: n for n, pair in enumerate((k, m) for k in range(fields) for m in range(k, fields))}


def compute_brightness_modes(views: ImageTimes) -> Map:
    """Return the modes of brightness change over the images, shape (number, n).

    Gain and offset of n images have n modes each. Only modes that change like image positions correlate with depth or
    motion: without perspective those proportional to s and s_y (disparity), to t (motion), and to their products
    (motion in depth changes the disparity).
    """
    s, s_y, t = (each - each.mean() for each in (views.s, views.s_y, views.t))
    ways = (each - each.mean() for each in (s, s_y, t, s * t, s_y * t))
    return np.array([way / np.abs(way).max() for way in ways if np.ptp(way) > 0])


def compute_pixel_information(
    points: ReferencePoints, views: ImageTimes, shown: Mask, layers: Sequence[SignedTexture], model: WindowUnknowns
) -> Map:
    """Return the Fisher information of every pixel after elimination of its texture, shape (pairs, y, x).

    It is Σ_i (a_i - ā)(a_i - ā)ᵀ / σ² by pairs of fields (`index_pairs`), with the derivatives a_i of image i by the
    fields of the pixel, and their mean ā over the images that show its point (``shown``, shape (n, y, x)).
    """
    height, width = points.d.shape
    pairs = index_pairs(model.fields)
    ways = compute_brightness_modes(views) if model.brightness else np.zeros((0, len(views)))
    found = np.zeros((len(pairs), height, width))
    for top in range(0, height, _ROWS_PER_BAND):
        rows = slice(top, min(top + _ROWS_PER_BAND, height))
        band = points.at((rows, slice(None)))
        first = np.zeros((len(layers), model.fields, *band.d.shape))
        second = np.zeros((len(layers), len(pairs), *band.d.shape))
        for i in range(len(views)):
            if not shown[i, rows].any():
                continue
            inverse, moves = compute_sensitivity(band, views.s[i], views.s_y[i], views.t[i], shown[i, rows])
            for number, layer in enumerate(layers):
                t_x, t_y = layer.gradient[:, rows]
                along = inverse[0] * t_x + inverse[1] * t_y
                down = inverse[2] * t_x + inverse[3] * t_y
                own = [along * moves[0] + down * moves[1]]
                if model.moving:
                    own += [along * moves[2], down * moves[2], along * moves[3] + down * moves[4]]
                own += [layer.one * way * shown[i, rows] for way in ways[:, i]]
                own += [layer.grey[rows] * way * shown[i, rows] for way in ways[:, i]]
                for k, one in enumerate(own):
                    first[number, k] += one
                for (k, m), n in pairs.items():
                    second[number, n] += own[k] * own[m]
        count = np.maximum(shown[:, rows].sum(axis=0), 1)
        for number, layer in enumerate(layers):
            for (k, m), n in pairs.items():
                left = second[number, n] - first[number, k] * first[number, m] / count
                found[n, rows] += layer.weight[rows] * left
    return found


def compute_sensitivity(
    points: ReferencePoints, s: float | Map, s_y: float | Map, t: float | Map, shown: Mask
) -> tuple[Map, Map]:
    """Return the transform from texture to image gradients, and image-position derivatives by disparity and velocity.

    Returns: Transposed inverse of the derivatives of image positions along x and y, as xx, xy, yx, yy, shape (4, ...);
    0 where the image does not show the point. Then derivatives of image positions: x and y by d; x by q_X, which equals
    y by q_Y; x and y by q_Z: shape (5, ...).
    """
    x, y, scale = points.place(s, s_y, t)
    ahead = t * scale / points.focal
    along, down = t * points.q[0] - s, t * points.q[1] - s_y
    nearer_x = ahead * (points.d_x * points.q[2] + points.d * points.q_x[2])
    nearer_y = ahead * (points.d_y * points.q[2] + points.d * points.q_y[2])
    x_x = scale * (1.0 + points.d_x * along + points.d * t * points.q_x[0]) - x * nearer_x
    x_y = scale * (points.d_y * along + points.d * t * points.q_y[0]) - x * nearer_y
    y_x = scale * (points.d_x * down + points.d * t * points.q_x[1]) - y * nearer_x
    y_y = scale * (1.0 + points.d_y * down + points.d * t * points.q_y[1]) - y * nearer_y
    area = x_x * y_y - x_y * y_x
    share = shown / np.where(np.abs(area) > _LEAST_AREA, area, np.inf)
    inverse = np.stack([y_y, -y_x, -x_y, x_x]) * share
    by_q = scale * points.d * t
    by_d = [scale * along - x * ahead * points.q[2], scale * down - y * ahead * points.q[2]]
    return inverse, np.stack([*by_d, by_q, -x * by_q / points.focal, -y * by_q / points.focal])


Window = Literal["gaussian", "even"]

# Truncation of Gaussian windows in standard deviations, as in the built-in methods.
_CUT = 2.0
_POWERS = 3
_ROWS_PER_SUM = 128  # rows per call of the summation


def window_weights(window: Window, sigma_px: float) -> Map:
    """Return the weights of a window along one axis, multiplied by the powers 0 to 2 of the distance."""
    # n uniform weights have the variance (n² - 1) / 12.
    even = window == "even"
    reach = max(1, round((math.sqrt(12 * sigma_px**2 + 1) - 1) / 2) if even else math.ceil(_CUT * sigma_px))
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.ones_like(at) if even else np.exp(-0.5 * (at / sigma_px) ** 2)
    return np.asarray(weights * at ** np.arange(_POWERS)[:, None])


Sums = dict[tuple[int, int, int], Map]


@dataclass(frozen=True, eq=False)
class WindowSums:
    """Sums (n,) of products over n windows, by pair of fields and powers of x and y; ``squares``: squared weights."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    sums: dict[tuple[int, int, int], Map]
    squares: dict[tuple[int, int, int], Map]


def compute_window_sums(
    products: Map, pieces: NDArray[np.int64], weights: Map, model: WindowUnknowns, step_px: int
) -> Iterator[WindowSums]:
    """Yield sums of the products (pairs, y, x) over the windows around pixels, by segments and bands."""
    from scipy.ndimage import find_objects

    reach = weights.shape[1] // 2
    # The square of a weight times a power is not the power of the squared weight.
    squared = weights[0] * weights
    for number, box in enumerate(find_objects(pieces + 1)):
        if box is None:
            continue
        top, bottom, left, right = box[0].start, box[0].stop, box[1].start, box[1].stop
        for first in range(top, bottom, _ROWS_PER_SUM):
            last = min(first + _ROWS_PER_SUM, bottom)
            around = slice(max(first - reach, top), min(last + reach, bottom))
            mask = pieces[around, left:right] == number
            wanted = np.zeros_like(mask)
            above = around.start
            rows = slice(first + (-first) % step_px - above, last - above, step_px)
            columns = slice((-left) % step_px, None, step_px)
            wanted[rows, columns] = mask[rows, columns]
            if not wanted.any():
                continue
            at = np.nonzero(wanted[rows, columns])
            inside = np.where(mask, products[:, around, left:right], 0.0)
            sums, squares = (_sums(inside, each, model, (rows, columns), at) for each in (weights, squared))
            y, x = np.nonzero(wanted)
            yield WindowSums(y + above, x + left, sums, squares)


def _sums(
    products: Map, weights: Map, model: WindowUnknowns, chosen: tuple[slice, slice], at: tuple[NDArray[np.int64], ...]
) -> dict[tuple[int, int, int], Map]:
    """Return windowed sums of products at the selected rows and columns."""
    from scipy.ndimage import correlate1d

    found = {}
    for (k, m), n in index_pairs(model.fields).items():
        degree = model.get_degree(k) + model.get_degree(m)
        for j in range(degree + 1):
            along = correlate1d(products[n], weights[j], axis=1, mode="constant")[:, chosen[1]]
            for i in range(degree + 1 - j):
                both = correlate1d(along, weights[i], axis=0, mode="constant")[chosen[0]]
                found[n, j, i] = np.asarray(both[at])
    return found


# Least pivot of a matrix with unit diagonal; smaller pivots are dominated by rounding or by the noise of the products.
_LEAST_PIVOT = 1e-9


def normal_matrix(sums: dict[tuple[int, int, int], Map], columns: Columns, model: WindowUnknowns) -> Map:
    """Return the information matrix of the unknowns, Cᵀ F C with the information matrix F of all parameters."""
    pairs = index_pairs(model.fields)

    def full(p: int, q: int) -> Map:
        one, other = sorted((model.get_field(p), model.get_field(q)))
        (x, y), (more_x, more_y) = model.get_powers(p), model.get_powers(q)
        return sums[pairs[one, other], x + more_x, y + more_y]

    count = len(columns)
    windows = len(next(iter(sums.values())))
    found = np.empty((count, count, windows))
    for j, column in enumerate(columns):
        times: dict[int, Map] = {}
        for i in range(j + 1):
            total = np.zeros(windows)
            for p, share in columns[i]:
                if p not in times:
                    times[p] = sum((part * full(p, q) for q, part in column), np.zeros(windows))
                total += share * times[p]
            found[i, j] = found[j, i] = total
    return found


def compute_variances(normal: Map, scatter: Map, columns: Columns, functionals: Sequence[Vector]) -> Map:
    """Return the variances of linear functions of the unknowns, which have the covariance H⁻¹ S H⁻¹."""
    count, windows = normal.shape[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / np.sqrt(np.einsum("iin->in", normal))
        factor = _factorised(normal * scale[:, None] * scale)
        rights = np.zeros((len(functionals), count, windows))
        for k, functional in enumerate(functionals):
            rights[k] = _apply(functional, columns, windows)
        solved = _solved(factor, rights * scale) * scale
        total = np.zeros((len(functionals), windows))
        for i in range(count):
            for j in range(count):
                total += solved[:, i] * scatter[i, j] * solved[:, j]
        # Where texture is weak, noise in the products of gradients may make the variance negative.
        return np.where(total > 0, total, np.nan)


GROWTH_BIAS = "growth_bias"
"""Name of the bias of the growth rate among the standard deviations of windows."""


def compute_window_deviations(
    sums: Sums,
    squares: Sums,
    points: ReferencePoints,
    intrinsics: Intrinsics,
    model: WindowUnknowns,
    *,
    biased: bool,
    disturbed: Map | None = None,
) -> dict[str, Map]:
    """Return the standard deviations of all quantities of windows.

    ``sums``, ``squares``: As in `WindowSums`. ``biased``: Whether to add the bias of the growth rate, `GROWTH_BIAS`.
    ``disturbed``: Mean products of further errors of the normal equations, by pairs of parameters, shape
    (parameters, parameters, n).
    """
    columns = compute_columns(model, points)
    normal, scatter = (normal_matrix(each, columns, model) for each in (sums, squares))
    if disturbed is not None:
        scatter += _of_unknowns(disturbed, columns)
    entries = compute_functionals(points, intrinsics, model)
    std = np.sqrt(compute_variances(normal, scatter, columns, list(entries.values())))
    found = add_error_products(dict(zip(entries, std, strict=True)))
    if biased and "growth_rate" in entries:
        # The true velocity gradient, of which a model with isotropic growth describes a part.
        slopes = (points.q_x, points.q_y)
        true: Vector = [(MOTION + 3 * k + 1 + side, slopes[side][k]) for side in range(2) for k in range(3)]
        whole = normal_matrix(sums, [*columns, true], model)
        found[GROWTH_BIAS] = compute_bias(whole, columns, true, entries["growth_rate"])
    return found


def _of_unknowns(products: Map, columns: Columns) -> Map:
    """Return products by pairs of unknowns, from those by pairs of parameters."""
    found = np.zeros((len(columns), len(columns), products.shape[-1]))
    for i, one in enumerate(columns):
        for j, other in enumerate(columns):
            found[i, j] = sum(a * b * products[p, q] for p, a in one for q, b in other)
    return found


def compute_bias(normal: Map, columns: Columns, true: Vector, functional: Vector) -> Map:
    """Return the bias of a linear function of the unknowns in a fit to noise-free images.

    ``true``: True parameters, of which the unknowns describe a part. ``normal``: Information matrix of the unknowns
    and, in the last row and column, of the true parameters.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / np.sqrt(np.einsum("iin->in", normal[:-1, :-1]))
        factor = _factorised(normal[:-1, :-1] * scale[:, None] * scale)
        fitted = _solved(factor, normal[None, :-1, -1] * scale)[0] * scale
    windows = normal.shape[-1]
    shares = _apply(functional, [*columns, true], windows)
    return np.asarray((fitted * shares[:-1]).sum(axis=0) - shares[-1])


def _apply(functional: Vector, columns: Columns, windows: int) -> Map:
    """Return a linear function of each column, shape (n, windows)."""
    parts = dict(functional)
    found = np.zeros((len(columns), windows))
    for i, column in enumerate(columns):
        for p, share in column:
            if p in parts:
                found[i] += share * parts[p]
    return found


def _factorised(matrix: Map) -> Map:
    """Return the Cholesky factor L of a matrix, shape (n, n, windows); NaN where it is not positive definite."""
    count = len(matrix)
    factor = np.zeros_like(matrix)
    for j in range(count):
        left = matrix[j:, j].copy()
        for k in range(j):
            left -= factor[j:, k] * factor[j, k]
        pivot = np.sqrt(np.where(left[0] > _LEAST_PIVOT, left[0], np.nan))
        factor[j:, j] = left / pivot
    return factor


def _solved(factor: Map, rights: Map) -> Map:
    """Solve L Lᵀ v = r for several right-hand sides r, shape (several, n, windows)."""
    found = rights.copy()
    count = len(factor)
    for i in range(count):
        for k in range(i):
            found[:, i] -= factor[i, k] * found[:, k]
        found[:, i] /= factor[i, i]
    for i in reversed(range(count)):
        for k in range(i + 1, count):
            found[:, i] -= factor[k, i] * found[:, k]
        found[:, i] /= factor[i, i]
    return found
