"""Windows of the pixels that belong to one surface, beside whole windows and plain readings."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.refined.kernels import pixel_equations as equations
from scenetruth.estimators.refined.kernels import window_solver, window_sums
from scenetruth.estimators.refined.noise_estimation import EVEN
from scenetruth.estimators.refined.row_bands import window_weights
from tests.helpers.kernel_images import COUNT, HEIGHT, VIEW, WIDTH, Array, Warped, warped_by
from tests.helpers.nightly import by_night, nightly


def blank(products: Array) -> window_solver.Fit:
    size = (HEIGHT, WIDTH)
    theta = np.zeros((15 if len(products) == equations.PRODUCTS else 18, *size))
    theta[0] = 3.0
    variance = np.full((9, *size), np.nan)
    # Of the types that the method has, so that the kernels are those that it calls.
    described = np.full((window_solver.VALUES, *size), np.nan, dtype=np.float32)
    of_element = np.full((window_solver.FUNCTIONALS, *size), np.nan, dtype=np.float32)
    images, residual = np.full(size, np.nan, dtype=np.float32), np.full((2, *size), np.nan)
    return window_solver.Fit(theta, variance, described, of_element, images, residual)


def model_of(products: Array) -> window_solver.Model:
    return window_solver.Model(3, 3, 2, len(products) > equations.PRODUCTS)


def fitted_to_members(products: Array, fields: Array, limit: float, reach: float) -> tuple[window_solver.Fit, Array]:
    fit, pixels = blank(products), np.argwhere(np.ones((HEIGHT, WIDTH), dtype=bool)).copy(order="C")
    shares = np.empty((len(pixels), 2))
    limits, bounds = np.full((HEIGHT, WIDTH), limit), np.array([1.0, 1.0, 0.1, reach])
    # In whole vectors.
    rows, model = np.pad(products.transpose(1, 2, 0), [(0, 0), (0, 0), (0, 2)]), model_of(products)
    in_one_row = window_solver.Fit._make(each.reshape(*each.shape[:-2], 1, -1) for each in fit)
    numbers = np.arange(len(pixels))
    window_sums.solve_members(
        rows, limits, fields, bounds, window_weights(3.0), model, VIEW, 0, in_one_row, pixels, shares, numbers
    )
    return fit, shares.T.reshape(2, HEIGHT, WIDTH)


def fitted_to_all(products: Array) -> window_solver.Fit:
    fit, every = blank(products), np.zeros((HEIGHT, WIDTH), dtype=np.int8)
    weights, told = window_weights(3.0), window_solver.EVERY_VARIANCE
    models = (model_of(products), model_of(products))
    window_sums.solve_rows(products, weights, models, 1, VIEW, 0, 0.0, (fit, fit), every, told, 1, (0, HEIGHT))
    return fit


@pytest.fixture(scope="module")
def products(fields: Array, warped: Warped) -> Array:
    return products_of(fields, warped)


def products_of(fields: Array, warped: Warped) -> Array:
    found = np.zeros((equations.PRODUCTS if len(fields) == 4 else equations.ALL_PRODUCTS, HEIGHT, WIDTH))
    equations.add_products(VIEW, fields, *warped, 0, COUNT, EVEN, found, (0, HEIGHT))
    return found


@nightly
@pytest.mark.parametrize("count", [4, *by_night(7)])
def test_windows_of_members_are_whole_windows_if_all_belong(images: Array, accelerated: Array, count: int) -> None:
    fields = np.ascontiguousarray(accelerated[:count])
    products = products_of(fields, warped_by(images, fields))
    fit, shares = fitted_to_members(products, fields, np.inf, np.inf)
    whole = fitted_to_all(products)
    for name in fit._fields:
        np.testing.assert_allclose(getattr(fit, name), getattr(whole, name), rtol=1e-6, atol=1e-8, err_msg=name)
    # As much as is known of the windows, and as the texture's middle in plain sums.
    weights = window_weights(3.0)[0]
    y, x = 17, 24
    reach = weights.shape[1] // 2
    around = products[:, y - reach : y + reach + 1, x - reach : x + reach + 1]
    plane = np.outer(weights[0], weights[0])
    assert shares[0, y, x] == pytest.approx((plane * around[16]).sum())
    texture = np.outer(weights[0], weights[0]) * around[17]
    step = np.arange(-reach, reach + 1)
    middle = [(texture.sum(axis=axis) * step).sum() / texture.sum() for axis in (0, 1)]
    assert shares[1, y, x] == pytest.approx(np.hypot(*middle))


def test_pixels_that_are_not_explained_are_left_out(products: Array, fields: Array) -> None:
    """Windows beside pixels with large squares are those of images that do not show these pixels."""
    bad = np.zeros((HEIGHT, WIDTH), dtype=bool)
    bad[:, 30:] = True
    spoilt, cut = products.copy(), products.copy()
    spoilt[14, bad] = 1e9
    cut[:, bad] = 0.0
    fit, _ = fitted_to_members(spoilt, fields, 1e6, np.inf)
    whole = fitted_to_all(cut)
    np.testing.assert_allclose(fit.theta[:, :, :29], whole.theta[:, :, :29], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("count", [4, 7])
def test_displacements_are_those_of_the_farthest_images(count: int) -> None:
    """The adjacent camera, and an image two frames later: the largest of all changes, times their distance."""
    generator = np.random.default_rng(5)
    theta, fields = generator.normal(0.0, 0.1, 18), generator.normal(0.0, 0.1, (count, 3, 9))
    theta[0], reach, y, x = 3.0, np.array([1.0, 2.0, 0.1, 0.2]), -1, np.arange(-4, 5)
    fields[0] += 3.0
    fields[1, 1, 3], fields[0, 1, 6] = np.nan, np.nan
    found = np.empty(7)
    window_sums._displacements(count, theta, x[0], y, fields, 1, 0, reach, found)
    of_window = [theta[:6] @ [np.ones(9), x, y * np.ones(9), x**2, x * y, y**2 * np.ones(9)]]
    of_window += [theta[k] + theta[k + 1] * x + theta[k + 2] * y for k in (6, 9, 12)]
    of_window += [np.full(9, each) for each in theta[15:]]
    step = np.abs(np.stack(of_window[:count]) - fields[:, 1])
    arms = np.array([1.0, 2.0, 2.0, 0.2, 2.0, 2.0, 0.2])[:count]
    distances = np.where(np.arange(count) > 0, arms, 1.0)[:, None] * step
    distances[1:] *= np.abs(fields[0, 1])
    expected = np.fmax.reduce(distances[:, :7], axis=0)
    known = np.isfinite(fields[:, 1, :7]).all(axis=0)
    np.testing.assert_allclose(found[known], expected[known], rtol=1e-12)
    assert np.isnan(found[6])
    # 0.05 px of disparity per px: beyond 4 px, the adjacent camera has a displacement of 0.2 px.
    theta[:], theta[:2] = 0.0, (3.0, 0.05)
    constant, moved = np.zeros((count, 1, 9)), np.empty(9)
    constant[0] = 3.0
    window_sums._displacements(count, theta, -4, 0, constant, 0, 0, reach, moved)
    np.testing.assert_allclose(moved, 0.05 * np.abs(x), atol=1e-12)


def test_pixels_that_would_be_moved_are_left_out(products: Array, fields: Array) -> None:
    """Beyond an outline, where a window moves points by more than the reach, pixels are not part of it."""
    other, cut = fields.copy(), products.copy()
    other[0, :, 30:] += 100.0
    cut[:, :, 30:] = 0.0
    fit, _ = fitted_to_members(products, other, np.inf, 50.0)
    whole = fitted_to_all(cut)
    np.testing.assert_allclose(fit.theta[:, :, :29], whole.theta[:, :, :29], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("count", [4, 7])
def test_squares_after_a_step_are_those_of_the_normal_equations(count: int) -> None:
    """E(step) = e - 2 b step + step M step, with M (d, q) + b as it is stored."""
    generator = np.random.default_rng(3)
    a = generator.normal(0, 1, (9, count))
    m, b = a.T @ a, generator.normal(0, 1, count)
    own, theta = generator.normal(0, 1, count), np.zeros(18)
    product = np.zeros(equations.ALL_PRODUCTS)
    product[:10] = m[:4, :4][np.triu_indices(4)]
    product[22:40] = [*m[:5, 4], *m[:6, 5], *m[:7, 6]] if count == 7 else 0.0
    right = m @ own + b
    product[10:14], product[40 : 36 + count] = right[:4], right[4:]
    product[14] = 30.0
    for scale in (0.0, 0.5, 2.0):
        step = scale * generator.normal(0, 1, count)
        # At (2, -1) from the window's centre, where slopes and curvature lead to these parameters.
        theta[[1, 2, 3, 4, 5, 7, 8, 10, 11, 13, 14]] = generator.normal(0, 1, 11)
        theta[[0, 6, 9, 12, 15, 16, 17][:count]] = own + step
        theta[0] -= theta[1:6] @ [2.0, -1.0, 4.0, -2.0, 1.0]
        for k in (6, 9, 12):
            theta[k] -= 2.0 * theta[k + 1] - theta[k + 2]
        found = window_sums._square_after_step(count, theta, 2.0, -1.0, own[:, None, None], 0, 0, product)
        assert found == pytest.approx(float(30.0 - 2 * b @ step + step @ m @ step), rel=1e-9)
