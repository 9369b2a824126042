"""Radiometry from frames, against simulated sensors whose parameters are exact, and against closed forms."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import scenetruth
from scenetruth.camera import EmvaSensor
from scenetruth.capture import (
    FrameMoments,
    SensorNoise,
    compare_exposures,
    find_defects,
    fit_gamma,
    frame_moments,
    measure_linearity,
    measure_noise,
)
from scenetruth.errors import ArgumentError
from scenetruth.random_streams import generator_for
from tests.helpers.captured_folders import read, texture
from tests.helpers.nightly import NIGHTLY

SHAPE = (120, 160)
PRESETS = ("industrial_cmos", "scientific_cmos", "ccd_2002")


def exposed(
    seed: int, *, dark: int = 8, flat: int = 16, static: int = 9, preset: str = "industrial_cmos", **fields: Any
) -> tuple[EmvaSensor, FrameMoments, FrameMoments, FrameMoments]:
    """Return a sensor and the moments of dark frames, flat fields with a fall-off of 20 %, and a static texture."""
    sensor = EmvaSensor.model_validate({"kind": "emva1288", "preset": preset, **fields})
    opened = sensor.chain().open(SHAPE, lambda *key: generator_for(seed, *key))
    y, x = np.meshgrid(np.linspace(-1, 1, SHAPE[0]), np.linspace(-1, 1, SHAPE[1]), indexing="ij")
    light = {0: np.zeros(SHAPE), 1: 0.5 * (1 - 0.1 * (x**2 + y**2)), 2: texture(SHAPE, seed)}
    counts = {0: dark, 1: flat, 2: static}
    sets = [frame_moments([read(opened, light[n], n, t) for t in range(count)]) for n, count in counts.items()]
    return sensor, sets[0], sets[1], sets[2]


@cache
def draws(preset: str) -> list[tuple[EmvaSensor, SensorNoise, SensorNoise]]:
    """Return the noise from flat fields, and that from static frames, of eight sensors of a preset."""
    found = []
    for seed in range(8):
        sensor, dark, flat, static = exposed(seed, preset=preset)
        full = float(2**sensor.bit_depth - 1)
        found.append(
            (
                sensor,
                measure_noise(dark, flat, full_scale=full),
                measure_noise(dark, static=static, full_scale=full),
            )
        )
    return found


def truth(sensor: EmvaSensor) -> dict[str, float]:
    current = sensor.dark_current_e_per_s * sensor.exposure_time_s
    return {
        "gain_dn_per_e": sensor.gain_dn_per_e,
        "temporal_dark_noise_e": float(np.hypot(sensor.temporal_dark_noise_e, np.sqrt(current))),
        "dsnu_e": sensor.dsnu_e,
        "prnu": sensor.prnu,
        "black_level_dn": sensor.black_level_dn + sensor.gain_dn_per_e * current,
    }


STDS = {
    "gain_dn_per_e": "gain_std",
    "temporal_dark_noise_e": "temporal_dark_noise_std",
    "dsnu_e": "dsnu_std",
    "prnu": "prnu_std",
    "black_level_dn": "black_level_std",
}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("name", STDS)
def test_noise_of_simulated_sensors_is_unbiased_and_its_uncertainty_right(preset: str, name: str) -> None:
    errors = np.array([getattr(flat, name) - truth(sensor)[name] for sensor, flat, _ in draws(preset)])
    stds = np.array([getattr(flat, STDS[name]) for _, flat, _ in draws(preset)])
    z = errors / stds
    # Of 8 draws, the mean of z has a standard deviation of 0.35; four of them are exceeded once in 16,000.
    assert abs(z.mean()) < 4 * 0.354
    # The sum of squares of 8 normal values lies between 0.86 and 31.8 but once in 2000 each.
    assert 0.86 < np.sum(z**2) < 31.8
    relative = stds / truth(sensor := draws(preset)[0][0])[name]
    assert relative.max() < {"gain_dn_per_e": 0.006, "prnu": 0.03}.get(name, 0.2), sensor


@pytest.mark.parametrize("preset", PRESETS)
def test_gain_from_a_static_texture_is_that_of_flat_fields(preset: str) -> None:
    z = np.array([(noise.gain_dn_per_e - sensor.gain_dn_per_e) / noise.gain_std for sensor, _, noise in draws(preset)])
    assert abs(z.mean()) < 4 * 0.354
    assert 0.86 < np.sum(z**2) < 31.8
    assert all(np.isnan(noise.prnu) for _, _, noise in draws(preset))


def test_flicker_of_the_light_does_not_change_the_gain() -> None:
    draw = np.random.default_rng(1)
    dark = np.rint(draw.normal(16, 2, (8, 80, 80)))
    light = 2000 * draw.normal(1, 0.01, (16, 1, 1))
    flat = np.rint(16 + 0.5 * draw.poisson(np.broadcast_to(light, (16, 80, 80))) + draw.normal(0, 2, (16, 80, 80)))
    noise = measure_noise(dark, flat, full_scale=4095)
    # Without a correction, 1 % of 1000 DN adds 100 DN² to 500.
    assert abs(noise.gain_dn_per_e - 0.5) < 4 * noise.gain_std
    assert noise.gain_std < 0.005


def test_noise_hidden_by_rounding_is_not_stated() -> None:
    draw = np.random.default_rng(1)
    dark = np.rint(draw.normal(16.2, 0.2, (8, 60, 60)))
    flat = np.rint(16 + 0.1 * draw.poisson(9000, (8, 60, 60)))
    noise = measure_noise(dark, flat, full_scale=4095)
    assert np.isnan(noise.temporal_dark_noise_e)
    assert any("rounding" in note for note in noise.notes)
    cut = measure_noise(np.maximum(np.rint(draw.normal(1, 2, (8, 60, 60))), 0), flat, full_scale=4095)
    assert np.isnan(cut.temporal_dark_noise_e)
    assert any("reach 0" in note for note in cut.notes)


def test_a_camera_that_moves_makes_the_gain_uncertain() -> None:
    sensor, dark, _, _ = exposed(1, flat=2, static=3)
    opened = sensor.chain().open(SHAPE, lambda *key: generator_for(1, *key))
    surface = texture(SHAPE, 1)
    moved = [read(opened, np.roll(surface, t // 5, axis=1), 5, t) for t in range(9)]
    noise = measure_noise(dark, static=moved, full_scale=4095)
    assert any("moved" in note for note in noise.notes)


def test_frames_that_do_not_fit_are_rejected_together() -> None:
    small = np.zeros((2, 5, 5))
    with pytest.raises(ArgumentError) as caught:
        measure_noise(np.zeros((1, 20, 20)), small, static=np.zeros(3), full_scale=255)
    assert [problem.path for problem in caught.value.problems] == ["dark", "flat", "static"]
    with pytest.raises(ArgumentError, match="exchanged"):
        measure_noise(np.full((2, 20, 20), 100.0), np.full((2, 20, 20), 10.0), full_scale=255)
    with pytest.raises(ArgumentError, match="must have the shape"):
        measure_noise(np.zeros((2, 20, 20)), np.ones((2, 20, 30)), full_scale=255)


def test_predicted_variance_is_that_of_new_frames() -> None:
    sensor, dark, flat, static = exposed(3)
    noise = measure_noise(dark, flat, full_scale=4095)
    predicted = noise.variance_dn2(static.mean)
    # 19,200 pixels of 8 degrees of freedom: 0.36 %, and the gain differs by 0.3 %.
    assert static.variance.mean() / predicted.mean() == pytest.approx(1, abs=4 * 0.0047)
    assert sensor.gain_dn_per_e == pytest.approx(noise.gain_dn_per_e, abs=4 * noise.gain_std)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("gamma", [1.0, 0.45])
def test_gamma_is_never_taken_for_another(preset: str, gamma: float) -> None:
    decided, count = 0, 3 if NIGHTLY else 1
    for seed in range(count):
        sensor, dark, _, static = exposed(seed, preset=preset, gamma=gamma, flat=2)
        full = float(2**sensor.bit_depth - 1)
        for fit in (fit_gamma(static, full_scale=full, dark=dark), fit_gamma(static, full_scale=full)):
            assert fit.linear in (gamma == 1, None)
            decided += fit.linear is not None
    # The CCD has read noise that an encoding can imitate.
    assert decided >= (0 if preset == "ccd_2002" and gamma < 1 else count)


def test_noise_that_is_cut_off_at_zero_is_no_gamma() -> None:
    """Additive noise of 41 digital numbers about a black of 0: of its dark pixels, the positive ones vary less."""
    mean = np.concatenate([np.zeros(64), np.linspace(1500, 3300, 256)])
    noise = np.random.default_rng(8).normal(0, 41, (4, 240, 320))
    frames = np.clip(np.rint(mean + noise), 0, 4095)
    assert fit_gamma(frames, full_scale=4095).linear is not False


def test_gamma_of_frames_without_contrast_is_open() -> None:
    draw = np.random.default_rng(1)
    assert fit_gamma(draw.normal(1000, 20, (5, 40, 40)), full_scale=4095).linear is None


@given(st.floats(0.3, 1.2), st.floats(0.1, 1e4), st.integers(2, 6))
def test_linearity_finds_the_exponent_of_a_power(exponent: float, scale: float, count: int) -> None:
    times = 0.001 * 2.0 ** np.arange(count)
    found = measure_linearity(list(times), list(scale * (times / times[0]) ** exponent), std_dn=0.01 * scale)
    assert found.exponent == pytest.approx(exponent, abs=1e-9)
    if abs(exponent - 1) < 1e-6 and count > 2:
        assert found.error < 1e-5


def test_uncertainty_of_the_exponent_is_that_of_its_draws() -> None:
    draw = np.random.default_rng(1)
    times = np.array([1.0, 2, 4, 8])
    means = 100 * times
    found = [measure_linearity(list(times), list(means + draw.normal(0, 2, 4)), std_dn=2.0) for _ in range(400)]
    ratio = np.std([each.exponent for each in found]) / found[0].exponent_std
    assert ratio == pytest.approx(1, abs=4 / np.sqrt(800))


@pytest.mark.parametrize(
    ("times", "means"), [([1, 1], [2, 2]), ([1], [2]), ([1, 2], [3]), ([0, 1], [1, 2]), ([1, 2], [-1, 2])]
)
def test_impossible_series_are_rejected(times: list[float], means: list[float]) -> None:
    with pytest.raises(ArgumentError):
        measure_linearity(times, means)


def test_defects_are_found_and_no_other_pixel() -> None:
    draw = np.random.default_rng(1)
    dark = np.rint(draw.normal(16, 2, (8, 80, 90)) + draw.normal(0, 0.5, (80, 90)))
    y, x = np.mgrid[:80, :90]
    light = 2000 * (1 - 0.2 * ((x - 40) ** 2 + (y - 40) ** 2) / 3200) * draw.normal(1, 0.005, (80, 90))
    flat = np.rint(16 + draw.normal(0, 30, (16, 80, 90)) + light)
    assert not find_defects(dark, flat).any()
    dark[:, 3, 4] += 200  # bright without light
    dark[:, 5, 6] += draw.normal(0, 60, 8)  # noisy
    flat[:, 7, 8] = dark[:1, 7, 8] + 0.5 * light[7, 8]  # insensitive
    assert np.argwhere(find_defects(dark, flat)).tolist() == [[3, 4], [5, 6], [7, 8]]
    assert np.argwhere(find_defects(dark)).tolist() == [[3, 4], [5, 6]]
    with pytest.raises(ArgumentError):
        find_defects(dark, flat[:, :10])
    with pytest.raises(ArgumentError):
        find_defects(dark, threshold=0)


def test_few_dark_frames_do_not_make_noisy_pixels() -> None:
    """Variances of two frames have one degree of freedom: the largest of 7,200 is 15 times their mean."""
    for seed in range(20):
        dark = np.rint(np.random.default_rng(seed).normal(16, 2, (2, 80, 90)))
        assert not find_defects(dark).any()


def test_exposures_are_compared_within_each_position() -> None:
    draw = np.random.default_rng(1)
    factors: NDArray[np.float64] = np.array([1.0, 1.02, 0.97, 1.0, 1.1])
    light = draw.uniform(50, 150, (3, 1, 20, 30))
    images = (16 + light * factors[:, None, None]).astype(np.float32)
    images[1, 4] = np.nan
    recording = scenetruth.make_recording(images, 100, 5, full_scale=255)
    found = compare_exposures(recording, black_level_dn=16)
    assert found.dims == ("s", "t")
    assert np.allclose(found[0], factors, rtol=1e-5)
    assert np.isnan(found[1, 4])
    with pytest.raises(ArgumentError):
        compare_exposures(recording, black_level_dn=200)


def test_flat_fields_that_are_saturated_leave_the_dark_frames_usable() -> None:
    draw = np.random.default_rng(2)
    fixed = draw.normal(0, 3, (40, 50))
    dark = np.rint(64 + fixed + draw.normal(0, 2, (8, 40, 50)))
    found = measure_noise(dark, np.full((4, 40, 50), 255), full_scale=255)
    assert np.isnan(found.gain_dn_per_e)
    assert np.isnan(found.prnu)
    assert found.dark_noise_dn == pytest.approx(2, rel=0.05)
    assert any("flat fields are saturated" in note for note in found.notes)
    with pytest.raises(ArgumentError, match="dark: reaches the full scale of 30 everywhere"):
        measure_noise(dark, full_scale=30)
