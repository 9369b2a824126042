"""Sensor effects against their definitions, in float64."""

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
from scenetruth.camera.sensor import (
    BayerFilter,
    BayerOrder,
    FullScaleGain,
    FullWell,
    Gain,
    Gamma,
    ImageLag,
    PhotonConversion,
    Quantisation,
    QuantumEfficiency,
    RadiometricScale,
)
from scenetruth.random_streams import generator_for
from tests.helpers.scenes import cube
from tests.helpers.sensors import Array, applied, assert_converts, uniform

RED, GREEN, BLUE = 0.5, 0.8, 0.25
BLOCKS: dict[BayerOrder, list[list[float]]] = {
    "rggb": [[RED, GREEN], [GREEN, BLUE]],
    "grbg": [[GREEN, RED], [BLUE, GREEN]],
    "gbrg": [[GREEN, BLUE], [RED, GREEN]],
    "bggr": [[BLUE, GREEN], [GREEN, RED]],
}


@pytest.mark.parametrize("order", BLOCKS)
def test_filters_repeat_from_the_upper_left(order: BayerOrder) -> None:
    effect = BayerFilter(kind="bayer_filter", order=order, response=(RED, GREEN, BLUE))
    # An odd number of rows and columns: the last block is cut.
    passed = applied(effect, np.full((5, 7), 1000.0))
    for y, x in np.ndindex(passed.shape):
        assert passed[y, x] == 1000 * BLOCKS[order][y % 2][x % 2]
    assert effect.mean_response(1000.0, 1.0) == passed.max()
    assert effect.largest_input(800.0, 1.0) == 1000.0


@pytest.mark.parametrize("bits", [1, 8, 12, 16])
def test_numbers_are_rounded_and_end(bits: int) -> None:
    effect, top = Quantisation(kind="digitisation", bit_depth=bits), 2.0**bits - 1
    signal = np.array([[-3.0, 0.4, 0.6, top - 0.4, top + 0.6, 1e9]])
    assert applied(effect, signal).tolist() == [[0, 0, 1, top, top, top]]
    assert effect.mean_response(1e9, 1.0) == effect.largest_input(1e9, 1.0) == top


def test_rounding_errors_are_even() -> None:
    # A ramp over many numbers: errors are uniform in [-1/2, 1/2], with the variance 1/12.
    signal = np.linspace(10, 200, 120_000).reshape(300, 400)
    error = applied(Quantisation(kind="digitisation", bit_depth=8), signal) - signal
    assert error.var() == pytest.approx(1 / 12, rel=2e-3)


def test_one_becomes_the_largest_digital_number() -> None:
    assert_converts(FullScaleGain(kind="full_range_gain"), 0.25, 1023.75, full_scale=4095.0)


def test_radiance_of_full_scale_becomes_one() -> None:
    assert_converts(RadiometricScale(kind="full_scale", full_scale_radiance=2.5), 1.5, 0.6)


def test_no_pixel_holds_more() -> None:
    effect = FullWell(kind="full_well", full_well_e=9000.0)
    assert applied(effect, np.array([[10.0, 8999.5, 9000.5, 1e6]])).tolist() == [[10.0, 8999.5, 9000.0, 9000.0]]
    assert effect.mean_response(1e6, 1.0) == effect.largest_input(1e6, 1.0) == 9000.0
    assert effect.largest_input(100.0, 1.0) == 100.0


def test_digital_numbers_begin_at_the_black_level() -> None:
    effect = Gain(kind="gain", gain_dn_per_e=0.25, black_level_dn=64.0)
    assert_converts(effect, 1000.0, 314.0)
    assert_converts(effect, 0.0, 64.0)


def test_response_is_bent_between_its_ends() -> None:
    effect = Gamma(kind="gamma", gamma=0.5)
    assert_converts(effect, 1023.75, 2047.5, full_scale=4095.0)
    assert_converts(effect, 4095.0, 4095.0, full_scale=4095.0)


def test_it_ends_at_black_and_full_scale() -> None:
    effect = Gamma(kind="gamma", gamma=2.0)
    assert (applied(effect, uniform(-5.0), full_scale=255.0) == 0).all()
    assert (applied(effect, uniform(300.0), full_scale=255.0) == 255).all()


def test_photons_grow_with_radiance_rate_and_time() -> None:
    effect = PhotonConversion(kind="photon_conversion", photon_rate_per_s=2e6, exposure_time_s=0.01)
    assert_converts(effect, 0.3, 6000.0)


def test_there_are_no_negative_photons() -> None:
    effect = PhotonConversion(kind="photon_conversion", photon_rate_per_s=2e6, exposure_time_s=0.01)
    assert (applied(effect, uniform(-0.01)) == 0).all()


def test_some_photons_free_an_electron() -> None:
    assert_converts(QuantumEfficiency(kind="quantum_efficiency", quantum_efficiency=0.6), 5000.0, 3000.0)


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
