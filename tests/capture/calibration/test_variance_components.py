"""Variance components of boards that bend and have inexact points, against draws with known components."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from scenetruth.capture.calibration import (
    CalibrationTarget,
    PoseScatter,
    RigFit,
    RigPriors,
    RigState,
    VarianceComponents,
    adjust,
    calibrate,
    estimate_components,
    places_of_points,
    refit,
    scatter_of_poses,
)
from tests.helpers.drawn_rigs import SCREW, DrawnRig, draw_rig
from tests.helpers.nightly import NIGHTLY, by_night, nightly

PAPER = CalibrationTarget(half_width_mm=36.0, scale_std=1e-3, warp_mm=0.2, bend_mm=0.1, point_mm=(0.02, 0.05))
"""A printed board that is held by hand."""
STATED = PAPER.model_copy(update={"bend_mm": 0.0, "point_mm": (0.0, 0.0)})
"""The same board as its maker states it."""
CAMERA_ALONE = RigPriors(free_distortion=("k1", "k2", "p1", "p2"))


def held_board(seed: int, poses: int = 12) -> DrawnRig:
    """Images of a camera without a stage, whose calibration does not know of bends and points."""
    rig = draw_rig(seed, poses=poses, positions=1, noise_px=0.04, priors=CAMERA_ALONE, board=PAPER)
    views = [replace(view, covariance_px2=view.covariance_px2 / 16) for view in rig.observations.views]
    return replace(rig, observations=replace(rig.observations, targets=(STATED,), views=tuple(views)))


@nightly
def test_components_are_those_of_the_draw() -> None:
    """Stated noise of 0.01 px for 0.04 px; the standard deviation of a component of n values is 0.7 / sqrt(n)."""
    rig = held_board(1, poses=16)
    fit = adjust(rig.observations, _start(rig))
    parts, _, better = estimate_components(rig.observations, fit, CAMERA_ALONE)
    assert fit.variance_factor > 4
    assert abs(better.variance_factor - 1) < 0.1
    assert abs(parts.usual_noise_px - np.sqrt(0.04**2 - 0.01**2)) < 0.004
    # 112 bends, 176 and 88 coordinates of points; some of them belong to scale, warp and poses.
    assert 0.7 < parts.bend_mm / 0.1 < 1.3
    assert 0.8 < parts.point_mm / 0.02 < 1.2
    assert 0.7 < parts.height_mm / 0.05 < 1.3


def _start(rig: DrawnRig, priors: RigPriors = CAMERA_ALONE):  # type: ignore[no-untyped-def]
    from scenetruth.capture.calibration import RigGuess, start_state

    guess = RigGuess(focal_length_px=5016.0, principal_point_px=(331.7, 228.4))
    return start_state(rig.observations, priors, guess)


@nightly
def test_the_stated_uncertainty_includes_them() -> None:
    """Focal lengths of drawn boards: chi-squared with a probability of 0.998; without the components it is 10 times."""
    z, naive = [], []
    for seed in range(10, 30 if NIGHTLY else 13):
        rig = held_board(seed)
        found = calibrate(rig.observations, guess=5016.0, priors=CAMERA_ALONE)
        assert any("bends" in text for text in found.warnings)
        z.append((found.value("f") - 5016) / found.std("f"))
        # Without the components, single draws converge slowly.
        plain = adjust(rig.observations, _start(rig), must_converge=False)
        naive.append((plain.state.value("f") - 5016) / plain.std("f"))
    low, high = stats.chi2.ppf([0.001, 0.999], len(z))
    assert low < np.square(z).sum() < high
    assert np.square(naive).sum() > high


def test_an_image_is_named_by_all_of_its_noise() -> None:
    """Stated noise of 0.01 px: 0.008 px more than that is 1.3 times as much, 0.03 px is 3.1 times as much."""
    views = draw_rig(2, poses=5, positions=1).observations.views
    parts = VarianceComponents(noise_px=(0.001, 0.001, 0.001, 0.008, 0.03), point_mm=0.01)
    named = [text for text in parts.words(views) if "sharpness" in text]
    assert len(named) == 1
    assert named[0].startswith(f"{views[4].name}: residuals are 3.1 times")


def test_exact_boards_have_no_components() -> None:
    rig = draw_rig(3, poses=8, positions=3)
    found = calibrate(rig.observations, guess=5016.0, priors=rig.priors)
    assert not any("bends" in text or "deviate" in text for text in found.warnings)


def bowed(
    seed: int, size_px: float, axes: tuple[float, float] = (1.0, 1.0), poses: int = 12
) -> tuple[RigState, RigFit]:
    """Return the truth and the fit of images that are each bowed by themselves, which no board and no noise explains.

    ``axes``: Share of the bow along x and y.
    """
    rig = draw_rig(seed, poses=poses, positions=1, priors=CAMERA_ALONE)
    generator, views = np.random.default_rng([seed, 7]), []
    for view in rig.observations.views:
        x, y = ((view.pixels - [320, 240]) / 240).T
        terms = np.column_stack([x**2, x * y, y**2, x**3, x**2 * y, x * y**2, y**3])
        bow = terms @ generator.standard_normal((7, 2)) * size_px * axes
        views.append(replace(view, pixels=view.pixels + bow))
    return rig.truth, adjust(rig.observations.selected(views), _start(rig))


def test_errors_that_an_image_shares_widen_the_uncertainty() -> None:
    """The mean factor is that of a jackknife with whole adjustments, to 10 %: one step without new weights."""
    assert scatter_of_poses(bowed(4, 0.0)[1]) is None
    fit = bowed(4, 0.01)[1]
    found = scatter_of_poses(fit)
    assert found is not None
    assert found.mean > 2
    changes, poses = [], [view.pose for view in fit.given.views]
    for omitted in poses:
        rest = fit.given.selected([view for view in fit.given.views if view.pose != omitted])
        part = refit(rest, fit, CAMERA_ALONE)
        assert part is not None
        changes.append(part.state.values[found.chosen] - fit.state.values[found.chosen])
    root = np.linalg.cholesky(np.linalg.inv(fit.covariance[np.ix_(found.chosen, found.chosen)]))
    jackknife = (len(poses) - 1) / len(poses) * float(((np.array(changes) @ root) ** 2).sum()) / fit.scale
    assert found.mean == pytest.approx(jackknife / len(found.chosen), rel=0.1)


def test_poses_that_scatter_along_one_axis_widen_it_more() -> None:
    """Bows along y alone: c_y becomes more uncertain than c_x, which the lens connects with it."""
    fit = bowed(3, 0.01, (0.0, 1.0), poses=24)[1]
    found = replace(fit, scatter=scatter_of_poses(fit)).stated_covariance
    along_x, along_y = np.sqrt(np.diag(found)[[1, 2]] / (fit.scale * np.diag(fit.covariance)[[1, 2]]))
    assert along_y > 1.1 * along_x > 1.1


@given(seed=st.integers(0, 10_000), common=st.floats(1.0, 3.0))
def test_other_parameters_follow_the_lens(seed: int, common: float) -> None:
    """Without a common factor, the covariance of the other parameters given the lens stays as it is."""
    generator = np.random.default_rng(seed)
    factor = generator.standard_normal((6, 8)) * 10.0 ** generator.uniform(-4, 4, 6)[:, None]
    covariance, chosen = factor @ factor.T, np.array([0, 2, 3])
    inner = covariance[np.ix_(chosen, chosen)]
    root = np.linalg.cholesky(inner)
    turn = np.linalg.qr(generator.standard_normal((3, 3)))[0]
    factors = common + np.sort(generator.uniform(0, 5, 3)) * [0, 1, 1]
    transfer = root @ (turn * np.sqrt(factors)) @ turn.T @ np.linalg.inv(root)
    wider = PoseScatter(chosen, transfer, factors).widened(covariance)
    scale = np.sqrt(np.diag(covariance))
    expected = transfer @ inner @ transfer.T
    unit = np.sqrt(np.diag(expected))
    assert wider[np.ix_(chosen, chosen)] / unit[:, None] / unit == pytest.approx(expected / unit[:, None] / unit)
    assert np.linalg.eigvalsh((wider - common * covariance) / scale[:, None] / scale)[0] > -1e-6
    assert _given_lens(wider, chosen, scale) == pytest.approx(common * _given_lens(covariance, chosen, scale), abs=1e-6)


def _given_lens(covariance: NDArray[np.float64], chosen: NDArray[np.int64], scale: NDArray[np.float64]) -> Any:
    """Return the covariance of the other parameters given the chosen parameters, in units of ``scale``."""
    scaled = covariance / scale[:, None] / scale
    others = np.setdiff1d(np.arange(len(scale)), chosen)
    cross = scaled[np.ix_(chosen, others)]
    return scaled[np.ix_(others, others)] - cross.T @ np.linalg.solve(scaled[np.ix_(chosen, chosen)], cross)


@nightly
def test_the_widened_uncertainty_covers_the_errors() -> None:
    """z of focal length and principal point of bowed images, with a probability of 0.998; plain it is 2 to 3."""
    z, plain = [], []
    for seed in range(100, 140 if NIGHTLY else 104):
        truth, fit = bowed(seed, 0.01)
        error = fit.state.values[:3] - truth.values[:3]
        wider = replace(fit, scatter=scatter_of_poses(fit)).stated_covariance
        z.append(error / np.sqrt(np.diag(wider)[:3]))
        plain.append(error / np.sqrt(np.diag(fit.covariance)[:3]))
    # The three are correlated: as many independent values as draws, at least.
    low, high = stats.chi2.ppf([0.001, 0.999], len(z))
    assert low < np.square(z).sum() / 3 < high
    assert np.square(plain).sum() / 3 > high


@pytest.mark.parametrize("overstated", [3.0, *by_night(1.0)])
def test_places_of_points_need_no_right_noise(overstated: float) -> None:
    """Places that deviate by 1 µm, found to 4 standard deviations of 176 values, where chi-squared is below 1.1."""
    board = STATED.model_copy(update={"point_mm": (0.001, 0.0)})
    rig = draw_rig(7, poses=12, positions=1, noise_px=0.01, priors=CAMERA_ALONE, board=board)
    square = 2.0 * overstated**2
    views = [replace(view, covariance_px2=view.covariance_px2 * square) for view in rig.observations.views]
    wrong = replace(rig, observations=replace(rig.observations, targets=(STATED,), views=tuple(views)))
    fit = adjust(wrong.observations, _start(wrong))
    assert fit.variance_factor < 1.1
    assert places_of_points(fit) == pytest.approx(0.001, rel=4 * 0.7 / np.sqrt(176))
    found = calibrate(wrong.observations, guess=5016.0, priors=CAMERA_ALONE)
    assert any("deviate by" in text for text in found.warnings)
    for name in ("c_x", "c_y"):
        assert found.std(name) > fit.std(name)
        assert abs(found.value(name) - rig.truth.value(name)) < 4 * found.std(name)


def test_exact_points_are_at_their_places() -> None:
    """Two draws by day and five by night, of which none may deviate by chance, from several positions as well."""
    for seed in range(5 if NIGHTLY else 2):
        rig = draw_rig(seed, poses=8, positions=1 + seed % 2, priors=CAMERA_ALONE if seed % 2 == 0 else SCREW)
        assert places_of_points(adjust(rig.observations, _start(rig, rig.priors))) == 0


@nightly
def test_pixels_that_are_not_square_and_a_wide_lens_are_seen() -> None:
    """An aspect of 1e-3 and k3 = 300 are estimated without being asked for; an exact camera keeps the usual lens."""
    rig = draw_rig(5, poses=10, positions=1, priors=CAMERA_ALONE)
    r = (rig.observations.pixels - [331.7, 228.4]) / 5016
    cubic = r * ((r**2).sum(axis=1) ** 3)[:, None] * 5016 * 2e4
    stretched = np.column_stack([np.zeros(len(r)), 1e-3 * r[:, 1] * 5016])
    parts = np.split(rig.observations.pixels + cubic + stretched, rig.observations.first[1:-1])
    views = [replace(view, pixels=part) for view, part in zip(rig.observations.views, parts, strict=True)]
    found = calibrate(rig.observations.selected(views), guess=5016.0)
    assert abs(found.value("aspect") - 1e-3) < 4 * found.std("aspect") < 5e-4
    assert any("aspect" in text for text in found.warnings)
    exact = calibrate(rig.observations, guess=5016.0)
    assert exact.value("aspect") == exact.std("aspect") == 0
    fixed = calibrate(
        rig.observations.selected(views), guess=5016.0, priors=RigPriors(free_distortion=("k1", "aspect"))
    )
    assert fixed.std("k2") == 0


@pytest.mark.parametrize("poses", [1, 2])
def test_too_few_poses_say_what_to_add(poses: int) -> None:
    from scenetruth.capture.calibration import CalibrationError

    rig = draw_rig(6, poses=poses, positions=1, tilt_deg=(0.0, 1.0))
    with pytest.raises(CalibrationError, match=r"add poses|tilt the board"):
        calibrate(rig.observations)
