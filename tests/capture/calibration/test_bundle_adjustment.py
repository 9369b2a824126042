"""Bundle adjustment: trueness, stated uncertainty, and observations that contradict each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from scenetruth.capture.calibration import (
    RigFit,
    RigGuess,
    RigLayout,
    RigState,
    adjust,
    project,
    rotation_matrix,
    start_state,
    with_other_tilts,
)
from tests.helpers.drawn_rigs import DrawnRig, assess_draw, draw_rig, fit_draw, summarise
from tests.helpers.nightly import NIGHTLY, nightly


@pytest.fixture(scope="module")
def rig() -> DrawnRig:
    return draw_rig(1000, poses=6)


@pytest.fixture(scope="module")
def fit(rig: DrawnRig) -> RigFit:
    return fit_draw(rig)


@nightly
def test_stated_uncertainty_covers_the_errors_of_draws() -> None:
    """z of draws of 8 poses: the limits of chi-squared are passed once in 2000 for each of 15 quantities."""
    draws = 48 if NIGHTLY else 12
    found = []
    for seed in range(2000, 2000 + draws):
        one = draw_rig(seed, poses=8)
        found.append(assess_draw(one, fit_draw(one)))
    low, high = np.sqrt(stats.chi2.ppf([0.00025, 0.99975], draws) / draws)
    for name, spread, share, _ in summarise(found):
        assert low < spread < high, name
        assert share > 0.7, name


def test_a_frontal_pose_with_the_wrong_tilt_is_turned(rig: DrawnRig, fit: RigFit) -> None:
    """The normal of a pose is reflected about the line of sight; all images together tell which tilt is right."""
    layout, turns = fit.state.layout, fit.state.turns.copy()
    tilts = [float(np.hypot(*turn[:2, 2])) for turn in turns]
    number = int(np.argmin(tilts))
    assert tilts[number] < 0.2
    # Half a turn of the normal about the line of sight, and back of the board within its plane.
    about = rotation_matrix(np.array([0.0, 0.0, np.pi]))
    turns[number] = about @ turns[number] @ about
    wrong = RigState(layout, fit.state.values, turns)
    found = adjust(rig.observations, with_other_tilts(rig.observations, wrong, fit.start), fit.start)
    assert abs(found.chi2 - fit.chi2) < 1e-3
    assert abs(found.state.value("f") - fit.state.value("f")) < 1e-3 * fit.std("f")


def test_without_noise_the_truth_is_the_minimum(rig: DrawnRig) -> None:
    """Exact observations of a rig with nominal errors return all parameters."""
    truth = rig.truth.values.copy()
    layout = rig.truth.layout
    truth[11 : layout.first_pose] = 0
    state = RigState(layout, truth, rig.truth.turns)
    pixels = np.split(project(rig.observations, state, derivatives=False)[0], rig.observations.first[1:-1])
    views = [replace(view, pixels=part) for view, part in zip(rig.observations.views, pixels, strict=True)]
    exact = rig.observations.selected(views)
    found = adjust(exact, start_state(exact, rig.priors, RigGuess(focal_length_px=5060.0)))
    assert found.chi2 < 1e-12
    free = found.free[: layout.first_pose]
    error = (found.state.values - truth)[: layout.first_pose][free]
    assert np.abs(error / np.sqrt(np.diag(found.covariance)[: layout.first_pose][free])).max() < 1e-5


def test_chi_squared_is_that_of_its_degrees_of_freedom(fit: RigFit) -> None:
    """Five standard deviations, and 1 % that Huber's weights take away."""
    assert abs(fit.variance_factor - 0.995) < 5 * np.sqrt(2 / fit.dof) + 0.005
    assert all(view.consistent and view.excluded == 0 for view in fit.views)


def test_covariance_is_the_inverse_of_the_information_with_priors(fit: RigFit) -> None:
    free = fit.free
    part = fit.covariance[np.ix_(free, free)]
    total = fit.data_information + np.diag(1 / fit.state.layout.std[free] ** 2)
    product = part @ total
    # Units differ by orders of magnitude: compare in units of the standard deviations.
    scale = np.sqrt(np.diag(part))
    np.testing.assert_allclose(product / scale[:, None] * scale, np.eye(int(free.sum())), atol=1e-6)
    assert (fit.covariance[~free] == 0).all()


def test_outliers_are_excluded_and_counted(rig: DrawnRig, fit: RigFit) -> None:
    views = list(rig.observations.views)
    generator = np.random.default_rng(3)
    for number in (2, 11, 20):
        pixels = views[number].pixels.copy()
        pixels[generator.choice(len(pixels), 4, replace=False)] += generator.uniform(0.3, 40, (4, 2))
        views[number] = replace(views[number], pixels=pixels)
    given = rig.observations.selected(views)
    found = adjust(given, start_state(given, rig.priors, RigGuess(focal_length_px=5040.0)))
    assert [view.excluded for view in found.views if view.excluded] == [4, 4, 4]
    assert abs(found.state.value("f") - fit.state.value("f")) < 0.5 * fit.std("f")


def test_image_of_a_wrong_position_is_named_and_excluded(rig: DrawnRig, fit: RigFit) -> None:
    views = list(rig.observations.views)
    views[7] = replace(views[7], position=views[8].position)
    given = rig.observations.selected(views)
    found = adjust(given, start_state(given, rig.priors, RigGuess(focal_length_px=5040.0)))
    assert [view.name for view in found.views if not view.consistent] == [views[7].name]
    assert abs(found.state.value("f") - fit.state.value("f")) < 0.5 * fit.std("f")
    assert found.variance_factor < 1.1


def test_blurred_image_is_named_by_its_residuals(rig: DrawnRig) -> None:
    """Corners of one image with noise of 0.05 px for a stated 0.01 px."""
    views = list(rig.observations.views)
    generator = np.random.default_rng(4)
    views[9] = replace(views[9], pixels=views[9].pixels + 0.05 * generator.standard_normal(views[9].pixels.shape))
    given = rig.observations.selected(views)
    found = adjust(given, start_state(given, rig.priors, RigGuess(focal_length_px=5040.0)))
    squares = [view.mean_square for view in found.views]
    assert int(np.argmax(squares)) == 9
    assert squares[9] > 3 * np.median(squares) or not found.views[9].consistent


def test_one_frontal_pose_is_too_little() -> None:
    rig = draw_rig(5, poses=1, tilt_deg=(0.0, 0.0), positions=1)
    state = RigState(RigLayout.from_observations(rig.observations, rig.priors), rig.truth.values, rig.truth.turns)
    # Focal length and distance have the same effect: the uncertainty says so.
    found = adjust(rig.observations, state)
    print(found.std("f"))
    assert found.std("f") > 0.05 * found.state.value("f")
