"""Images that are not where they should be are found; equations and derivatives against dense readings of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

import scenetruth as st
from scenetruth.estimators.method_settings import CorrectionPriors
from scenetruth.estimators.refined import (
    Blocks,
    Elimination,
    ImageView,
    ShiftObservations,
    compute_point_derivatives,
    follow_points,
    select_blocks,
    solve_with_prior,
)
from tests.helpers.nightly import nightly
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
CAMERAS, FRAMES, NOISE = 5, 5, 0.01
PLANE = MovingPlane(size=(80, 112))
PRIORS = {"x_px": 0.3, "y_px": 0.3, "roll_urad": 1000.0, "scale_ppm": 300.0, "repeatability_px": 0.03}
SETTINGS = {"window_sigma_px": 4.0, "window_frames": FRAMES, "surface": "plane", "discontinuity_refit": False}


def moved(seed: int) -> Array:
    """Return how far images are off, drawn as the priors say, shape (cameras, frames, 4)."""
    generator = np.random.default_rng(seed)
    fixed = generator.normal(0, 1, (CAMERAS, 1, 4)) * [0.3, 0.3, 1e-3, 3e-4]
    fresh = generator.normal(0, 0.03, (CAMERAS, FRAMES, 2))
    off = np.repeat(fixed, FRAMES, axis=1)
    off[..., :2] += fresh
    return off


def errors(seed: int, *, corrected: bool = True) -> dict[str, Array]:
    """Return errors over stated standard deviations, and those of disparity alone."""
    off = moved(seed)
    recording = PLANE.recording(CAMERAS, FRAMES, noise_std=NOISE, seed=seed, moved=off)
    found = st.estimate(recording, "refined", SETTINGS | {"pose_corrections": PRIORS if corrected else "none"}).sel(t=0)
    truth = PLANE.truth()
    inner = found["status"].values == 2
    inner[:16], inner[-16:], inner[:, :24], inner[:, -24:] = False, False, False, False
    out = {"share": np.array(inner[16:-16, 24:-24].mean())}
    # Where the reference image is, everything is told from there: its pixels show the plane from a camera that is
    # moved, by an angle of 0.3 px / f that counts for nothing here.
    at = _shown_by_reference(off[CAMERAS // 2, FRAMES // 2])
    for name, expected in (("disparity", truth["disparity"]), ("velocity", truth["velocity"])):
        exact = _at(expected, at)
        error = (found[name].values - exact)[..., inner]
        out[name] = error
        out[f"{name}_scaled"] = error / found[f"{name}_std"].values[..., inner]
    if corrected:
        beside = off[:, FRAMES // 2] - off[CAMERAS // 2, FRAMES // 2]
        # Where the reference camera is rolled, the stage moves along its y, too: by the roll times disparity.
        along = np.arange(CAMERAS) - CAMERAS // 2
        beside[:, 1] -= off[CAMERAS // 2, FRAMES // 2, 2] * along * truth["disparity"].mean()
        shift = found["image_shift"].values.T - beside[:, :2]
        with np.errstate(invalid="ignore", divide="ignore"):
            out["shift_scaled"] = shift / found["image_shift_std"].values.T
        out["shift"] = shift
    return out


def _shown_by_reference(off: Array) -> Array:
    height, width = PLANE.size
    y, x = np.mgrid[:height, :width].astype(np.float64)
    from_x, from_y = x - (width - 1) / 2, y - (height - 1) / 2
    right, down, roll, larger = off
    return np.stack([y - down - roll * from_x - larger * from_y, x - right + roll * from_y - larger * from_x])


def _at(values: Array, at: Array) -> Array:
    from scipy.ndimage import map_coordinates

    flat = values.reshape(-1, *values.shape[-2:])
    return np.stack([map_coordinates(each, at, order=1) for each in flat]).reshape(values.shape)


@nightly
def test_images_are_found_where_they_are() -> None:
    found, without = errors(1), errors(1, corrected=False)
    # Across the stage nothing but the noise limits the shift: 100 times less than the images are off.
    assert np.abs(found["shift"][:, 1]).max() < 0.01
    assert np.delete(np.abs(found["shift_scaled"]), CAMERAS // 2, axis=0).max() < 4
    assert found["share"] > 0.95
    # The images cannot tell what all disparities have in common; the rest is as good as noise allows.
    spread = found["disparity"].std()
    assert spread < 0.5 * without["disparity"].std()
    assert np.abs(found["disparity_scaled"]).max() < 6


def test_nothing_to_correct_must_not_be_asked_for() -> None:
    with pytest.raises(ValidationError, match="corrects nothing"):
        CorrectionPriors()


@nightly
def test_error_bars_hold_what_is_left() -> None:
    squares: dict[str, list[float]] = {}
    for seed in range(100):
        found = errors(seed)
        for name in ("disparity_scaled", "velocity_scaled"):
            squares.setdefault(name, []).append(float(np.square(found[name]).mean()))
        shifts = np.delete(found["shift_scaled"], CAMERAS // 2, axis=0)
        squares.setdefault("shift_scaled", []).append(float(np.square(shifts).mean()))
    for name, values in squares.items():
        # Of 100 seeds, each with one disparity that all pixels have in common.
        assert np.sqrt(np.mean(values)) == pytest.approx(1.0, abs=0.2), name


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


def test_blocks_without_pixels_say_nothing() -> None:
    shifts = ShiftObservations.blank((24, 24), 2)
    block_px = 24 // len(shifts.sums)
    shifts.sums[..., 6] = block_px**2
    shifts.sums[1, 1, :, 6] = 3
    found = select_blocks(shifts, np.ones((4, 24, 24)))
    assert len(found.shift) == 8


TURNED_VIEW = ImageView(
    np.array([-1.0, 0.0, 2.0, 1.0]),
    np.array([0.0, 1.0, 0.0, -1.0]),
    np.array([0.0, 1.0, -2.0, 3.0]),
    np.zeros((4, 4)),
    200.0,
    30.0,
    20.0,
)
FIELDS = np.array([[5.0, 8.0], [0.02, -0.01], [-0.03, 0.02], [0.4, -0.7]])
AT = np.array([[3.0, 44.0], [35.0, 8.0]])


def places(fields: Array, at: Array, acceleration: Array) -> Array:
    """Return where the images show points, shape (points, n, 2), by projection of points in space."""
    z = TURNED_VIEW.focal / fields[0]
    point = np.stack(
        [
            (at[0] - TURNED_VIEW.centre_x) / TURNED_VIEW.focal * z,
            (at[1] - TURNED_VIEW.centre_y) / TURNED_VIEW.focal * z,
            z,
        ]
    )
    t = TURNED_VIEW.t[:, None, None]
    moved = point + t * fields[1:] + 0.5 * t**2 * np.stack([*acceleration, np.zeros(2)])
    x = TURNED_VIEW.focal * (moved[:, 0] - TURNED_VIEW.s[:, None]) / moved[:, 2]
    y = TURNED_VIEW.focal * (moved[:, 1] - TURNED_VIEW.s_y[:, None]) / moved[:, 2]
    return np.stack([x, y], axis=-1).swapaxes(0, 1)


def test_derivatives_are_those_of_projected_points() -> None:
    found = compute_point_derivatives(TURNED_VIEW, FIELDS, AT, accelerated=True).by_point
    # Central differences err by the square of the step times third derivatives, which are of the order of 1.
    step = 1e-4
    for k in range(8):
        ends = []
        for sign in (-1, 1):
            parts = [FIELDS.copy(), AT.copy(), np.zeros((2, 2))]
            part, row = (0, k) if k < 4 else (1, k - 4) if k < 6 else (2, k - 6)
            parts[part][row] += sign * step
            ends.append(places(*parts))
        expected = (ends[1] - ends[0]) / (2 * step)
        if 4 <= k < 6:
            # Columns and rows stand for a shift of the texture's grid, which moves with none of the images.
            expected = np.zeros_like(expected)
            expected[..., k - 4] = 1.0
        np.testing.assert_allclose(found[..., k], expected, atol=1e-5)


def test_corrections_move_turn_and_enlarge() -> None:
    found = compute_point_derivatives(TURNED_VIEW, FIELDS, AT).by_image
    at = places(FIELDS, AT, np.zeros((2, 2)))
    angle, share = 1e-6, 1e-6
    turned = at @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) - at
    np.testing.assert_allclose(found[..., 2] * angle, turned, atol=1e-9)
    np.testing.assert_allclose(found[..., 3] * share, at * share, atol=1e-12)
    assert (found[..., :2] == np.eye(2)).all()


def test_unknowns_with_a_prior_are_those_of_the_inverse() -> None:
    generator = np.random.default_rng(3)
    root, unknown = generator.normal(size=(6, 9)), generator.normal(size=6)
    matrix, side = root @ root.T, generator.normal(size=6)
    covariance, step = solve_with_prior(matrix, side, unknown)
    np.testing.assert_allclose(covariance, np.linalg.inv(matrix + np.eye(6)), rtol=1e-12)
    np.testing.assert_allclose(step, np.linalg.solve(matrix + np.eye(6), side - unknown), rtol=1e-12)


@pytest.mark.parametrize("information", [1e9, 1e20, 1e150])
def test_images_without_noise_leave_the_prior_of_what_they_do_not_determine(information: float) -> None:
    """Four of six combinations are observed exactly; plain inversion has no digits left for the identity."""
    generator = np.random.default_rng(5)
    observed = generator.normal(size=(4, 6))
    truth = generator.normal(size=6)
    matrix = information * observed.T @ observed
    covariance, step = solve_with_prior(matrix, matrix @ truth, np.zeros(6))
    np.testing.assert_allclose(observed @ step, observed @ truth, rtol=1e-8)
    variances = np.linalg.eigvalsh(covariance)
    np.testing.assert_allclose(variances[-2:], 1.0, rtol=1e-9)
    assert (variances[:4] < 1e-8).all()
    assert np.isfinite(np.linalg.cholesky(covariance)).all()


def test_blocks_without_texture_are_no_observations() -> None:
    """Far from any texture, the splines of images without noise leave gradients of 1e-150."""
    shape = (64, 96)
    shifts = ShiftObservations.blank(shape, 3)
    generator = np.random.default_rng(2)
    textured = generator.random(shifts.sums.shape[:2]) < 0.5
    scale = np.where(textured, 1.0, 1e-300)[..., None]
    shifts.sums[..., 0] = shifts.sums[..., 2] = scale * generator.uniform(1, 2, shifts.sums.shape[:3])
    shifts.sums[..., 5], shifts.sums[..., 6] = 1e-4, 100.0
    blocks = select_blocks(shifts, np.ones((4, *shape)))
    np.testing.assert_array_equal(blocks.at[::-1].T, shifts.centres()[:, textured].T)


def test_in_a_single_frame_points_do_not_move() -> None:
    """Positions visited one after the other: without further frames, motion is zero by definition, not an unknown.

    With it as an unknown, motion towards the camera would add to the standard deviation of the disparity, away from
    the middle of the image.
    """
    at, fields = np.array([[5.0, 90.0], [40.0, 12.0]]), np.array([[4.0, 6.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    s: Array = np.linspace(-2.0, 2.0, CAMERAS, dtype=np.float64)
    view = ImageView(s, np.zeros(CAMERAS), s.copy(), np.zeros((CAMERAS, 4)), 200.0, 55.5, 39.5)
    follow = follow_points(compute_point_derivatives(view, fields, at, still=True)).reshape(2, 6, CAMERAS, 2)
    # Least squares: d = -Σ s δ / Σ s².
    np.testing.assert_allclose(follow[:, 0, :, 0], np.tile(-s / (s @ s), (2, 1)), atol=1e-12)
    assert (follow[:, 1:4] == 0.0).all()
