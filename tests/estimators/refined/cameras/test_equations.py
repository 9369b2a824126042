"""Equations of images' corrections against dense least squares with all points as unknowns."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.estimators.refined.kernels.photo_consistency import add_shifts
from scenetruth.estimators.refined.kernels.warp import ImageView
from scenetruth.estimators.refined.pose_corrections import (
    BLOCK_PX,
    Blocks,
    Elimination,
    ShiftObservations,
    compute_point_derivatives,
    select_blocks,
)

S, T = (each.ravel() for each in np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]))
VIEW = ImageView(S, np.zeros(9), T, np.zeros((9, 4)), 300.0, 40.0, 30.0)
COUNT, POINTS = 9, 30


@pytest.fixture
def blocks() -> Blocks:
    generator = np.random.default_rng(3)
    root = generator.normal(0, 30, (POINTS, COUNT, 2, 6))
    fields = np.stack([generator.uniform(8, 12, POINTS), *generator.normal(0, 0.02, (2, POINTS)), np.zeros(POINTS)])
    at = generator.uniform(0, 60, (2, POINTS))
    weight = root @ root.swapaxes(-1, -2)
    shift = np.einsum("pnkl,pnl->pnk", weight, generator.normal(0, 0.01, (POINTS, COUNT, 2)))
    return Blocks(weight, shift, fields, at, 2.0)


def dense(blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and right side of the least squares over all points' own parameters and all corrections."""
    moves = compute_point_derivatives(VIEW, blocks.fields, blocks.at)
    own = moves.by_point.shape[-1]
    rows, side = [], []
    for p in range(POINTS):
        for n in range(COUNT):
            root = np.linalg.cholesky(blocks.weight[p, n])
            row = np.zeros((2, own * POINTS + 4 * COUNT))
            row[:, own * p : own * (p + 1)] = root.T @ moves.by_point[p, n]
            row[:, own * POINTS + 4 * n : own * POINTS + 4 * (n + 1)] = root.T @ moves.by_image[p, n]
            rows.append(row)
            side.append(np.linalg.solve(root, blocks.shift[p, n]))
    return np.concatenate(rows), np.concatenate(side)


def test_elimination_is_least_squares_with_all_unknowns(blocks: Blocks) -> None:
    told = Elimination(blocks, VIEW).equations(np.ones(POINTS))
    # A prior settles what images cannot tell; roll and scale are of the order of 1 px / 30 px.
    prior = np.diag(np.tile([1e4, 1e4, 1e7, 1e7], COUNT))
    found = np.linalg.solve(told.matrix + prior, told.side)
    rows, side = dense(blocks)
    padded = np.zeros((4 * COUNT, rows.shape[1]))
    padded[:, -4 * COUNT :] = np.sqrt(prior)
    expected = np.linalg.lstsq(np.concatenate([rows, padded]), np.concatenate([side, np.zeros(4 * COUNT)]), rcond=None)
    np.testing.assert_allclose(found, expected[0][-4 * COUNT :], atol=1e-7)


def test_what_images_cannot_tell_is_not_told(blocks: Blocks) -> None:
    told = Elimination(blocks, VIEW).equations(np.ones(POINTS))
    scale = np.abs(np.diag(told.matrix)).mean()
    for gauge in (S, T, S * T, np.ones(COUNT)):
        # A shift along x in proportion to s is a disparity, to t a motion; to s t, a motion along the line of sight if
        # all points have the same disparity and lie on the optical axis: not here.
        moved = np.zeros((COUNT, 4))
        moved[:, 0] = gauge
        square = moved.ravel() @ told.matrix @ moved.ravel()
        assert (abs(square) < 1e-9 * scale) == (gauge is not S * T and not np.array_equal(gauge, S * T))


def test_points_that_agree_leave_noise(blocks: Blocks) -> None:
    moves = compute_point_derivatives(VIEW, blocks.fields, blocks.at)
    generator = np.random.default_rng(5)
    corrections = generator.normal(0, 0.1, (COUNT, 4)) * [1, 1, 0.01, 0.01]
    own = generator.normal(0, 0.01, (POINTS, moves.by_point.shape[-1])) * [1, 0.1, 0.1, 1, 1, 1]
    exact = np.einsum("pnki,pi->pnk", moves.by_point, own) + np.einsum("pnki,ni->pnk", moves.by_image, corrections)
    sides = np.einsum("pnkl,pnl->pnk", blocks.weight, exact)
    noise = np.einsum("pnkl,pnl->pnk", np.linalg.cholesky(blocks.weight), generator.normal(0, 2.0, exact.shape))
    clean = Blocks(blocks.weight, sides, blocks.fields, blocks.at, 2.0)
    noisy = Blocks(blocks.weight, sides + noise, blocks.fields, blocks.at, 2.0)
    assert Elimination(clean, VIEW).misfit(corrections) == pytest.approx(0.0, abs=1e-6)
    # The mean of 30 squares with 12 degrees of freedom each: within 4 standard deviations of 1.
    assert Elimination(noisy, VIEW).misfit(corrections).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / (12 * POINTS)))
    assert Elimination(clean, VIEW).misfit(np.zeros((COUNT, 4))).mean() > 5


def test_sums_over_blocks_are_those_of_plain_loops() -> None:
    generator = np.random.default_rng(1)
    height, width, count, least, first = 20, 27, 3, 2, 3
    warped = generator.normal(0, 1, (count, height, width)).astype(np.float32)
    warped[generator.random(warped.shape) < 0.2] = np.nan
    gradient = generator.normal(0, 1, (2, height, width)).astype(np.float32)
    shifts = ShiftObservations.blank((first + height, width), count)
    for row in range(len(shifts.sums)):
        add_shifts(warped, gradient, least, first, BLOCK_PX, shifts.sums, (row, row + 1))
    expected = np.zeros_like(shifts.sums)
    known = np.isfinite(warped)
    mean = np.where(known, warped, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    for i, y, x in np.argwhere(known & (known.sum(axis=0) >= least)):
        (a, b), left = gradient[:, y, x], mean[y, x] - warped[i, y, x]
        expected[(y + first) // BLOCK_PX, x // BLOCK_PX, i] += [
            a * a, a * b, b * b, a * left, b * left, left * left, 1.0,
        ]  # fmt: skip
    # Grey values are of single precision: sums of 64 products of the order of 1.
    np.testing.assert_allclose(shifts.sums, expected, atol=1e-4)


def test_blocks_without_pixels_say_nothing() -> None:
    shifts = ShiftObservations.blank((24, 24), 2)
    shifts.sums[..., 6] = BLOCK_PX**2
    shifts.sums[1, 1, :, 6] = 3
    found = select_blocks(shifts, np.ones((4, 24, 24)))
    assert len(found.shift) == 8
