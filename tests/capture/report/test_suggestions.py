"""Suggestions: poses omitted and added, against another adjustment; coverage."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from scenetruth.capture.calibration import RigCalibration, RigFit, RigPriors, refit
from scenetruth.capture.report import (
    BoardCoverage,
    DepthBudget,
    assess_poses,
    cover,
    depth_budget,
    place_targets,
    suggest,
)
from tests.helpers.drawn_rigs import described, draw_rig, fit_draw

DEPTH_MM = 660.0


@cache
def drawn(poses: int = 5) -> tuple[RigFit, RigPriors, RigCalibration, DepthBudget]:
    rig = draw_rig(4, poses=poses, positions=3)
    fit = fit_draw(rig)
    calibration = described(fit, rig.priors)
    return fit, rig.priors, calibration, depth_budget(calibration, DEPTH_MM, fit)


def test_error_without_a_pose_is_that_of_another_calibration() -> None:
    fit, priors, calibration, budget = drawn()
    found = assess_poses(fit, priors, calibration, budget)
    assert [one.pose for one in found] == [0, 1, 2, 3, 4]
    for one in found:
        # Poses can only help.
        assert one.without_mm > budget.total.mean_std
        assert (one.images, one.points) == (3, sum(len(v.pixels) for v in fit.given.views if v.pose == one.pose))
    kept = [view for view in fit.given.views if view.pose != 2]
    again = refit(fit.given.selected(kept), fit, priors)
    assert again is not None
    other = depth_budget(described(again, priors), DEPTH_MM, again)
    assert found[2].without_mm == pytest.approx(other.total.mean_std, rel=5e-3)
    # Every fourth pose is nearly frontal.
    assert [one.tilt_deg < 11 for one in found] == [True, False, False, False, True]


def test_pose_that_is_suggested_improves_the_calibration() -> None:
    fit, priors, calibration, budget = drawn()
    found = suggest(fit, priors, calibration, budget, assess_poses(fit, priors, calibration, budget))
    after = [one.after_mm for one in found[:-1]]
    assert after == sorted(after)
    pose = next(one for one in found if one.text.startswith("Add a pose"))
    assert pose.after_mm < budget.total.mean_std
    # A further pose among many helps less.
    fit, priors, calibration, more = drawn(12)
    found = suggest(fit, priors, calibration, more, ())
    gains = [1 - one.after_mm / more.total.mean_std for one in found if one.text.startswith("Add a pose")]
    assert max(gains, default=0.0) < 1 - pose.after_mm / budget.total.mean_std
    assert all(one.after_mm < more.total.mean_std for one in found)


def test_coverage_is_that_of_the_points() -> None:
    fit, _, _, _ = drawn()
    found = cover(fit)
    assert found.counts.sum() == len(fit.given.pixels)
    z = np.concatenate(place_targets(fit))[:, 2]
    np.testing.assert_allclose(found.depth_mm, (z.min(), z.max()))
    assert 0.3 < found.share < 1
    empty = BoardCoverage(np.array([[9, 9, 9, 0], [9, 9, 9, 9], [9, 9, 9, 9]]), 0.8, (600.0, 700.0))
    words = empty.words((590.0, 650.0))
    assert words[0] == "Points of the board surround 80 % of the image."
    assert words[1] == "No points of the board in parts of the image: upper right."
    assert words[2].endswith("the surface between 590 and 650 mm: take poses at its whole range.")
    assert empty.words((610.0, 650.0))[2].endswith("the surface between 610 and 650 mm.")
    assert empty.words(None)[2] == "Points of the board lie between 600 and 700 mm."
