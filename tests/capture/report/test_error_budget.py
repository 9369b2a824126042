"""Sources of the depth error: their sum, tolerances and noise that are halved, closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from scenetruth.camera import Camera, StageErrors
from scenetruth.capture.calibration import Observations, PoseScatter, RigCalibration, RigFit, RigPriors, refit
from scenetruth.capture.report import DepthBudget, depth_budget
from tests.helpers.drawn_rigs import BOARD, DrawnRig, described, draw_rig, fit_draw

DEPTH_MM = 660.0


@cache
def drawn() -> tuple[DrawnRig, RigFit, RigCalibration, DepthBudget]:
    rig = draw_rig(3, poses=4, positions=3)
    fit = fit_draw(rig)
    calibration = described(fit, rig.priors)
    return rig, fit, calibration, depth_budget(calibration, DEPTH_MM, fit)


def mean_std(given: Observations, priors: RigPriors, visits: float) -> float:
    """Return the standard deviation of the mean depth after an adjustment with other tolerances."""
    _, fit, _, _ = drawn()
    again = refit(given, fit, priors)
    assert again is not None
    found = depth_budget(described(again, priors), DEPTH_MM, again)
    return float(np.hypot(found.calibration.mean_std, visits))


def visits_mm() -> float:
    _, _, _, budget = drawn()
    return next(part.mean_mm for part in budget.parts if part.title == "repeatability in the measurement")


def halved(title: str) -> float:
    _, _, _, budget = drawn()
    return next(part.halved_mm for part in budget.parts if part.title == title)


def test_sources_add_to_the_whole_error() -> None:
    _, _, calibration, budget = drawn()
    _, _, z = calibration.point_errors(budget.pixels, DEPTH_MM, visit_std=np.zeros(6))
    np.testing.assert_allclose(budget.calibration.covariance, z.covariance, rtol=1e-6, atol=1e-9)
    _, _, z = calibration.point_errors(budget.pixels, DEPTH_MM)
    np.testing.assert_allclose(budget.total.covariance, z.covariance, rtol=1e-6, atol=1e-9)
    mean = np.sqrt(sum(part.mean_mm**2 for part in budget.parts))
    rest = np.sqrt(sum(part.rest_mm**2 for part in budget.parts))
    assert mean == pytest.approx(budget.total.mean_std, rel=1e-6)
    assert rest == pytest.approx(budget.total.rest_rms, rel=1e-6)
    assert [part.mean_mm for part in budget.parts] == sorted((part.mean_mm for part in budget.parts), reverse=True)


def test_scatter_of_the_poses_is_a_source() -> None:
    """Focal length and principal point twice as uncertain: the sources add to the whole, which exceeds the other."""
    rig, fit, _, plain = drawn()
    scatter = PoseScatter(np.arange(3), 2 * np.eye(3), np.array([1.0, 4.0, 4.0]))
    wider = replace(fit, scatter=scatter)
    calibration = described(wider, rig.priors)
    assert calibration.std("c_x") == pytest.approx(2 * fit.std("c_x"))
    budget = depth_budget(calibration, DEPTH_MM, wider)
    _, _, z = calibration.point_errors(budget.pixels, DEPTH_MM)
    np.testing.assert_allclose(budget.total.covariance, z.covariance, rtol=1e-6, atol=1e-9)
    mean = {part.title: part.mean_mm for part in budget.parts}
    before = {part.title: part.mean_mm for part in plain.parts}
    shared = mean.pop("errors that all points of a board image share")
    assert mean == pytest.approx(before)
    assert np.hypot(shared, plain.total.mean_std) == pytest.approx(budget.total.mean_std)
    assert shared > 0.1 * plain.calibration.mean_std


def test_tolerances_halved_agree_with_another_adjustment() -> None:
    rig, fit, _, _ = drawn()
    given, errors = fit.given, rig.priors.errors
    visits = visits_mm()
    better = replace(given, targets=(BOARD.model_copy(update={"scale_std": BOARD.scale_std / 2}),))
    assert halved("size of the board") == pytest.approx(mean_std(better, rig.priors, visits), rel=2e-3)
    steps = rig.priors.model_copy(update={"step_std": rig.priors.step_std / 2})
    assert halved("step length") == pytest.approx(mean_std(given, steps, visits), rel=2e-3)
    calm = errors.model_copy(update={"repeatability_um": errors.repeatability_um / 2})
    calmer = rig.priors.model_copy(update={"errors": calm})
    assert halved("repeatability in the board images") == pytest.approx(mean_std(given, calmer, visits), rel=2e-3)


def test_noise_halved_agrees_with_another_adjustment() -> None:
    rig, fit, _, _ = drawn()
    views, first = [], fit.given.first
    for number, view in enumerate(fit.given.views):
        off = fit.residuals_px[first[number] : first[number + 1]]
        views.append(replace(view, pixels=view.pixels - off / 2, covariance_px2=view.covariance_px2 / 4))
    again = mean_std(fit.given.selected(views), rig.priors, visits_mm())
    # The weights of points beyond three standard deviations differ slightly.
    assert halved("noise of the detected points") == pytest.approx(again, rel=5e-3)


def test_errors_of_a_stated_camera_are_those_of_closed_forms() -> None:
    camera = Camera(width=640, height=480, focal_length_px=5000)
    priors = RigPriors(errors=StageErrors(repeatability_um=1.0), axis_rad=0, position_um=0, step_std=2e-4)
    stated = RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 4.0}, priors=priors)
    budget = depth_budget(stated, DEPTH_MM)
    parts = {part.title: part.mean_mm for part in budget.parts}
    assert parts["stated lens"] == pytest.approx(DEPTH_MM * 4 / 5000, rel=1e-3)
    assert parts["step length"] == pytest.approx(DEPTH_MM * 2e-4, rel=1e-3)
    # Disparity from positions -1, 0, 1 with errors of their own: Z / b / √2.
    assert parts["repeatability in the measurement"] == pytest.approx(DEPTH_MM / 5 * 1e-3 / np.sqrt(2), rel=1e-3)
    assert parts["noise of the detected points"] == pytest.approx(0, abs=1e-4)
    lens = next(part for part in budget.parts if part.title == "stated lens")
    rest = budget.total.mean_std**2 - lens.mean_mm**2
    assert lens.halved_mm == pytest.approx(np.sqrt(rest + lens.mean_mm**2 / 4), rel=1e-3)


def test_words_name_the_largest_sources() -> None:
    _, _, _, budget = drawn()
    first, second = budget.words()
    assert first.startswith("Calibration and stage shift the depth at 660 mm of all pixels of a single scan together")
    assert f"standard uncertainty of {budget.total.mean_std:.2g} mm" in first
    assert f"{budget.parts[0].title} {budget.parts[0].mean_mm:.2g} mm" in first
    assert second.startswith("Depth differences within a map")
