"""Images judged by what they show of the reference's points; sums over blocks beside plain loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined import fit_maps, pose_corrections
from scenetruth.estimators.refined.hypothesis_selection import (
    BLOCK_PX,
    GainOffset,
    estimate_gain_offset,
    uniform_gain_offset,
)
from scenetruth.estimators.refined.image_stack import NO_DEFECTS, ImageStack
from scenetruth.estimators.refined.kernels import photo_consistency, warp
from scenetruth.estimators.refined.row_bands import NO_OCCLUSION
from tests.helpers.kernel_images import COUNT, HEIGHT, VIEW, WIDTH, Array, Warped

# Of images in float32.
_NOISE = 1e-3


def test_images_are_judged_by_their_variance(images: Array, fields: Array, warped: Warped) -> None:
    coefficients = _coefficients(images)
    out = _judged(coefficients, fields, uniform_gain_offset(COUNT))
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
    found = estimate_gain_offset(coefficients, VIEW, still, NO_DEFECTS, good, _NOISE)
    np.testing.assert_allclose(found.gain[:, 0, 0], gain / gain.mean(), rtol=1e-4)
    assert np.nanmax(_judged(coefficients, still, found)) < 1e-6
    assert np.nanmedian(_judged(coefficients, still, uniform_gain_offset(COUNT))) > 1.0
    # Blocks without good pixels have the brightness of others; without any, it is even.
    good[:, : WIDTH // 2] = False
    filled = estimate_gain_offset(coefficients, VIEW, still, NO_DEFECTS, good, _NOISE)
    # float32.
    np.testing.assert_allclose(filled.gain[:, 0, 0], found.gain[:, 0, 1], rtol=3e-7)
    assert (estimate_gain_offset(coefficients, VIEW, still, NO_DEFECTS, ~np.ones_like(good), _NOISE).gain == 1).all()


def test_gains_of_blocks_with_wrong_parameters_are_those_of_others(images: Array) -> None:
    """A block of pixels with a wrong disparity, and one of little texture: both have the gains of the whole image."""
    texture = np.tile(_coefficients(images[:1])[0], (2, 2))[:, : 2 * WIDTH]
    gain = np.linspace(0.96, 1.04, COUNT)
    texture[BLOCK_PX:, :BLOCK_PX] = texture.mean() + 0.05 * (texture[BLOCK_PX:, :BLOCK_PX] - texture.mean())
    noise = 0.02 * float(texture.std())
    drawn = np.random.default_rng(4).normal(0, noise, (COUNT, *texture.shape))
    coefficients = (gain[:, None, None] * texture + drawn).astype(np.float32)
    fields = np.zeros((4, *texture.shape))
    fields[0, :BLOCK_PX, BLOCK_PX : 2 * BLOCK_PX] = 3.0
    good = np.ones(texture.shape, dtype=bool)
    found = estimate_gain_offset(coefficients, VIEW, fields, NO_DEFECTS, good, noise)
    bright = found.gain * float(texture.max()) + found.offset
    expected = (gain / gain.mean())[:, None, None] * float(texture.max())
    # In the block of little texture, the standard deviation of a gain is 1 / (0.05 / 0.02 √1024), about 1 %; its effect
    # on the brightest pixels is half of this.
    assert np.abs(bright / expected - 1.0).max() < 0.02


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


def test_sums_over_blocks_are_those_of_plain_loops() -> None:
    generator = np.random.default_rng(1)
    height, width, count, least, first = 20, 27, 3, 2, 3
    warped = generator.normal(0, 1, (count, height, width)).astype(np.float32)
    warped[generator.random(warped.shape) < 0.2] = np.nan
    gradient = generator.normal(0, 1, (2, height, width)).astype(np.float32)
    shifts = pose_corrections.ShiftObservations.blank((first + height, width), count)
    block_px = pose_corrections.BLOCK_PX
    for row in range(len(shifts.sums)):
        photo_consistency.add_shifts(warped, gradient, least, first, block_px, shifts.sums, (row, row + 1))
    expected = np.zeros_like(shifts.sums)
    known = np.isfinite(warped)
    mean = np.where(known, warped, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    for i, y, x in np.argwhere(known & (known.sum(axis=0) >= least)):
        (a, b), left = gradient[:, y, x], mean[y, x] - warped[i, y, x]
        expected[(y + first) // block_px, x // block_px, i] += [
            a * a, a * b, b * b, a * left, b * left, left * left, 1.0,
        ]  # fmt: skip
    # Grey values are of single precision: sums of 64 products of the order of 1.
    np.testing.assert_allclose(shifts.sums, expected, atol=1e-4)


def test_models_of_other_pixels_are_those_of_their_shifted_maps() -> None:
    generator = np.random.default_rng(4)
    source, own = (generator.normal(3.0, 0.1, (18, HEIGHT, WIDTH)) for _ in range(2))
    source[:, 5, 7], own[:, 9, 11] = np.nan, np.nan
    images = ImageStack(
        [np.zeros((1, 5, HEIGHT, WIDTH), dtype=np.float32)] * 3,
        np.stack([np.arange(-2.0, 3.0), np.zeros(5)], axis=-1),
        np.array([-1.5, 0.0, 1.0]),
        300.0,
        (30.0, 20.0),
        np.zeros((15, 4)),
    )
    pixels = np.argwhere(generator.random((HEIGHT, WIDTH)) < 0.5).copy(order="C")
    arms = np.array([2.0, 1.5, 1.5, 0.15, 1.125, 1.125, 0.1125])
    for right, down in ((0, 0), (3, -2), (-1, 4)):
        fields, moved = np.full((7, HEIGHT, WIDTH), np.nan), np.empty(len(pixels))
        photo_consistency.carry_models(source, own, pixels, (right, down), arms, fields, moved, (0, len(pixels)))
        expected = fit_maps.extract_fields(fit_maps.carried(source, right, down))
        apart = images.moved_px(fit_maps.extract_fields(own), expected)
        apart[np.isnan(own[0]) & np.isfinite(expected[0])] = np.inf
        rows, columns = pixels.T
        known = np.isfinite(expected[0, rows, columns])
        np.testing.assert_array_equal(np.isnan(moved), ~known)
        np.testing.assert_allclose(moved, apart[rows, columns], rtol=1e-12)
        found, wanted = fields[:, rows[known], columns[known]], expected[:, rows[known], columns[known]]
        np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_costs_are_means_of_the_variances_of_the_best_side() -> None:
    from scipy import ndimage

    generator = np.random.default_rng(6)
    sides = generator.uniform(0.5, 2.0, (HEIGHT, WIDTH, photo_consistency.LANES)).astype(np.float32)
    sides[generator.random(sides.shape) < 0.5] = np.nan
    sides[:10, :10] = np.nan
    pixels = np.argwhere(np.ones((HEIGHT, WIDTH), dtype=bool)).copy(order="C")
    out = np.empty(HEIGHT * WIDTH, dtype=np.float32)
    photo_consistency.compute_costs(sides, pixels, 0.3, 1.1, out, (0, len(pixels)))
    best = np.full((HEIGHT, WIDTH), np.inf)
    for side in range(photo_consistency.SIDES):
        known = np.isfinite(sides[..., side])
        share, total = (
            ndimage.gaussian_filter(values.astype(float), 1.0, truncate=2.0)
            for values in (known, np.where(known, sides[..., side], 0.0))
        )
        mean = np.where(share > 0.3, total / np.maximum(share, 0.3), np.inf)
        best = np.minimum(best, mean if side == 0 else 1.1 * mean)
    assert np.isinf(best).any()
    # Shares at the limit are left to rounding.
    close = np.isfinite(best) == np.isfinite(out.reshape(best.shape))
    assert close.mean() > 0.999
    both = close & np.isfinite(best)
    np.testing.assert_allclose(out.reshape(best.shape)[both], best[both], rtol=2e-6)


def _judged(coefficients: NDArray[np.float32], fields: Array, brightness: GainOffset) -> NDArray[np.float32]:
    """Return the variances of the images of all sides, shape (7, y, x)."""
    pixels = np.argwhere(np.ones((HEIGHT, WIDTH), dtype=bool)).copy(order="C")
    out = np.empty((len(pixels), photo_consistency.SIDES), dtype=np.float32)
    # Parts that end within rows.
    for part in ((0, 100), (100, len(pixels))):
        photo_consistency.judge_pixels(
            coefficients, VIEW, fields, NO_DEFECTS, (brightness.gain, brightness.offset), BLOCK_PX, pixels, out, part
        )
    return np.ascontiguousarray(out.T.reshape(-1, HEIGHT, WIDTH))


def _coefficients(images: Array) -> NDArray[np.float32]:
    from scipy import ndimage

    return np.array([ndimage.spline_filter(image, 5, mode="mirror") for image in images], dtype=np.float32)
