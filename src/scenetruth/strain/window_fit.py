"""Derivatives of fields by least-squares fits of polynomials in moving windows, with their covariances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["FitWindow", "WindowDerivatives", "correlation_factor", "fit_derivatives"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BAND_PIXELS = 60_000  # points that are fitted together
_FLAT = 1e-6
"""Minimum determinant of the normal equations, relative to a complete window, at which a fit is determined."""
_EXPONENTS = {1: ((0, 0), (1, 0), (0, 1)), 2: ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))}
"""Exponents of x and y of the polynomials, by their order."""


@dataclass(frozen=True, eq=False)
class FitWindow:
    """Window of a fit.

    ``weights``: Weights along each axis, of an odd number of points, with the sum 1.
    ``order``: Order of the polynomial, 1 or 2.
    ``min_coverage``: Minimum share of the weights on the points that are used.
    ``spacing_px``: Distance of neighbouring points along y and along x.
    """

    weights: Map
    order: int = 1
    min_coverage: float = 0.5
    spacing_px: tuple[float, float] = (1.0, 1.0)

    @property
    def reach(self) -> int:
        """Points on each side of the centre."""
        return len(self.weights) // 2

    def kernels(self, power: int) -> list[Map]:
        """Return the weights to a power, times 1, u, u², ... with the offset u from -1 to 1, for all moments."""
        offset = np.linspace(-1.0, 1.0, len(self.weights))
        return [self.weights**power * offset**n for n in range(2 * self.order + 1)]

    @property
    def determinant(self) -> float:
        """Determinant of the normal equations of a complete window."""
        moments = [float(kernel.sum()) for kernel in self.kernels(1)]
        terms = _EXPONENTS[self.order]
        return float(np.linalg.det([[moments[a + c] * moments[b + d] for c, d in terms] for a, b in terms]))


@dataclass(frozen=True, eq=False)
class WindowDerivatives:
    """Derivatives at the centres of windows; NaN where a fit is not determined.

    ``values``: Derivatives of the fields by x and y per px, shape (2, field, y, x).
    ``covariances``: Covariances of both derivatives for every map of variances, shape (2, 2, map, y, x).
    ``fitted``: Whether the window determines the fit, shape (y, x).
    """

    values: Map
    covariances: Map
    fitted: Mask


def fit_derivatives(
    fields: Map,
    segments: NDArray[np.int32],
    window: FitWindow,
    variances: Map | None = None,
    correlation_px: float = 0.0,
) -> WindowDerivatives:
    """Fit polynomials to fields around every point; a window uses only the segment of its centre.

    ``fields``: Values, shape (field, y, x). ``segments``: Label of every point, negative where it is not used.
    ``variances``: Variances of errors, shape (map, y, x); default: none. ``correlation_px``: The errors have the
      correlation exp(-r²/4σ²) at the distance r, as those of results in overlapping Gaussian windows of this standard
      deviation σ; 0 for independent errors.
    """
    given = np.zeros((0, *segments.shape)) if variances is None else variances
    values = np.full((2, *fields.shape), np.nan)
    covariances = np.full((2, 2, *given.shape), np.nan)
    fitted = np.zeros(segments.shape, dtype=np.bool_)
    for number, box in enumerate(ndimage.find_objects(segments + 1)):
        # A segment may have no point of the lattice.
        if box is None:
            continue
        inside = segments[box] == number
        for own, needed in _row_bands(inside.shape, window.reach):
            part = inside[needed]
            rows = slice(box[0].start + needed.start, box[0].start + needed.stop)
            among = np.zeros_like(part)
            among[own.start - needed.start : own.stop - needed.start] = True
            among &= part
            some = np.where(part, fields[:, rows, box[1]], 0.0)
            noise = np.where(part, given[:, rows, box[1]], 0.0)
            usable, derivatives, spread = _fit(some, noise, part, among, window, correlation_px)
            here = np.zeros_like(part)
            here[among] = usable
            fitted[rows, box[1]] |= here
            values[:, :, rows, box[1]][..., here] = derivatives
            covariances[:, :, :, rows, box[1]][..., here] = spread
    return WindowDerivatives(values, covariances, fitted)


def _row_bands(shape: tuple[int, ...], reach: int) -> Iterator[tuple[slice, slice]]:
    """Yield the rows of bands that limit memory, and those that their windows need."""
    height, width = shape
    rows = max(2 * reach + 1, _BAND_PIXELS // max(width, 1))
    for first in range(0, height, rows):
        last = min(first + rows, height)
        yield slice(first, last), slice(max(first - reach, 0), min(last + reach, height))


def _fit(
    fields: Map, variances: Map, part: Mask, among: Mask, window: FitWindow, correlation_px: float
) -> tuple[Mask, Map, Map]:
    """Return which points ``among`` a part are fitted, and their derivatives (2, field, n) and covariances."""
    terms = _EXPONENTS[window.order]
    plain, squared = window.kernels(1), window.kernels(2)
    moments = _moments(part.astype(np.float64)[None], plain, 2 * window.order, among)
    normal = np.stack([np.stack([moments[a + c, b + d][0] for c, d in terms]) for a, b in terms]).transpose(2, 0, 1)
    usable = moments[0, 0][0] >= window.min_coverage - _ROUNDING
    usable &= np.linalg.det(normal) > _FLAT * window.determinant
    # Rows 1 and 2 of the inverse: the derivatives are linear in the moments of the fields.
    wanted = np.broadcast_to(np.eye(len(terms))[:, 1:3], (int(usable.sum()), len(terms), 2))
    solved = np.linalg.solve(normal[usable], wanted)
    solved = solved / (window.reach * np.array(window.spacing_px[::-1]))
    sums = _moments(fields, plain, window.order, among)
    right = np.stack([sums[term][:, usable] for term in terms])
    derivatives = np.einsum("nki,kfn->ifn", solved, right)
    spread = np.zeros((2, 2, len(variances), len(solved)))
    if len(variances):
        noise = _moments(variances, squared, 2 * window.order, among)
        for k, (a, b) in enumerate(terms):
            for m, (c, d) in enumerate(terms):
                both = np.einsum("ni,nj->ijn", solved[:, k], solved[:, m])
                spread += both[:, :, None] * noise[a + c, b + d][:, usable]
    if len(variances) and correlation_px > 0:
        factors = np.array(correlation_factor(window, correlation_px))
        spread *= np.sqrt(factors[:, None] * factors)[:, :, None, None]
        cut = moments[0, 0][0][usable] < 1 - _ROUNDING
        centres = np.argwhere(among)[usable][cut]
        spread[..., cut] = _spread_of_cut_windows(variances, centres, solved[cut], window, correlation_px)
    return usable, derivatives, spread


def _spread_of_cut_windows(
    variances: Map, centres: NDArray[np.int64], solved: Map, window: FitWindow, correlation_px: float
) -> Map:
    """Return the covariances (2, 2, map, n) of derivatives in incomplete windows by correlated errors.

    The correlation along each axis is a sum of eigenvectors φ with eigenvalues λ, so that a weighted sum
    of errors has the variance Σ λ_k λ_l (Σ φ_k(y) φ_l(x) weight(y, x) s(y, x))².
    """
    from scenetruth.strain.window_kernels import sum_over_modes

    found = np.zeros((2, 2, len(variances), len(centres)))
    if not len(centres):
        return found
    size, reach, kernels = len(window.weights), window.reach, window.kernels(1)
    (of_rows, rows), (of_columns, columns) = (_modes(size, each, correlation_px) for each in window.spacing_px)
    eigenvalues = of_rows[:, None] * of_columns
    counts = (eigenvalues > _LEAST_MODE * eigenvalues[0, 0]).sum(axis=0)
    polynomials = np.zeros((len(centres), window.order + 1, window.order + 1, 2))
    for k, (a, b) in enumerate(_EXPONENTS[window.order]):
        polynomials[:, a, b] = solved[:, k]
    along = np.stack([columns * kernel for kernel in kernels[: window.order + 1]], axis=1).reshape(-1, size)
    down = np.ascontiguousarray((rows * kernels[0]).T)
    for number, some in enumerate(variances):
        if not some.any():
            continue
        std = np.pad(np.sqrt(some), reach)
        projected = np.lib.stride_tricks.sliding_window_view(std, size, axis=1) @ along.T
        shape = (projected.shape[1], len(columns), window.order + 1, len(std))
        projected = np.ascontiguousarray(projected.transpose(1, 2, 0)).reshape(shape)
        found[:, :, number] = sum_over_modes(
            projected, down, eigenvalues, counts, centres, polynomials, np.linspace(-1.0, 1.0, size)
        )
    return found


_LEAST_MODE = 1e-10
"""Smallest eigenvalue of a mode, or of a pair of modes, relative to the largest."""


def _modes(count: int, spacing_px: float, correlation_px: float) -> tuple[Map, Map]:
    """Return eigenvalues (k), largest first, and eigenvectors (k, point) of the correlation of points in a row."""
    index = spacing_px * np.arange(count)
    values, vectors = np.linalg.eigh(np.exp(-((index[:, None] - index) ** 2) / (4 * correlation_px**2)))
    kept = np.flatnonzero(values > _LEAST_MODE * values[-1])[::-1]
    return values[kept], vectors[:, kept].T


_ROUNDING = 1e-12


def _moments(values: Map, kernels: list[Map], order: int, among: Mask) -> dict[tuple[int, int], Map]:
    """Return the sums of values (k, y, x) times x^a y^b over windows, at the points ``among``, each (k, n)."""
    found = {}
    for a in range(order + 1):
        along = ndimage.correlate1d(values, kernels[a], axis=-1, mode="constant")
        for b in range(order + 1 - a):
            found[a, b] = ndimage.correlate1d(along, kernels[b], axis=-2, mode="constant")[:, among]
    return found


def correlation_factor(window: FitWindow, sigma_px: float) -> tuple[float, float]:
    """Return the ratio of the variances of derivatives by x and y with correlated and with independent errors.

    The ratio is that of complete windows.
    """
    if sigma_px == 0:
        return 1.0, 1.0
    weights, moments = window.weights, window.kernels(1)[1]
    index = np.arange(len(weights))

    def factor(kernel: Map, spacing: float) -> float:
        apart = spacing * (index[:, None] - index[None, :])
        return float(kernel @ np.exp(-(apart**2) / (4 * sigma_px**2)) @ kernel / (kernel @ kernel))

    down, across = window.spacing_px
    return factor(moments, across) * factor(weights, down), factor(weights, across) * factor(moments, down)
