"""The method keeps the contract of methods, and it is as accurate as its users count on."""

from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.testing import assert_accuracy, estimator_checks


@pytest.mark.parametrize("check", estimator_checks("own_estimator"), ids=str)
def test_contract(check):
    """One test for each thing that a method must do, or must not."""
    check()


def test_accuracy(scenetruth_recording):
    """The recording is made once and kept in pytest's cache."""
    made = scenetruth_recording(Path(__file__).with_name("scene.yaml"))
    estimate = st.estimate(made.recording, "own_estimator")
    # Half as much again as it reaches, or a little more.
    assert_accuracy(
        estimate,
        made.truth,
        made.recording,
        depth_mm={"rmse": 2.0, "median_abs_error": 1.0},
        flow_px={"rmse": 0.03, "bias": 0.012},
        min_density=0.9,
    )
