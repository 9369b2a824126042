"""Surfaces in front of others: every pixel is told of its own; kernels beside plain readings."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.refined.discontinuity_refit import BLOCK_PX, estimate_gain_offset, uniform_gain_offset
from scenetruth.estimators.refined.image_stack import NO_DEFECTS
from scenetruth.estimators.refined.kernels import photo_consistency, warp, window_solver, window_sums
from scenetruth.estimators.refined.kernels import pixel_equations as equations
from scenetruth.estimators.refined.noise_estimation import EVEN
from scenetruth.estimators.refined.row_bands import NO_OCCLUSION, window_weights
from scenetruth.schema import make_recording
from tests.helpers.warped_images import COUNT, HEIGHT, VIEW, WIDTH, warped_by
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
# Pixels are means of 3 x 3 samples, as a sensor takes them.
FINE = 3
SIZE, WIDE_PX = (48, 104), 20
NEAR_MM, FAR_MM = 450.0, 500.0
ROWS = slice(12, -12)
NOISE_STD = 0.003


def board(depth_mm: float, velocity_mm: tuple[float, float, float], seed: int) -> MovingPlane:
    return MovingPlane(
        slopes=(0.0, 0.0),
        velocity_mm=velocity_mm,
        depth_mm=depth_mm,
        focal_px=1000.0 * FINE,
        size=(SIZE[0] * FINE, SIZE[1] * FINE),
        waves=16,
        wavelengths_px=(5.0 * FINE, 15.0 * FINE),
        seed=seed,
    )


NEAR, FAR = board(NEAR_MM, (0.1, 0.0, 0.0), 3), board(FAR_MM, (0.0, 0.1, 0.0), 4)
HALF_MM = 0.5 * WIDE_PX * NEAR_MM / 1000.0


def recordings() -> tuple[xr.Dataset, xr.Dataset]:
    """A strip 20 px wide in front of a wall, and of one without texture, which move in different ways."""
    images = np.empty((2, 5, 5, *SIZE))
    for i, s in enumerate(range(-2, 3)):
        for j, t in enumerate(range(-2, 3)):
            inside = np.abs(NEAR._hit((s * 4.0, 0.0), t)[0][..., 0]) < HALF_MM
            near = NEAR.image((s * 4.0, 0.0), t)
            for n, far in enumerate((FAR.image((s * 4.0, 0.0), t), np.full_like(near, 0.5))):
                fine = np.where(inside, near, far)
                images[n, i, j] = fine.reshape(SIZE[0], FINE, SIZE[1], FINE).mean(axis=(1, 3))
    images += np.random.default_rng(7).normal(0.0, NOISE_STD, images.shape)
    textured, plain = (make_recording(each, 1000.0, 4.0) for each in images)
    return textured, plain


@pytest.fixture(scope="module")
def estimates() -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """Of the wall with texture, the same by whole windows only, and of the wall without."""
    textured, plain = recordings()
    cases = ((textured, True), (textured, False), (plain, True))
    found = [st.estimate(each, "refined", window_frames=5, discontinuity_refit=outlines) for each, outlines in cases]
    one, two, three = (each.isel(t=0, y=ROWS) for each in found)
    return one, two, three


def distances() -> Array:
    """Distance of each column from the strip's nearer edge, positive inside."""
    x = np.arange(SIZE[1]) - (SIZE[1] - 1) / 2
    return np.asarray(0.5 * WIDE_PX - np.abs(x))


def inner() -> NDArray[np.bool_]:
    """Columns that all cameras see, with their windows."""
    x = np.arange(SIZE[1]) - (SIZE[1] - 1) / 2
    return np.asarray(np.abs(x) < SIZE[1] / 2 - 24)


