"""The kernels beside plain readings by NumPy and SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.interpolate import BSpline

from scenetruth.estimators.refined.kernels import pixel_equations, spline_samples, window_solver, window_sums
from scenetruth.estimators.refined.kernels import pixel_equations as equations
from scenetruth.estimators.refined.noise_estimation import EVEN, spline_slope_transfer, spline_transfer
from scenetruth.estimators.refined.row_bands import window_weights
from tests.helpers.kernel_images import COUNT, HEIGHT, VIEW, WIDTH, Array, warped_by
from tests.helpers.nightly import by_night
from tests.helpers.wavy_plane import MovingPlane, turning


def mean_known(values: Array, axis: int) -> Array:
    """Return means of what is not NaN, 0 where all is."""
    known = np.isfinite(values)
    total: Array = np.where(known, values, 0.0).sum(axis=axis, keepdims=True)
    return np.asarray(total / np.maximum(known.sum(axis=axis, keepdims=True), 1))


def places(fields: Array) -> Array:
    """Where each image sees the pixels' points: the paper's equations 2 and 3, shape (image, (y, x), y, x)."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    d, *motion = fields
    q_x, q_y, q_z = motion[:3]
    a_x, a_y, a_z = motion[3:] or (0.0, 0.0, 0.0)
    # A point at depth 1 / d in units of f times the baseline, and its velocity in baselines.
    depth = VIEW.focal / d
    across, down = (x - VIEW.centre_x) / d, (y - VIEW.centre_y) / d
    seen = []
    for s, s_y, t in zip(VIEW.s, VIEW.s_y, VIEW.t, strict=True):
        ahead = depth + t * q_z + t**2 / 2 * a_z
        seen.append(
            [
                VIEW.focal * (down + t * q_y + t**2 / 2 * a_y - s_y) / ahead + VIEW.centre_y,
                VIEW.focal * (across + t * q_x + t**2 / 2 * a_x - s) / ahead + VIEW.centre_x,
            ]
        )
    return np.array(seen)


@pytest.mark.parametrize(("count", "order"), [(7, 5), *by_night((4, 5), (4, 3), (7, 3))])
def test_images_are_fetched_where_they_see_the_points(
    images: Array, accelerated: Array, count: int, order: int
) -> None:
    fields = np.ascontiguousarray(accelerated[:count])
    values, gradient = warped_by(images, fields, order)
    at = places(fields)
    slopes = []
    for image, place, found in zip(images, at, values, strict=True):
        expected = ndimage.map_coordinates(image, place, order=order, mode="mirror")
        inside = (place >= 2).all(axis=0) & (place[0] < HEIGHT - 3) & (place[1] < WIDTH - 3)
        # Places on the very border may be rounded to either side.
        borders = [np.abs(place[k] - edge) < 1e-9 for k, edge in ((0, 2), (1, 2), (0, HEIGHT - 3), (1, WIDTH - 3))]
        inside = np.where(np.any(borders, axis=0), np.isfinite(found), inside)
        assert np.isnan(found[~inside]).all()
        # float32 of values up to 5.
        np.testing.assert_allclose(found[inside], expected[inside], atol=1e-5)
        step = 1e-4
        by = [
            ndimage.map_coordinates(
                image, place + np.reshape(np.array(way) * step, (2, 1, 1)), order=order, mode="mirror"
            )
            for way in ((0, 1), (0, -1), (1, 0), (-1, 0))
        ]
        own = np.stack([by[0] - by[1], by[2] - by[3]]) / (2 * step)
        own[:, ~inside] = np.nan
        slopes.append(own)
    seen = ~np.isnan(values).all(axis=0)
    np.testing.assert_allclose(gradient[:, seen], mean_known(np.array(slopes), 0)[0][:, seen], atol=2e-5)


@pytest.mark.parametrize(
    ("weights", "reach"), [(spline_samples.quintic_weights, 3.0), (spline_samples.cubic_weights, 2.0)]
)
def test_weights_are_those_of_b_splines(weights: Any, reach: float) -> None:
    # Beyond its knots, it is not a number.
    spline = BSpline.basis_element(np.arange(-reach, reach + 1), extrapolate=False)
    for fraction in (0.0, 0.125, 0.5, 0.9):
        found, slopes = np.empty(6, dtype=np.float32), np.empty(6, dtype=np.float32)
        weights(fraction, found, slopes)
        at = fraction - np.arange(-2.0, 4.0)
        np.testing.assert_allclose(found, np.nan_to_num(spline(at)), atol=1e-7)
        np.testing.assert_allclose(slopes, np.nan_to_num(spline.derivative()(at)), atol=1e-6)


