from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra.numpy import arrays

import scenetruth as st
from scenetruth.camera import LinearImage, SensorChain
from scenetruth.camera.sensor.effects import ImageLag
from scenetruth.random_streams import generator_for
from tests.scenes import cube
from tests.sensors import Array, applied

LIGHT = [
    {"kind": "photon_conversion", "photon_rate_per_s": 1e4, "exposure_time_s": 1.0},
    {"kind": "quantum_efficiency", "quantum_efficiency": 0.5},
    {"kind": "photo_response_nonuniformity", "prnu": 0.02},
    {"kind": "shot_noise"},
]
LAG = {"kind": "readout_lag", "lag": 0.1}


@given(
    some.floats(0, 0.99), some.lists(arrays(np.float64, (2, 3), elements=some.floats(0, 1e6)), min_size=1, max_size=5)
)
def test_no_electron_is_lost(lag: float, collected: list[Array]) -> None:
    effect = ImageLag(kind="readout_lag", lag=lag)
    # A dark image at the end reads what the last one has left.
    series = [*collected, np.zeros((2, 3))]
    read = [applied(effect, one, previous=before) for one, before in zip(series, [None, *series[:-1]], strict=True)]
    np.testing.assert_allclose(sum(read), sum(collected), rtol=1e-12, atol=1e-6)


def test_a_dark_image_shows_its_share_of_the_bright_one_before() -> None:
    effect = ImageLag(kind="readout_lag", lag=0.03)
    bright, dark = np.full((2, 3), 5000.0), np.zeros((2, 3))
    np.testing.assert_allclose(applied(effect, dark, previous=bright), 150.0)
    np.testing.assert_allclose(applied(effect, bright), 4850.0)
    np.testing.assert_allclose(applied(effect, bright, previous=bright), bright)
    assert effect.mean_response(5000.0, 1.0) == effect.largest_input(5000.0, 1.0) == 5000.0


# Frames 0 and 1 of three positions, as (s, t) in the order of the scan.
ORDERS = {
    "unidirectional": [(-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)],
    "bidirectional": [(-1, 0), (0, 0), (1, 0), (1, 1), (0, 1), (-1, 1)],
}


@pytest.mark.parametrize("scan", ORDERS)
def test_what_is_left_is_the_image_before_in_the_scan_noise_and_all(scan: str) -> None:
    stage = {"positions": 3, "baseline_mm": 15.0, "scan": scan, "time_per_position_s": 0.1}
    parts: dict[str, Any] = {"stage": stage, "frames": {"count": 2, "frame_interval_s": 1.0}}
    clean, lagging = (
        st.simulate(cube(**parts, sensor={"kind": "chain", "effects": effects}))[0]["image"].astype(np.float64)
        for effects in (LIGHT, [*LIGHT, LAG])
    )
    left: Array = np.zeros(clean.shape[-2:])
    for s, t in ORDERS[scan]:
        collected = clean.sel(s=s, t=t).values
        # What is read is float32.
        np.testing.assert_allclose(lagging.sel(s=s, t=t), 0.9 * collected + 0.1 * left, rtol=1e-6)
        left = collected


def test_images_may_be_read_in_any_order() -> None:
    chain = SensorChain.model_validate({"effects": [*LIGHT, LAG]})
    levels = [np.full((20, 30), level, dtype=np.float32) for level in (0.2, 0.9, 0.4)]
    images = [LinearImage(level, t=number) for number, level in enumerate(levels)]
    forwards, backwards = (chain.open((20, 30), partial(generator_for, 2)) for _ in range(2))
    first = {n: forwards.read(images[n], images[n - 1] if n else None) for n in (0, 1, 2)}
    second = {n: backwards.read(images[n], images[n - 1] if n else None) for n in (2, 0, 1)}
    for number, image in first.items():
        np.testing.assert_array_equal(image, second[number])
