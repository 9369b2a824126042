"""The plain sensor: rounding, saturation, and noise whose bytes recordings rely on."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera import GaussianSensor, LinearImage
from scenetruth.random_streams import generator_for


def sensed(sensor: GaussianSensor, radiance: NDArray[np.float32], **index: int) -> NDArray[Any]:
    opened = sensor.chain().open((radiance.shape[0], radiance.shape[1]), partial(generator_for, 3, "sensor"))
    return opened.read(LinearImage(radiance, **index))


@pytest.mark.parametrize("bits", [1, 8, 10, 16])
def test_digitisation_rounds_and_saturates(bits: int) -> None:
    sensor = GaussianSensor(bit_depth=bits)
    top = 2**bits - 1
    radiance = np.array([[-0.1, 0.0, 0.5, 1.0, 1.5]], dtype=np.float32)
    digital = sensed(sensor, radiance)
    assert digital.tolist() == [[0, 0, np.rint(0.5 * top), top, top]]
    assert digital.dtype == sensor.chain().dtype == (np.uint8 if bits <= 8 else np.uint16)
    assert sensor.chain().full_scale == top


def test_noise_has_the_stated_strength_and_no_bias() -> None:
    image = np.full((400, 500), 0.5, dtype=np.float32)
    noise = sensed(GaussianSensor(bit_depth=None, noise_std=0.02), image).astype(np.float64) - 0.5
    # Standard errors of mean and standard deviation of 200,000 values; 5 of them.
    assert abs(noise.mean()) < 5 * 0.02 / np.sqrt(noise.size)
    assert abs(noise.std() - 0.02) < 5 * 0.02 / np.sqrt(2 * noise.size)


def test_full_scale_radiance_scales_the_signal() -> None:
    sensor = GaussianSensor(bit_depth=8, full_scale_radiance=2.0)
    assert sensed(sensor, np.ones((1, 1), dtype=np.float32)).tolist() == [[128]]
    assert sensor.chain().saturation_radiance == 2.0


def test_floats_have_full_scale_one() -> None:
    chain = GaussianSensor(bit_depth=None, full_scale_radiance=0.3).chain()
    assert (chain.full_scale, chain.saturation_radiance, chain.dtype) == (1.0, 0.3, np.dtype(np.float32))


@pytest.mark.parametrize("bits", [8, 12, None])
@pytest.mark.parametrize(("s_y", "key"), [(0, (-2, 4)), (1, (1, -2, 4))])
def test_recordings_keep_their_bytes(bits: int | None, s_y: int, key: tuple[int, ...]) -> None:
    # What this sensor did before it was a chain, in plain NumPy.
    radiance = np.linspace(0, 1.2, 600, dtype=np.float32).reshape(20, 30)
    noise = 0.03 * generator_for(3, "sensor", *key).standard_normal(radiance.shape)
    signal = radiance.astype(np.float64) / 1.1 + noise
    expected = signal.astype(np.float32) if bits is None else np.clip(np.rint(signal * (2**bits - 1)), 0, 2**bits - 1)
    sensor = GaussianSensor(bit_depth=bits, noise_std=0.03, full_scale_radiance=1.1)
    np.testing.assert_array_equal(sensed(sensor, radiance, s_y=s_y, s=-2, t=4), expected)
