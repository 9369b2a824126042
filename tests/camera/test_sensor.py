from __future__ import annotations

import numpy as np
import pytest

from scenetruth.camera import Frames, Sensor, Stage


@pytest.mark.parametrize("bits", [1, 8, 10, 16])
def test_digitisation_rounds_and_saturates(bits: int) -> None:
    sensor = Sensor(bit_depth=bits)
    top = 2**bits - 1
    radiance = np.array([-0.1, 0.0, 0.5, 1.0, 1.5], dtype=np.float32)
    digital = sensor.sense(radiance, np.random.default_rng(0))
    assert digital.tolist() == [0, 0, np.rint(0.5 * top), top, top]
    assert digital.dtype == (np.uint8 if bits <= 8 else np.uint16)


def test_noise_has_the_stated_strength_and_no_bias() -> None:
    image = np.full((400, 500), 0.5, dtype=np.float32)
    sensed = Sensor(bit_depth=None, noise_std=0.02).sense(image, np.random.default_rng(3))
    noise = sensed.astype(np.float64) - 0.5
    # Standard errors of mean and standard deviation of 200,000 values; 5 of them.
    assert abs(noise.mean()) < 5 * 0.02 / np.sqrt(noise.size)
    assert abs(noise.std() - 0.02) < 5 * 0.02 / np.sqrt(2 * noise.size)


def test_full_scale_radiance_scales_the_signal() -> None:
    assert Sensor(bit_depth=8, full_scale_radiance=2.0).sense(
        np.ones(1, dtype=np.float32), np.random.default_rng(0)
    ).tolist() == [128]


@pytest.mark.parametrize(("count", "expected"), [(1, [0]), (2, [0, 1]), (5, [-2, -1, 0, 1, 2])])
def test_stage_and_frames_count_from_the_reference(count: int, expected: list[int]) -> None:
    assert Frames(count=count).t.tolist() == expected
    assert Stage(positions=count, baseline_mm=2.5).x_mm.tolist() == [2.5 * value for value in expected]
