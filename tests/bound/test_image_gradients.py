"""The noise that recordings tell of, derivatives of images, and the pieces of surface where they are taken."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.bound.image_gradients import compute_noise_variance, gradient_along, is_noise_free
from scenetruth.bound.surface_geometry import compute_interior_mask, label_surface_segments
from scenetruth.errors import Problem
from tests.helpers.small_recipes import SCENE

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


@pytest.mark.parametrize(("wavelength_px", "error"), [(12.0, 5e-6), (6.0, 3.4e-4), (4.0, 5.4e-3), (3.0, 0.047)])
def test_derivatives_are_as_exact_as_stated(wavelength_px: float, error: float) -> None:
    """Of waves, away from the ends; the errors follow from the transfer function of quintic splines."""
    x = np.arange(240.0)
    k = 2 * np.pi / wavelength_px
    wave = np.sin(k * x + 0.3)
    for axis in (0, 1):
        image = np.broadcast_to(wave[:, None] if axis == 0 else wave, (240, 240))
        found = gradient_along(image, axis)
        line = found[:, 120] if axis == 0 else found[120]
        exact = k * np.cos(k * x + 0.3)
        share = float(line[30:-30] @ exact[30:-30]) / float(exact[30:-30] @ exact[30:-30])
        assert 0 < 1 - share < error
        assert 1 - share > 0.5 * error


def test_a_step_beyond_a_piece_is_hardly_felt_inside() -> None:
    """A tenth of a step 3 px away, as pixels at the end of `compute_interior_mask` have it."""
    image = np.zeros((60, 60))
    image[:, 30:] = 1.0
    gradient = np.abs(gradient_along(image, 1)[30])
    assert gradient[27] < 0.12
    assert gradient[24] < 0.01
    pieces = np.where(np.arange(60) < 30, 0, 1) + np.zeros((60, 1), dtype=np.int64)
    assert compute_interior_mask(pieces)[30].nonzero()[0].tolist() == [*range(28), *range(32, 60)]


def test_pieces_end_at_edges_and_at_objects() -> None:
    """Two faces of one object with an edge between them, and another object."""
    depth = np.full((10, 12), 100.0)
    depth[0] = np.nan
    mixed = np.zeros(depth.shape, dtype=bool)
    mixed[:, 4] = True
    objects = np.zeros(depth.shape, dtype=int)
    objects[:, 9:] = 1
    maps = {"depth": depth, "mixed": mixed, "object_id": objects}
    pieces = label_surface_segments(xr.Dataset({name: (("y", "x"), values) for name, values in maps.items()}))
    assert (pieces[0] == -1).all()
    assert (pieces[:, 4] == -1).all()
    parts = [pieces[1:, :4], pieces[1:, 5:9], pieces[1:, 9:]]
    assert [np.unique(part).size for part in parts] == [1, 1, 1]
    assert np.unique([part[0, 0] for part in parts]).tolist() == [0, 1, 2]