def plain_products(fields: Array, values: Array, gradient: Array) -> tuple[Array, Array, Array]:
    """Return M (4, 4, y, x), b (4, y, x) and the sum of squares, with derivatives by differences of the places."""
    step = 1e-6
    jacobian = []
    for k in range(len(fields)):
        shift = np.zeros((len(fields), 1, 1))
        shift[k] = step
        jacobian.append((places(fields + shift) - places(fields - shift)) / (2 * step))
    down, across = np.moveaxis(np.array(jacobian), 2, 0)  # each (parameter, image, y, x)
    a = gradient[0] * across + gradient[1] * down
    known = np.isfinite(values)
    a = np.where(known, a, np.nan)
    own = np.nan_to_num(a - mean_known(a, 1))
    left = np.nan_to_num(mean_known(values, 0) - values)
    return np.einsum("aiyx,biyx->abyx", own, own), np.einsum("aiyx,iyx->ayx", own, left), (left**2).sum(axis=0)


@pytest.mark.parametrize("count", [4, 7])
def test_products_of_the_pixels(images: Array, accelerated: Array, count: int) -> None:
    fields = np.ascontiguousarray(accelerated[:count])
    values, gradient = warped_by(images, fields)
    products = np.zeros((equations.PRODUCTS if count == 4 else equations.ALL_PRODUCTS, HEIGHT, WIDTH))
    equations.add_products(VIEW, fields, values, gradient, 0, COUNT, EVEN, products, (0, HEIGHT))
    known = np.isfinite(values).all(axis=0)
    assert 0.3 < known.mean() < 1
    assert (products[:, ~known] == 0).all()
    m, b, squares = plain_products(fields, values.astype(float), gradient.astype(float))
    upper = [(i, j) for i in range(4) for j in range(i, 4)]
    upper += [(i, j) for j in range(4, count) for i in range(j + 1)]
    right = b + np.einsum("abyx,byx->ayx", m, fields)
    expected = [*(m[pair] for pair in upper[:10]), *right[:4], *products[14:18], *(b[:4] ** 2)]
    expected += [*(m[pair] for pair in upper[10:]), *right[4:], *(b[4:] ** 2)]
    assert len(expected) == len(products)
    for number, values_of in enumerate(expected):
        scale = np.abs(values_of[known]).max()
        np.testing.assert_allclose(products[number][known], values_of[known], rtol=1e-4, atol=1e-6 * scale)
    np.testing.assert_allclose(products[14][known], squares[known], rtol=1e-5, atol=1e-6)
    assert (products[15][known] == COUNT - 1).all()
    np.testing.assert_allclose(products[17][known], (gradient.astype(float) ** 2).sum(axis=0)[known], rtol=1e-6)


MONOMIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), *((0, 0), (1, 0), (0, 1)) * 3, *((0, 0),) * 3)
FIELD = (0,) * 6 + (1,) * 3 + (2,) * 3 + (3,) * 3 + (4, 5, 6)


def blank(theta: Array) -> window_solver.Fit:
    size = (HEIGHT, WIDTH)
    variance, residual = np.full((9, *size), np.nan), np.full((2, *size), np.nan)
    # Of the types that the method has, so that the kernels are those that it calls.
    described = np.full((window_solver.VALUES, *size), np.nan, dtype=np.float32)
    of_element = np.full((window_solver.FUNCTIONALS, *size), np.nan, dtype=np.float32)
    return window_solver.Fit(theta, variance, described, of_element, np.full(size, np.nan, dtype=np.float32), residual)


def plain_fit(products: Array, x: int, y: int, sigma: float, columns: list[int]) -> tuple[Array, Array]:
    """Solve one window by a design over all of its pixels; return the parameters and their variances."""
    reach = int(np.ceil(2 * sigma))
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    weights = np.exp(-(u**2 + v**2) / (2 * sigma**2))
    weights /= weights.sum()
    around = products[:, y - reach : y + reach + 1, x - reach : x + reach + 1]
    count = 4 if len(products) == equations.PRODUCTS else 7
    m = np.empty((count, count, *u.shape))
    upper = {(i, j): number for number, (i, j) in enumerate((i, j) for i in range(4) for j in range(i, 4))}
    upper |= {
        (i, j): 22 + number for number, (i, j) in enumerate((i, j) for j in range(4, count) for i in range(j + 1))
    }
    for (i, j), number in upper.items():
        m[i, j] = m[j, i] = around[number]
    design = np.zeros((7, 18, *u.shape))
    for p, ((j, k), field) in enumerate(zip(MONOMIALS, FIELD, strict=True)):
        design[field, p] = u**j * v**k
    design = design[:count, columns]
    h = np.einsum("yx,apyx,abyx,bqyx->pq", weights, design, m, design, optimize=True)
    # What b has in place of its part of white noise, and no less than what is left.
    left = np.sum(weights * around[14]) / np.sum(weights * around[15])
    parts = [18, 19, 20, 21, 43, 44, 45][:count]
    squares = np.array([np.sum(weights * around[part]) / np.sum(weights * m[k, k]) for k, part in enumerate(parts)])
    noise = np.sqrt(np.maximum(squares, left))[np.asarray(FIELD)[columns]]
    h2 = np.einsum("yx,apyx,abyx,bqyx->pq", weights**2, design, m, design, optimize=True) * np.outer(noise, noise)
    sides = around[[10, 11, 12, 13, 40, 41, 42][:count]]
    right = np.einsum("yx,apyx,ayx->p", weights, design, sides)
    inverse = np.linalg.inv(h)
    return inverse @ right, np.diag(inverse @ h2 @ inverse)


