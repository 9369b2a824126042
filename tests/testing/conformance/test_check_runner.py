"""How checks are run and what they tell: broken methods are caught, those that come with the package pass."""

from __future__ import annotations

import pickle
from typing import Any
from unittest import SkipTest

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import scenetruth as st
import scenetruth.testing
from scenetruth.estimators import Needs
from scenetruth.testing import ConformanceError, check_estimator, estimator_checks
from scenetruth.testing.conformance import all_checks
from tests.helpers import broken_methods
from tests.helpers.broken_methods import BROKEN, BackwardFlow, ZeroForMissing
from tests.helpers.gradient_method import Gradients
from tests.helpers.nightly import NIGHTLY, by_night, nightly

pytest_plugins = ["pytester"]


def far_away(recording: xr.Dataset, depth_mm: float = 600.0) -> dict[str, Any]:
    return {"depth": np.full([recording.sizes[dim] for dim in ("t", "y", "x")], depth_mm)}


def test_checks_are_modules_with_a_sentence() -> None:
    checks = all_checks()
    assert len({check.name for check in checks}) == len(checks) > 30
    for check in checks:
        assert check.says.endswith("."), check.name
        assert str(check.needs), check.name


def test_checks_for_parametrize_have_names_and_take_nothing() -> None:
    checks = estimator_checks(Gradients())
    assert (
        [str(check) for check in checks]
        == [check.__name__ for check in checks]
        == [check.name for check in all_checks()]
    )
    by_name = {str(check): check for check in checks}
    by_name["deterministic"]()
    with pytest.raises(SkipTest, match="states no standard deviations"):
        by_name["standard_deviations"]()


def test_a_method_is_only_made_when_a_check_runs() -> None:
    checks = estimator_checks("no_such_method")
    with pytest.raises(AssertionError, match="no such method"):
        checks[0]()