def test_every_pixel_is_told_of_its_own_surface(estimates: tuple[xr.Dataset, ...]) -> None:
    """Up to 1.5 px from the outline, on both sides, though windows are wider than the strip.

    Noise of 0.003 in windows of sigma 2.4 leaves some 1e-2 px of disparity, which is 0.6 mm; surfaces are 50 mm apart.
    """
    found, plain, _ = estimates
    away = distances()
    truth = np.where(away > 0, NEAR_MM, FAR_MM)
    motion = np.where(away > 0, np.array(NEAR.velocity_mm)[:, None], np.array(FAR.velocity_mm)[:, None])
    for where in (away > 1.5, (away < -1.5) & inner()):
        known = (found["status"].values == 2)[:, where]
        assert known.mean() > 0.95
        error = np.abs(found["depth"].values - truth)[:, where][known]
        assert np.quantile(error, 0.98) < 2.0
        off = np.abs(found["velocity"].values - motion[:, None])[:2, :, where][:, known]
        assert np.quantile(off, 0.98) < 0.02
    # Whole windows see both at once.
    close = np.abs(away) < 5
    right = (plain["status"].values == 2) & (np.abs(plain["depth"].values - truth) < 2.0)
    assert right[:, close].mean() < 0.3


def test_error_bars_hold_beside_outlines(estimates: tuple[xr.Dataset, ...]) -> None:
    """Beyond 6 stated standard deviations lie at most 2 % where windows hold the outline."""
    found, away = estimates[0], distances()
    truth = np.where(away > 0, NEAR_MM, FAR_MM)
    with np.errstate(invalid="ignore"):
        scaled = np.abs(found["depth"].values - truth) / found["depth_std"].values
    close = scaled[:, (np.abs(away) > 1.5) & (np.abs(away) < 12) & inner()]
    assert np.mean(close[np.isfinite(close)] > 6) < 0.02


def test_an_untextured_wall_is_told_from_the_board_before_it(estimates: tuple[xr.Dataset, ...]) -> None:
    """Windows beside the board hold its texture; the wall's own pixels show none, and are not told."""
    known, away = estimates[2]["status"].values == 2, distances()
    assert known[:, away > 1.5].mean() > 0.9
    # The outline's own gradient reaches 3 px beyond it.
    assert known[:, away < -5].mean() < 0.02


Warped = tuple[NDArray[np.float32], NDArray[np.float32]]


def blank(products: Array) -> window_solver.Fit:
    size = (HEIGHT, WIDTH)
    theta = np.zeros((15 if len(products) == equations.PRODUCTS else 18, *size))
    theta[0] = 3.0
    variance = np.full((9, *size), np.nan)
    described, of_element = (np.full((n, *size), np.nan) for n in (window_solver.VALUES, window_solver.FUNCTIONALS))
    return window_solver.Fit(theta, variance, described, of_element, np.full(size, np.nan), np.full((2, *size), np.nan))


def model_of(products: Array) -> window_solver.Model:
    return window_solver.Model(3, 3, 2, len(products) > equations.PRODUCTS)


def fitted_to_members(products: Array, fields: Array, limit: float, reach: float) -> tuple[window_solver.Fit, Array]:
    fit, pixels = blank(products), np.argwhere(np.ones((HEIGHT, WIDTH), dtype=bool))
    shares = np.empty((len(pixels), 2))
    limits, bounds = np.full((HEIGHT, WIDTH), limit), np.array([1.0, 1.0, 0.1, reach])
    rows, model = np.ascontiguousarray(products.transpose(1, 2, 0)), model_of(products)
    window_sums.solve_members(
        rows, limits, fields, bounds, window_weights(3.0), model, VIEW, 0, fit, pixels, shares, (0, len(pixels))
    )
    return fit, shares.T.reshape(2, HEIGHT, WIDTH)


def fitted_to_all(products: Array) -> window_solver.Fit:
    fit, every = blank(products), np.zeros((HEIGHT, WIDTH), dtype=np.int8)
    weights, told = window_weights(3.0), window_solver.EVERY_VARIANCE
    models = (model_of(products), model_of(products))
    window_sums.solve_rows(products, weights, models, 1, VIEW, 1, 0, 0.0, (fit, fit), every, told, 1, (0, HEIGHT))
    return fit


@pytest.fixture(scope="module")
def products(fields: Array, warped: Warped) -> Array:
    return products_of(fields, warped)


