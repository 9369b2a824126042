"""Methods that are broken in one way are caught by the checks that are meant for it, and by no others."""

from __future__ import annotations

import pytest

from scenetruth.testing import ConformanceError, check_estimator
from scenetruth.testing.conformance.check_runner import all_checks
from tests.nightly import NIGHTLY
from tests.testing.conformance import broken
from tests.testing.conformance.broken import BROKEN
from tests.testing.conformance.gradients import Gradients

# All checks on all broken methods take a minute; by day, one method of each kind is tried by all.
BY_DAY = [
    broken.Random,
    broken.WritesIntoImages,
    broken.ReturnsImages,
    broken.ZeroForMissing,
    broken.NeedsCamerasAndDoesNotSayIt,
    broken.AssumesThreeCameras,
    broken.KnowsOneDirection,
    broken.TakesTheMiddleForThePrincipalPoint,
    broken.AbsoluteThreshold,
    broken.NothingIsFarAway,
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
