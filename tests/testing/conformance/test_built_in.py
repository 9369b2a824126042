"""The methods that come with the package pass all checks."""

from __future__ import annotations

import pytest

from scenetruth.testing import check_estimator
from tests.nightly import nightly

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


@pytest.mark.parametrize("method", SKIPPED)
def test_passes(method: str) -> None:
    if method.startswith("opencv"):
        pytest.importorskip("cv2")
    report = check_estimator(method)
    assert set(report.skipped) == SKIPPED[method]
    # Fast enough to be run after every change of a method.
    assert max(outcome.seconds for outcome in report.outcomes) < 20


@nightly
def test_the_refined_method_passes() -> None:
    assert set(check_estimator("refined").skipped) == {"thread_safe"}