@pytest.mark.parametrize(("surface", "columns"), [(3, [0, 1, 2]), (6, [0, 1, 2, 3, 4, 5])])
@pytest.mark.parametrize("gradient", [0, 3])
@pytest.mark.parametrize("count", [4, 7])
def test_windows_are_solved(
    images: Array, accelerated: Array, surface: int, columns: list[int], gradient: int, count: int
) -> None:
    """Without a known surface's bend: theta is flat to begin with, and so has none."""
    fields = np.ascontiguousarray(accelerated[:count])
    products = np.zeros((equations.PRODUCTS if count == 4 else equations.ALL_PRODUCTS, HEIGHT, WIDTH))
    equations.add_products(VIEW, fields, *warped_by(images, fields), 0, COUNT, EVEN, products, (0, HEIGHT))
    sigma = 3.0
    weights = window_weights(sigma)
    theta = np.zeros((15 if count == 4 else 18, HEIGHT, WIDTH))
    # So far away that its tangents bend by nothing.
    theta[0] = 1e6
    fit = blank(theta)
    model = window_solver.Model(surface, 3, gradient, count == 7)
    every = np.zeros((HEIGHT, WIDTH), dtype=np.int8)
    told = window_solver.EVERY_VARIANCE
    window_sums.solve_rows(products, weights, (model, model), 1, VIEW, 0, 0.5, (fit, fit), every, told, 1, (0, HEIGHT))
    chosen = columns + ([6, 9, 12] if gradient == 0 else list(range(6, 15))) + ([15, 16, 17] if count == 7 else [])
    for y, x in ((20, 28), (17, 24), (22, 31)):
        expected, variance = plain_fit(products, x, y, sigma, chosen)
        # Of parameters that depend on each other, as velocity and acceleration do, rounding leaves less.
        np.testing.assert_allclose(fit.theta[chosen, y, x], expected, rtol=1e-6, atol=1e-8)
        places = [0, 1, 2, 6, 9, 12, 15, 16, 17][: 6 if count == 4 else 9]
        variances = variance[[chosen.index(p) for p in places]]
        np.testing.assert_allclose(fit.variance[: len(places), y, x], variances, rtol=1e-6)


@given(st.integers(0, 1000))
def test_a_turning_surface_bends_its_velocity(seed: int) -> None:
    """Velocities A (p - p0) of a paraboloid, by differences, beside what its parameters say to second order."""
    generator = np.random.default_rng(seed)
    focal, x0, y0 = 300.0, *generator.uniform(-40, 40, 2)
    theta = np.zeros(15)
    theta[:6] = [6.0, *generator.uniform(-0.02, 0.02, 2), *generator.uniform(-1e-3, 1e-3, 3)]
    rate = turning(*generator.uniform(-0.01, 0.01, 3))

    def velocity(across: float, down: float) -> Array:
        monomials = np.array([across**j * down**k for j, k in MONOMIALS[:6]])
        return np.array(rate @ (np.array([x0 + across, y0 + down, focal]) / (theta[:6] @ monomials)))

    h = 0.05
    for k in range(3):
        theta[7 + 3 * k] = (velocity(h, 0) - velocity(-h, 0))[k] / (2 * h)
        theta[8 + 3 * k] = (velocity(0, h) - velocity(0, -h))[k] / (2 * h)
    second = [
        (velocity(h, 0) - 2 * velocity(0, 0) + velocity(-h, 0)) / (2 * h**2),
        (velocity(h, h) - velocity(h, -h) - velocity(-h, h) + velocity(-h, -h)) / (4 * h**2),
        (velocity(0, h) - 2 * velocity(0, 0) + velocity(0, -h)) / (2 * h**2),
    ]
    bend = np.empty((3, 3))
    window_solver._bend(theta, x0, y0, focal, np.empty((2, 3)), bend)
    # Differences over 0.05 px err by rounding of 1e-13 over h².
    np.testing.assert_allclose(bend, second, atol=1e-3 * np.abs(second).max() + 1e-9)


