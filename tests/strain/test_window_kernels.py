"""Variances in incomplete windows by correlated errors: the kernel against sums over all pairs of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from scenetruth.strain.window_fit import FitWindow, fit_derivatives
from scenetruth.strain.window_kernels import sum_over_modes

ROWS, COLUMNS = 8, 9


def read_plainly(
    std: np.ndarray, rows: np.ndarray, columns: np.ndarray, eigenvalues: np.ndarray, kept: np.ndarray,
    centres: np.ndarray, polynomials: np.ndarray, offsets: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the sums of the definition, window by window: ``columns`` are φ_l weight, shape (l, point)."""
    points = len(offsets)
    found = np.zeros((2, 2, len(centres)))
    powers = offsets[:, None] ** np.arange(polynomials.shape[1])
    for n, (y, x) in enumerate(centres):
        within = std[y : y + points, x : x + points]
        values = np.einsum("ya,xb,bai->iyx", powers, powers, polynomials[n])
        modes = np.einsum("yk,lx,iyx,yx->ikl", rows, columns, values, within)
        found[..., n] = np.einsum("ikl,jkl,kl,kl->ij", modes, modes, eigenvalues, kept)
    return found


@given(seed=some.integers(0, 10_000), order=some.sampled_from([1, 2]), reach=some.integers(1, 6))
@settings(max_examples=25, deadline=None)
def test_the_kernel_is_the_plain_sum(seed: int, order: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    points, down, across = 2 * reach + 1, int(rng.integers(1, 6)), int(rng.integers(1, 6))
    offsets = np.linspace(-1.0, 1.0, points)
    rows, columns = rng.normal(size=(points, down)), rng.normal(size=(across, points))
    eigenvalues = rng.uniform(0, 2, (down, across))
    counts = rng.integers(0, down + 1, across)
    centres = np.stack([rng.integers(0, ROWS, 40), rng.integers(0, COLUMNS, 40)], axis=1)
    polynomials = rng.normal(size=(40, order + 1, order + 1, 2))
    a, b = np.indices((order + 1, order + 1))
    polynomials[:, a + b > order] = 0
    std = rng.uniform(0, 2, (ROWS + 2 * reach, COLUMNS + 2 * reach))
    windows = np.lib.stride_tricks.sliding_window_view(std, points, axis=1)
    projected = np.einsum("yxp,lp,pa->xlay", windows, columns, offsets[:, None] ** np.arange(order + 1))
    found = sum_over_modes(np.ascontiguousarray(projected), rows, eigenvalues, counts, centres, polynomials, offsets)
    kept = np.arange(down)[:, None] < counts
    exact = read_plainly(std, rows, columns, eigenvalues, kept, centres, polynomials, offsets)
    # Sums of at most 13 x 13 x 25 terms: rounding.
    np.testing.assert_allclose(found, exact, rtol=1e-10, atol=1e-11 * np.abs(exact).max())


@pytest.mark.parametrize(("order", "reach", "sigma_px"), [(1, 7, 6.0), (2, 5, 3.0), (1, 4, 30.0), (2, 6, 1.5)])
def test_large_windows_with_gaps_are_those_of_the_covariance(order: int, reach: int, sigma_px: float) -> None:
    """The variance of a weighted sum of all points, with the covariance of all pairs."""
    rng = np.random.default_rng(7)
    shape = (2 * reach + 4, 2 * reach + 5)
    segments = np.where(rng.random(shape) < 0.05, -1, 0).astype(np.int32)
    weights = np.exp(-0.5 * np.linspace(-2, 2, 2 * reach + 1) ** 2)
    window = FitWindow(weights / weights.sum(), order, 0.3)
    std = rng.uniform(0.5, 1.5, shape)
    variances = np.stack([std**2, np.zeros(shape)])
    fit = fit_derivatives(np.eye(std.size).reshape(-1, *shape), segments, window, variances, sigma_px)
    y, x = (index.ravel() for index in np.indices(shape))
    distance2 = (y[:, None] - y) ** 2 + (x[:, None] - x) ** 2
    covariance = np.outer(std, std) * np.exp(-distance2 / (4 * sigma_px**2))
    linear = fit.values[..., fit.fitted]
    exact = np.einsum("ipn,pq,jqn->ijn", linear, covariance, linear, optimize=True)
    scale = np.sqrt(exact[0, 0] * exact[1, 1])
    assert fit.fitted.sum() > 50
    # Pairs of modes under 1e-10 of the largest eigenvalue are omitted.
    assert (
        np.abs(fit.covariances[:, :, 0][..., fit.fitted] - exact).max(initial=0.0, where=scale > 0) < 1e-6 * scale.max()
    )
    assert np.all(np.abs(fit.covariances[:, :, 0][..., fit.fitted] - exact) < 1e-6 * scale)
    assert (fit.covariances[:, :, 1][..., fit.fitted] == 0).all()
