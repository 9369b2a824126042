"""Variance components of boards that bend and have inexact points, against draws with known components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenetruth.capture.calibration import (
    CalibrationTarget,
    RigPriors,
    VarianceComponents,
    adjust,
    calibrate,
    estimate_components,
    scatter_of_poses,
)
from tests.helpers.drawn_rigs import DrawnRig, draw_rig
from tests.helpers.nightly import NIGHTLY, nightly

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


def _start(rig: DrawnRig):  # type: ignore[no-untyped-def]
    from scenetruth.capture.calibration import RigGuess, start_state

    guess = RigGuess(focal_length_px=5016.0, principal_point_px=(331.7, 228.4))
    return start_state(rig.observations, CAMERA_ALONE, guess)


@nightly
def test_the_stated_uncertainty_includes_them() -> None:
    """Focal lengths of drawn boards: chi-squared with a probability of 0.998; without the components it is 10 times."""
    from scipy import stats

    z, naive = [], []
    for seed in range(10, 30 if NIGHTLY else 13):
        rig = held_board(seed)
        found = calibrate(rig.observations, guess=5016.0, priors=CAMERA_ALONE)
        assert any("bends" in text for text in found.warnings)
        z.append((found.value("f") - 5016) / found.std("f"))
        plain = adjust(rig.observations, _start(rig))
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


def test_errors_that_an_image_shares_widen_the_uncertainty() -> None:
    """Every image is magnified by its own 2e-4, as by a changing focus, which no board and no noise explains."""
    rig = draw_rig(4, poses=12, positions=1, priors=CAMERA_ALONE)
    generator = np.random.default_rng(0)
    fit = adjust(rig.observations, _start(rig))
    assert scatter_of_poses(fit, CAMERA_ALONE) == 1.0
    views = []
    for view in rig.observations.views:
        bow = 2e-4 * generator.standard_normal(2) @ ((view.pixels - view.pixels.mean(axis=0)) ** 2 / 200).T
        views.append(replace(view, pixels=view.pixels + np.column_stack([bow, bow])))
    other = adjust(rig.observations.selected(views), _start(rig))
    assert scatter_of_poses(other, CAMERA_ALONE) > 2.0


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