@pytest.mark.parametrize(("step", "first_row"), [(1, 0), (2, 0), (3, 5), (50, 1)])
def test_brightness_is_taken_from_each_window(step: int, first_row: int) -> None:
    """An image that is a texture times a gain plus an offset comes back as the texture, holes and borders included."""
    texture = np.random.default_rng(2).uniform(0, 255, (30, 40)).astype(np.float32)
    image = (1.3 * texture - 20).astype(np.float32)
    image[10:14, 5:9] = np.nan
    out = np.empty_like(image)
    window = window_weights(3.0)[0, 0].astype(np.float32)
    pixel_equations.correct_brightness(image, texture, window, step, first_row, out)
    known = np.isfinite(image)
    np.testing.assert_allclose(out[known], texture[known], atol=0.01)
    assert np.isnan(out[~known]).all()


def test_brightness_is_that_of_a_regression() -> None:
    """At every pixel, beside weighted least squares by filters; between every second, linear in gain and offset."""
    generator = np.random.default_rng(6)
    texture = ndimage.gaussian_filter(generator.normal(0, 60, (40, 50)), 1) + 100
    image = texture * (1 + 0.004 * np.arange(50)) + generator.normal(0, 1, texture.shape)
    weights = window_weights(4.0)[0, 0]

    def mean(values: Array) -> Array:
        along = ndimage.correlate1d(values, weights, axis=0, mode="constant")
        return np.array(ndimage.correlate1d(along, weights, axis=1, mode="constant"))

    n, g, h = mean(np.ones_like(image)), mean(image), mean(texture)
    gain = (mean(image * texture) * n - g * h) / (mean(texture**2) * n - h * h)
    offset = (g - gain * h) / n
    single = [values.astype(np.float32) for values in (image, texture, weights)]
    out = np.empty((40, 50), dtype=np.float32)
    pixel_equations.correct_brightness(*single, 1, 0, out)
    np.testing.assert_allclose(out, (image - offset) / gain, atol=0.01)
    pixel_equations.correct_brightness(*single, 2, 0, out)
    expected = [values.copy() for values in (gain, offset)]
    for values in expected:
        values[1:-1:2] = (values[:-2:2] + values[2::2]) / 2
        values[:, 1:-1:2] = (values[:, :-2:2] + values[:, 2::2]) / 2
    np.testing.assert_allclose(out, (image - expected[1]) / expected[0], atol=0.01)


@pytest.mark.parametrize("order", [3, 5])
def test_transfer_of_noise_by_splines(order: int) -> None:
    """White noise between pixels, drawn, beside the integrals."""
    noise = np.random.default_rng(3).normal(0, 1, (400, 400))
    coefficients = ndimage.spline_filter(noise, order, mode="mirror")
    at = np.random.default_rng(4).uniform(20, 380, (2, 200_000))
    values = ndimage.map_coordinates(coefficients, at, order=order, prefilter=False)
    assert np.std(values) == pytest.approx(spline_transfer(order), rel=0.01)
    step = 1e-3
    ahead = ndimage.map_coordinates(coefficients, at + [[0], [step]], order=order, prefilter=False)
    assert np.std(ahead - values) / step == pytest.approx(spline_slope_transfer(order), rel=0.01)


def test_the_plane_of_the_tests_is_seen_as_the_formulas_say() -> None:
    """The grey value of a point is the same where every camera sees it: the images are consistent with the truth."""
    plane = MovingPlane(gradient=turning(1e-3, 2e-3, -1e-3))
    truth = plane.truth()
    y, x = np.mgrid[: plane.size[0], : plane.size[1]].astype(float)
    reference = plane.image((0.0, 0.0), 0.0)
    for s, t in ((1, 0), (-2, 3)):
        depth = truth["depth"] + t * truth["velocity"][2]
        centre = (plane.size[1] - 1) / 2, (plane.size[0] - 1) / 2
        points = [(x - centre[0]) * truth["depth"] / 1000, (y - centre[1]) * truth["depth"] / 1000]
        at = [
            1000 * (points[1] + t * truth["velocity"][1]) / depth + centre[1],
            1000 * (points[0] + t * truth["velocity"][0] - s * 4.0) / depth + centre[0],
        ]
        seen = ndimage.map_coordinates(plane.image((s * 4.0, 0.0), t), at, order=5, mode="mirror")[14:-14, 34:-34]
        assert np.abs(seen - reference[14:-14, 34:-34]).max() < 2e-3