def test_under_pytest(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest
        from scenetruth.testing import estimator_checks
        from tests.helpers.broken_methods import ZeroForMissing

        @pytest.mark.parametrize("check", [c for c in estimator_checks(ZeroForMissing()) if str(c) in
                                           ("invalid_is_nan", "deterministic", "thread_safe")])
        def test_conforms(check):
            check()
        """
    )
    done = pytester.runpytest_inprocess("-v", "-p", "no:cacheprovider", "-rs")
    done.assert_outcomes(passed=1, failed=1, skipped=1)
    done.stdout.fnmatch_lines_random(
        [
            "*test_conforms[[]invalid_is_nan[]] FAILED*",
            "*test_conforms[[]deterministic[]] PASSED*",
            "*remedy:*write NaN at invalid pixels*",
            "*the method is not declared thread-safe*",
        ]
    )


def test_all_failures_are_told_at_once() -> None:
    with pytest.raises(ConformanceError) as caught:
        check_estimator(BackwardFlow(), only=["median_accuracy", "frame_subset", "deterministic"])
    assert isinstance(caught.value, AssertionError)
    text = str(caught.value)
    assert "1 of 3 checks passed, 2 failed" in text
    assert "px/frame in the median, the truth" in text
    assert "forward in time per frame" in text
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == text


def test_checks_are_chosen_by_name() -> None:
    assert check_estimator(
        ZeroForMissing(), skip="invalid_is_nan", only=["invalid_is_nan", "output_schema"]
    ).passed == ("output_schema",)
    with pytest.raises(st.EstimateError) as caught:
        check_estimator(Gradients(), only=["determinstic"], skip=["nothing_like_it"])
    assert [problem.path for problem in caught.value.problems] == ["only", "skip"]
    assert "did you mean 'deterministic'?" in str(caught.value)
    with pytest.raises(st.EstimateError, match="must be names"):
        check_estimator(Gradients(), skip=3)  # type: ignore[arg-type]


def test_functions_and_paths_are_methods_too() -> None:
    for method in (far_away, f"{__name__}:far_away"):
        report = check_estimator(method, only=["deterministic", "output_schema", "no_shared_memory", "median_accuracy"])
        assert len(report.passed) == 4
    with pytest.raises(ConformanceError, match="depth is 900 mm in the median"):
        check_estimator(far_away, settings={"depth_mm": 900.0}, only="median_accuracy")


def test_settings_and_sizes_reach_the_method() -> None:
    with pytest.raises(st.EstimateError, match="unknown setting"):
        check_estimator(Gradients(), settings={"begin_px": 3})
    seen = []

    def watching(recording: xr.Dataset) -> dict[str, Any]:
        seen.append(recording["image"].shape)
        return far_away(recording)

    check_estimator(watching, only="declared_outputs", size=(30, 40), cameras=5, frames=4)
    assert seen == [(5, 4, 30, 40)]
    report = check_estimator(watching, only="mirror_x", cameras=4)
    assert report.skipped == {"mirror_x": "needs an odd number of cameras, not 4"}


def test_methods_that_need_more_get_more() -> None:
    seen = []

    def watching(recording: xr.Dataset) -> dict[str, Any]:
        seen.append(recording["image"].shape)
        return far_away(recording)

    watching.needs = Needs(cameras=4, frames=6, channels=3)  # type: ignore[attr-defined]
    check_estimator(watching, only="declared_outputs")
    assert seen == [(5, 7, 56, 72, 3)]


def test_excluded_pixels_have_no_influence() -> None:
    def steady(recording: xr.Dataset) -> dict[str, Any]:
        return far_away(recording)

    def disturbed(recording: xr.Dataset) -> dict[str, Any]:
        found = far_away(recording)
        if "exclusion_mask" in recording:
            found["depth"][:, ndimage.binary_dilation(recording["exclusion_mask"].values, iterations=5)] += 1e4
        return found

    for method in (steady, disturbed):
        method.needs = Needs(exclusion_mask=True)  # type: ignore[attr-defined]
    assert check_estimator(steady, only="exclusion_mask").passed == ("exclusion_mask",)
    with pytest.raises(ConformanceError, match="give masked pixels no weight"):
        check_estimator(disturbed, only="exclusion_mask")


def test_what_cannot_be_estimated_is_told_once() -> None:
    def fails(recording: xr.Dataset) -> None:
        msg = "out of luck"
        raise RuntimeError(msg)

    with pytest.raises(ConformanceError) as caught:
        check_estimator(fails, only=["declared_outputs", "deterministic", "mirror_x"])
    assert set(caught.value.report.failed) == {"declared_outputs"}
    assert "RuntimeError: out of luck" in str(caught.value)
    assert set(caught.value.report.skipped) == {"deterministic", "mirror_x"}


def test_public_names_are_there_and_documented() -> None:
    for name in ("check_estimator", "estimator_checks", "ConformanceReport", "ConformanceError", "EstimatorCheck"):
        assert getattr(scenetruth.testing, name).__doc__
        assert name in dir(scenetruth.testing)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = scenetruth.testing.nothing


# All checks on all broken methods take a minute; by day, those that break one of five promises: on inputs,
# outputs, recordings, coordinates and values.
BY_DAY = [
    broken_methods.WritesIntoImages,
    broken_methods.ZeroForMissing,
    broken_methods.AssumesThreeCameras,
    broken_methods.TakesTheMiddleForThePrincipalPoint,
    broken_methods.NothingIsFarAway,
]


def failures(method: type[Gradients], **chosen: object) -> dict[str, str]:
    with pytest.raises(ConformanceError) as caught:
        check_estimator(method(), **chosen)  # type: ignore[arg-type]
    return caught.value.report.failed


def test_what_is_not_broken_passes() -> None:
    report = check_estimator(Gradients())
    assert not report.failed
    assert set(report.skipped) == {
        *("exclusion_mask", "single_camera", "single_frame", "standard_deviations", "streaming", "thread_safe")
    }


@pytest.mark.parametrize("method", BROKEN, ids=lambda method: method.__name__)
def test_what_is_broken_is_caught(method: type[Gradients]) -> None:
    told = failures(method, only=BROKEN[method])
    assert set(told) == BROKEN[method]
    for text in told.values():
        assert all(f"\n{part}:" in f"\n{text}" for part in ("done", "expected", "found", "remedy"))


@pytest.mark.parametrize("method", BROKEN if NIGHTLY else BY_DAY, ids=lambda method: method.__name__)
def test_and_by_no_other_check(method: type[Gradients]) -> None:
    # A store on disk takes longer than most other checks together.
    assert set(failures(method, skip=() if NIGHTLY else {"round_trip"})) == BROKEN[method]


def test_every_check_catches_something() -> None:
    assert set().union(*BROKEN.values()) == {check.name for check in all_checks()}


# Why a check does not apply to a method is part of what is promised: a check that is skipped without need says nothing.
MOTION = {"static_scene", "reversed_baseline", "baseline_scaling"}
ALWAYS = {"exclusion_mask", "thread_safe"}
SKIPPED = {
    "structure_tensor": ALWAYS,
    "plane_sweep": {*ALWAYS, "standard_deviations", "single_camera", "static_scene"},
    "opencv_stereo": {*ALWAYS, "standard_deviations", "single_camera", "static_scene"},
    "opencv_flow": {*ALWAYS, "standard_deviations", "single_frame", "baseline_scaling", "reversed_baseline"},
    "opencv_scene_flow": {*ALWAYS, "standard_deviations", "single_camera", "single_frame"},
}


# The scene flow of OpenCV joins its stereo and its flow.
@pytest.mark.parametrize(
    "method", ["structure_tensor", "plane_sweep", "opencv_scene_flow", *by_night("opencv_stereo", "opencv_flow")]
)
def test_passes(method: str) -> None:
    if method.startswith("opencv"):
        pytest.importorskip("cv2")
    report = check_estimator(method)
    assert set(report.skipped) == SKIPPED[method]


@nightly
def test_the_refined_method_passes() -> None:
    assert set(check_estimator("refined").skipped) == {"thread_safe"}