def products_of(fields: Array, warped: Warped) -> Array:
    found = np.zeros((equations.PRODUCTS if len(fields) == 4 else equations.ALL_PRODUCTS, HEIGHT, WIDTH))
    equations.add_products(VIEW, fields, *warped, 0, COUNT, EVEN, found, (0, HEIGHT))
    return found


@pytest.mark.parametrize("count", [4, 7])
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


def test_pixels_that_would_be_moved_are_left_out(products: Array, fields: Array) -> None:
    """A pixel belongs if the fit there moves it by less than the reach in all images: by d, q_X and q_Y here."""
    theta, own = np.zeros(15), np.array([3.0, 0.2, 0.1, 0.5])
    theta[[0, 1, 6, 9, 12]] = [3.0, 0.05, 0.2, 0.1, 0.5]
    product, step = np.zeros((1, 1, equations.PRODUCTS)), np.empty(4)
    product[0, 0, 15] = 5.0
    for x, expected in ((3.9, True), (4.1, False), (-3.9, True), (-4.1, False)):
        # 0.05 px of disparity per px: beyond 4 px, the camera one step aside sees it 0.2 px off.
        reach = np.array([1.0, 0.0, 0.1, 0.2])
        assert window_sums._belongs(4, theta, x, 0.0, own, product, 0, 0, 1.0, reach, step) is expected


@pytest.mark.parametrize("count", [4, 7])
def test_squares_after_a_step_are_those_of_the_normal_equations(count: int) -> None:
    """E(step) = e - 2 b step + step M step must be within the limit, with M (d, q) + b as it is stored."""
    generator = np.random.default_rng(3)
    a = generator.normal(0, 1, (9, count))
    m, b = a.T @ a, generator.normal(0, 1, count)
    own, theta = generator.normal(0, 1, count), np.zeros(18)
    product = np.zeros(equations.ALL_PRODUCTS)
    product[:10] = m[:4, :4][np.triu_indices(4)]
    product[22:40] = [*m[:5, 4], *m[:6, 5], *m[:7, 6]] if count == 7 else 0.0
    right = m @ own + b
    product[10:14], product[40 : 36 + count] = right[:4], right[4:]
    product[14], product[15] = 30.0, 1.0
    for scale in (0.5, 1.0, 2.0):
        step = scale * generator.normal(0, 1, count)
        theta[[0, 6, 9, 12, 15, 16, 17][:count]] = own + step
        left = float(30.0 - 2 * b @ step + step @ m @ step)
        reach = np.array([1.0, 1.0, 0.1, np.inf])
        for limit in (max(left, 30.0) + 1e-6, max(left, 30.0) - 1e-6):
            expected = left <= limit and limit >= 30.0
            found = window_sums._belongs(
                count, theta, 0.0, 0.0, own, product[None, None], 0, 0, limit, reach, np.empty(count)
            )
            assert found == expected


def test_images_are_judged_by_their_variance(images: Array, fields: Array, warped: Warped) -> None:
    coefficients = _coefficients(images)
    out = np.empty((photo_consistency.SIDES, HEIGHT, WIDTH), dtype=np.float32)
    photo_consistency.judge_rows(
        coefficients, VIEW, fields, NO_DEFECTS, *uniform_gain_offset(COUNT), BLOCK_PX, out, (0, HEIGHT)
    )
    sides = [np.ones(COUNT, bool)]
    sides += [side for where in (VIEW.s, VIEW.t, VIEW.s_y) for side in (where <= 0, where >= 0)]
    for found, side in zip(out, sides, strict=True):
        seen = warped[0][side].astype(np.float64)
        count = np.isfinite(seen).sum(axis=0)
        several = count >= 3
        np.testing.assert_array_equal(np.isfinite(found), several)
        expected = np.nanvar(seen[:, several], axis=0, ddof=1)
        np.testing.assert_allclose(found[several], expected, rtol=1e-4, atol=1e-5)


