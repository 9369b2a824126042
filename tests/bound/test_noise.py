"""The noise that recordings tell of, against that of their images."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.bound.image_gradients import compute_noise_variance, is_noise_free
from scenetruth.errors import Problem
from tests.dataset.conftest import SCENE

EMVA = {"kind": "emva1288", "preset": "industrial_cmos", "dsnu_e": 0.0, "prnu": 0.0}


def still(sensor: Any, frames: int = 40) -> xr.Dataset:
    """A wall that does not move, seen by a camera without depth of its own: only noise changes."""
    scene = copy.deepcopy(SCENE)
    scene["objects"] = scene["objects"][:1]
    scene["frames"] = {"count": frames}
    scene["stage"] = {"positions": 2, "baseline_mm": 5}
    scene["sensor"] = sensor
    return st.simulate(st.Scene.from_dict(scene))[0]


@pytest.mark.parametrize(
    "sensor", [{"noise_std": 0.01, "bit_depth": 8}, {"noise_std": 0.02, "bit_depth": None}, EMVA], ids=str
)
def test_it_is_that_of_the_images(sensor: dict[str, Any]) -> None:
    """40 frames of 3456 pixels: the mean variance is known to 0.4 %, that of the darkest tenth to 1.3 %."""
    recording = still(sensor)
    problems: list[Problem] = []
    noise = compute_noise_variance(recording, None, problems)
    assert problems == []
    values = recording["image"].values.astype(np.float64)
    mean, variance = values.mean(axis=1), values.var(axis=1, ddof=1)
    told = noise.variance(mean)
    assert np.mean(variance / told) == pytest.approx(1.0, abs=0.02)
    dark = mean < np.quantile(mean, 0.1)
    assert np.mean(variance[dark] / told[dark]) == pytest.approx(1.0, abs=0.05)
    assert not is_noise_free(recording)


def test_a_given_noise_goes_before_the_sensor() -> None:
    recording = still({"noise_std": 0.01, "bit_depth": 8}, frames=1)
    problems: list[Problem] = []
    assert compute_noise_variance(recording, 3.0, problems).variance(np.array([7.0])) == pytest.approx(9.0)
    assert problems == []


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        ("ideal", "is zero"),
        ({"noise_std": 0.0, "bit_depth": None}, "is zero"),
        ({**EMVA, "gamma": 0.45}, "not from this one"),
    ],
    ids=str,
)
def test_sensors_that_tell_nothing_ask_for_it(sensor: Any, said: str) -> None:
    recording = still(sensor, frames=1)
    problems: list[Problem] = []
    compute_noise_variance(recording, None, problems)
    assert [problem.path for problem in problems] == ["noise_std"]
    assert said in str(problems[0])
    assert is_noise_free(recording) == (said == "is zero")
