"""Derivatives in windows: variances by correlated errors are those of the whole covariance, also in cut windows."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.strain.window_fit import FitWindow, fit_derivatives

SHAPE = (13, 17)
SPACING = (3.0, 2.0)


def covariance_of_errors(std: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return the covariance of the errors of all points, in the order of the rows."""
    y, x = (spacing * index.ravel() for spacing, index in zip(SPACING, np.indices(SHAPE), strict=True))
    distance2 = (y[:, None] - y) ** 2 + (x[:, None] - x) ** 2
    return np.asarray(np.outer(std.ravel(), std.ravel()) * np.exp(-distance2 / (4 * sigma_px**2)))


def derivative_weights(segments: np.ndarray, window: FitWindow) -> np.ndarray:
    """Return the weights of all points in the derivatives, by fits to unit impulses, shape (2, y, x, point)."""
    impulses = np.eye(segments.size).reshape(-1, *SHAPE)
    return np.moveaxis(fit_derivatives(impulses, segments, window).values, 1, -1)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("sigma_px", [1.0, 4.0, 9.0])
def test_correlated_errors_of_cut_windows_are_those_of_the_covariance(order: int, sigma_px: float) -> None:
    """Windows at borders, holes and other segments; the standard deviations of the errors differ within windows."""
    rng = np.random.default_rng(order)
    segments = np.zeros(SHAPE, dtype=np.int32)
    segments[:, 11:] = 1
    segments[4:6, 3] = -1
    weights = np.array([1.0, 2.0, 3.0, 2.0, 1.0])
    window = FitWindow(weights / weights.sum(), order, 0.4, SPACING)
    std = rng.uniform(0.5, 1.5, SHAPE)
    fit = fit_derivatives(np.zeros((1, *SHAPE)), segments, window, std[None] ** 2, sigma_px)
    linear = derivative_weights(segments, window)
    exact = np.einsum("iyxp,pq,jyxq->ijyx", linear, covariance_of_errors(std, sigma_px), linear, optimize=True)
    full = np.zeros(SHAPE, dtype=bool)
    full[2:-2, 2:9] = full[2:-2, 13:-2] = True
    full[2:8, 1:6] = False
    cut = fit.fitted & ~full
    assert cut.sum() > 50
    # Eigenvalues under 1e-10 of the largest are omitted.
    np.testing.assert_allclose(fit.covariances[:, :, 0][:, :, cut], exact[:, :, cut], rtol=1e-6, atol=1e-9)
    # In complete windows, variances are means over the window: they are exact with the same deviation everywhere.
    same = fit_derivatives(np.zeros((1, *SHAPE)), segments, window, np.ones((1, *SHAPE)), sigma_px).covariances[:, :, 0]
    exact = np.einsum(
        "iyxp,pq,jyxq->ijyx", linear, covariance_of_errors(np.ones(SHAPE), sigma_px), linear, optimize=True
    )
    for i in range(2):
        np.testing.assert_allclose(same[i, i][full], exact[i, i][full], rtol=1e-9)
        np.testing.assert_allclose(same[i, i][cut], exact[i, i][cut], rtol=1e-6)


def test_independent_errors_are_the_limit_of_a_short_correlation() -> None:
    segments = np.zeros(SHAPE, dtype=np.int32)
    window = FitWindow(np.full(5, 0.2), 1, 0.4, SPACING)
    given = np.ones((1, *SHAPE))
    # Neighbours at 2 px have the correlation exp(-2² / (4 0.2²)) = 1e-11.
    found = [fit_derivatives(given, segments, window, given, sigma).covariances for sigma in (0.0, 0.2)]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-12)


def test_the_derivative_of_a_plane_is_exact_in_cut_windows() -> None:
    y, x = np.indices(SHAPE, dtype=np.float64)
    segments = np.where(np.hypot(x - 8, y - 6) < 2, -1, 0).astype(np.int32)
    fit = fit_derivatives(
        (0.3 * x * SPACING[1] - 0.7 * y * SPACING[0])[None], segments, FitWindow(np.full(5, 0.2), 1, 0.4, SPACING)
    )
    np.testing.assert_allclose(fit.values[0, 0][fit.fitted], 0.3, rtol=1e-10)
    np.testing.assert_allclose(fit.values[1, 0][fit.fitted], -0.7, rtol=1e-10)