def test_gains_and_offsets_are_taken_away(images: Array, fields: Array) -> None:
    """Images of one texture with gains and offsets of their own: found in blocks, none of it is left to judge."""
    texture = _coefficients(images[:1])[0]
    generator = np.random.default_rng(5)
    gain, offset = generator.uniform(0.5, 1.5, COUNT), generator.uniform(-3, 3, COUNT)
    # An offset of all coefficients is one of all grey values.
    coefficients = (gain[:, None, None] * texture + offset[:, None, None]).astype(np.float32)
    still = np.zeros_like(fields)
    good = np.ones((HEIGHT, WIDTH), dtype=bool)
    found = estimate_gain_offset(coefficients, VIEW, still, NO_DEFECTS, good)
    np.testing.assert_allclose(found.gain[:, 0, 0], gain / gain.mean(), rtol=1e-4)
    out = np.empty((photo_consistency.SIDES, HEIGHT, WIDTH), dtype=np.float32)
    photo_consistency.judge_rows(coefficients, VIEW, still, NO_DEFECTS, *found, BLOCK_PX, out, (0, HEIGHT))
    assert np.nanmax(out) < 1e-6
    photo_consistency.judge_rows(
        coefficients, VIEW, still, NO_DEFECTS, *uniform_gain_offset(COUNT), BLOCK_PX, out, (0, HEIGHT)
    )
    assert np.nanmedian(out) > 1.0
    # Blocks without good pixels have the brightness of others; without any, it is even.
    good[:, : WIDTH // 2] = False
    filled = estimate_gain_offset(coefficients, VIEW, still, NO_DEFECTS, good)
    # float32.
    np.testing.assert_allclose(filled.gain[:, 0, 0], found.gain[:, 0, 1], rtol=3e-7)
    assert (estimate_gain_offset(coefficients, VIEW, still, NO_DEFECTS, ~np.ones_like(good)).gain == 1).all()


def test_what_stands_behind_is_hidden() -> None:
    """A board of disparity 8 before a wall of 5: the camera s sees the wall at x - 5 s, and the board at x - 8 s."""
    fields = np.zeros((4, HEIGHT, WIDTH))
    fields[0] = 5.0
    board = slice(20, 30)
    fields[0, :, board] = 8.0
    hidden = np.empty((1, HEIGHT, WIDTH), dtype=np.uint8)
    view = warp.ImageView(np.array([0.0, 1.0, -1.0]), np.zeros(3), np.zeros(3), np.zeros((3, 4)), 200.0, 26.5, 18.0)
    photo_consistency.hide(view, fields, 0.5, hidden, 0)
    x = np.arange(WIDTH)
    on_board = np.isin(x, np.arange(20, 30))
    for image, s in ((0, 0.0), (1, 1.0), (2, -1.0)):
        at = x - 5.0 * s
        seen = (at >= 0) & (at < WIDTH - 1)
        # From one pixel before the board's image to one behind it, and one that a splat covers.
        first, last = 20 - 8 * s, 29 - 8 * s
        behind = (at >= first - 1) & (at <= last + 2) & ~on_board & seen & (s != 0)
        found = (hidden[0] >> image & 1).astype(bool)
        # The last row is at the image's end.
        np.testing.assert_array_equal(found[:-1], np.broadcast_to(behind, (HEIGHT - 1, WIDTH)))
    # Hidden images are not fetched.
    values = np.empty((3, HEIGHT, WIDTH), dtype=np.float32)
    texture = np.ones((3, HEIGHT, WIDTH), dtype=np.float32)
    warp.warp_rows(
        texture, view, fields, hidden, NO_DEFECTS, 0, values, np.empty((2, HEIGHT, WIDTH), np.float32), (0, HEIGHT)
    )
    free = np.empty_like(values)
    warp.warp_rows(
        texture,
        view,
        fields,
        NO_OCCLUSION,
        NO_DEFECTS,
        0,
        free,
        np.empty((2, HEIGHT, WIDTH), np.float32),
        (0, HEIGHT),
    )
    for image in range(3):
        bit = (hidden[0] >> image & 1).astype(bool)
        np.testing.assert_array_equal(np.isnan(values[image]), bit | np.isnan(free[image]))


def _coefficients(images: Array) -> NDArray[np.float32]:
    from scipy import ndimage

    return np.array([ndimage.spline_filter(image, 5, mode="mirror") for image in images], dtype=np.float32)
