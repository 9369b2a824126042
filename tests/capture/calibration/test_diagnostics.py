"""Diagnostics against planted mistakes, and their silence on clean calibrations."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from scenetruth.capture.calibration import (
    Observations,
    RigFit,
    RigGuess,
    RigState,
    adjust,
    advise_pose,
    apparent_steps,
    check_models,
    check_scale,
    compare_halves,
    diagnose,
    identify_combinations,
    inconsistent_images,
    pose_of_change,
    project,
    scatter_of_poses,
    start_state,
    step_problems,
)
from tests.helpers.drawn_rigs import DrawnRig, draw_rig, fit_draw
from tests.helpers.nightly import NIGHTLY, by_night, nightly


@pytest.fixture(scope="module")
def rig() -> DrawnRig:
    return draw_rig(51, poses=8, positions=3)


@pytest.fixture(scope="module")
def fit(rig: DrawnRig) -> RigFit:
    return fit_draw(rig)


def changed(rig: DrawnRig, values: np.ndarray, poses: Callable[[int], bool]) -> Observations:
    """Observations of which some poses are seen by a rig with other parameters."""
    layout, turns = rig.truth.layout, rig.truth.turns
    before = project(rig.observations, rig.truth, derivatives=False)[0]
    after = project(rig.observations, RigState(layout, values, turns), derivatives=False)[0]
    moves = np.split(after - before, rig.observations.first[1:-1])
    views = [
        replace(view, pixels=view.pixels + move) if poses(view.pose) else view
        for view, move in zip(rig.observations.views, moves, strict=True)
    ]
    return rig.observations.selected(views)


def fitted(given: Observations, rig: DrawnRig) -> RigFit:
    return adjust(given, start_state(given, rig.priors, RigGuess(focal_length_px=5040.0)))


def test_clean_calibrations_have_no_findings() -> None:
    """Each of seven tests has a false alarm with a probability of 0.001: ten calibrations have one in 7 % of runs."""
    last = 70 if NIGHTLY else 63
    rigs = [draw_rig(seed, poses=8, positions=3) for seed in range(60, last)]
    found = [diagnose(rig.observations, fit_draw(rig), rig.priors) for rig in rigs]
    assert [words for words in found if words] == []


@pytest.mark.parametrize("error", [1e-3, *by_night(-2e-3)])
def test_wrong_square_size_is_seen_in_the_scale(error: float) -> None:
    """The tolerances of board and steps, 1e-4 each, hide it from chi-squared."""
    rig = draw_rig(7, poses=8, scale_error=error)
    fit = fit_draw(rig)
    found = check_scale(fit, rig.priors)
    assert found is not None
    assert fit.variance_factor < 1.1
    assert abs(found.difference + error) < 4 * found.std
    assert abs(found.z) > 3
    assert any("size of the squares" in text for text in diagnose(rig.observations, fit, rig.priors))


def test_refocus_half_way_is_seen() -> None:
    rig = draw_rig(52, poses=8)
    values = rig.truth.values.copy()
    values[0] *= 1.002
    given = changed(rig, values, lambda pose: pose >= 4)
    fit = fitted(given, rig)
    assert fit.variance_factor < 1.1
    test = next(test for test in check_models(fit) if test.name == "refocus")
    assert abs(test.estimate - 10) < 4 * abs(test.estimate) / np.sqrt(test.chi2)
    halves = compare_halves(given, fit, rig.priors, "first against last")
    assert halves is not None
    assert halves.probability < 1e-4
    assert any("refocus" in text for text in diagnose(given, fit, rig.priors))


@pytest.mark.parametrize("onset", [4, *by_night(3)])
def test_change_of_the_camera_is_seen_although_single_poses_scatter(onset: int) -> None:
    """The scatter due to the change widens the uncertainty in which it is tested; other scatter is no change."""
    rig = draw_rig(52, poses=8, positions=3)
    values = rig.truth.values.copy()
    values[0] *= 1.004
    for turn, named in ((lambda pose: pose >= onset, onset), (lambda pose: pose % 2 > 0, None)):
        given = changed(rig, values, turn)
        fit = fitted(given, rig)
        fit = replace(fit, scatter=scatter_of_poses(fit))
        assert fit.scatter is not None
        assert pose_of_change(fit) == named
        words = [text for text in diagnose(given, fit, rig.priors) if "fixed focus" in text]
        assert bool(words) == (named is not None)
        assert pose_of_change(replace(fit, scatter=None)) is None


def test_strip_may_have_been_taken_with_the_earlier_camera() -> None:
    """The last pose is that of a strip, whose images precede the change."""
    rig = draw_rig(52, poses=9, positions=3)
    values = rig.truth.values.copy()
    values[0] *= 1.004
    given = changed(rig, values, lambda pose: 4 <= pose < 8)
    strip = given.targets[0].model_copy(update={"name": "strip"})
    views = [replace(view, target=1) if view.pose == 8 else view for view in given.views]
    given = replace(given, targets=(given.targets[0], strip), views=tuple(views))
    fit = fitted(given, rig)
    fit = replace(fit, scatter=scatter_of_poses(fit))
    assert fit.scatter is not None
    assert pose_of_change(fit) == 4
    halves = compare_halves(given, replace(fit, scatter=None), rig.priors, "first against last")
    assert halves is not None
    assert halves.probability < 1e-6


def test_lacking_radial_term_is_seen() -> None:
    rig = draw_rig(53, poses=8, positions=3)
    values = rig.truth.values.copy()
    values[7] = 3e4
    fit = fitted(changed(rig, values, lambda _: True), rig)
    test = next(test for test in check_models(fit) if test.name == "k3")
    assert test.probability < 1e-6
    assert abs(test.estimate - 3e4) < 4 * abs(test.estimate) / np.sqrt(test.chi2)


@nightly
def test_score_of_exact_models_is_chi_squared() -> None:
    """Means of 10 draws against one degree of freedom each: five times the root of 2 / 10."""
    tests = [test for seed in range(70, 80) for test in check_models(fit_draw(draw_rig(seed, poses=5, positions=3)))]
    for name in ("k3", "refocus"):
        mean = np.mean([test.chi2 for test in tests if test.name == name])
        assert 0.05 < mean < 1 + 5 * np.sqrt(2 / 10)


def test_combinations_name_what_the_images_do_not_determine(fit: RigFit) -> None:
    found = identify_combinations(fit)
    with_prior = fit.free & np.isfinite(fit.state.layout.std)
    assert len(found) == with_prior.sum()
    ratios = [each.ratio for each in found]
    assert ratios == sorted(ratios, reverse=True)
    mixed = next(each for each in found if "step_scale" in each.words and "board.scale" in each.words)
    # Steps and board have one ratio only: yaw that grows along the stage hides a scale.
    assert 0.05 < mixed.ratio < 5
    assert sum(not each.from_images for each in found) >= 7


def test_posterior_follows_from_the_ratios(fit: RigFit) -> None:
    """In units of the priors, the covariance has the eigenvalues 1 / (1 + ratio).

    Rounding: elimination by Cholesky factors, whose largest ratio is 4e6, to about 1e-9.
    """
    bound = fit.free & np.isfinite(fit.state.layout.std)
    std = fit.state.layout.std[bound]
    relative = fit.covariance[np.ix_(bound, bound)] / std[:, None] / std
    expected = sorted(1 / (1 + each.ratio) for each in identify_combinations(fit))
    np.testing.assert_allclose(np.linalg.eigvalsh(relative), expected, atol=1e-7)


def test_images_with_residuals_as_large_as_stated_are_not_named(fit: RigFit) -> None:
    """With overstated noise the residuals of most images are small, and those of exact images 1.5 times as large."""
    views = [replace(view, points=44, mean_square=0.6, consistent=True) for view in fit.views]
    views[3] = replace(views[3], mean_square=1.55)
    assert inconsistent_images(replace(fit, views=tuple(views))) == []
    views[3] = replace(views[3], mean_square=2.5)
    (text,) = inconsistent_images(replace(fit, views=tuple(views)))
    assert text.startswith(views[3].name)
    assert "sharpness" in text


def steps_of(rig: DrawnRig, given: Observations) -> list[str]:
    guess = RigGuess(focal_length_px=5016.0, principal_point_px=(331.7, 228.4))
    steps, distance = apparent_steps(given, guess)
    assert abs(distance - 660) < 60
    return step_problems(steps, given.positions_mm, 1e-4, distance)


def test_mistakes_of_the_stage_are_named_before_the_fit(rig: DrawnRig) -> None:
    given = rig.observations.selected([view for view in rig.observations.views if view.pose < 3])
    assert steps_of(rig, given) == []
    assert "reverse" in steps_of(rig, replace(given, positions_mm=-given.positions_mm))[0]
    assert "mm and m" in steps_of(rig, replace(given, positions_mm=given.positions_mm * 1000))[0]
    large = [replace(view, points_mm=view.points_mm * 1.05) for view in given.views]
    assert "square size" in steps_of(rig, given.selected(large))[0]
    turned = [
        replace(view, pixels=np.stack([view.pixels[:, 1], 639 - view.pixels[:, 0]], axis=-1)) for view in given.views
    ]
    assert "along Y" in steps_of(rig, given.selected(turned))[0]


def test_frontal_poses_ask_for_a_tilt_that_helps() -> None:
    """Three poses of up to 10° of tilt: the stated gain is that of a tilted pose of the same rig."""
    rig = draw_rig(21, poses=9, tilt_deg=(36.0, 38.0))
    frontal = [view for view in rig.observations.views if view.pose % 4 == 0]
    fit = fit_draw(replace(rig, observations=rig.observations.selected(frontal)))
    advice = advise_pose(fit, rig.priors)
    before, after = (float(text) for text in re.findall(r"to ([\d.]+) px", advice))
    assert "tilted by 37°" in advice
    assert before == pytest.approx(fit.std("f"), rel=0.06)
    wider = [view for view in rig.observations.views if view.pose % 4 == 0 or view.pose == 1]
    obtained = fit_draw(replace(rig, observations=rig.observations.selected(wider))).std("f")
    assert obtained == pytest.approx(after, rel=0.25)
    assert 2 * obtained < before
    assert advice in diagnose(fit.given, fit, rig.priors)


def test_tilted_poses_need_no_advice() -> None:
    rig = draw_rig(23, poses=4)
    assert not advise_pose(fit_draw(rig), rig.priors)
