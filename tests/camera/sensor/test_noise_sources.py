"""Noise of the sensor against the moments of its distributions."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scenetruth.camera.sensor import (
    DarkCurrent,
    DarkSignalNonuniformity,
    GaussianNoise,
    PhotoResponseNonuniformity,
    ReadoutNoise,
    ShotNoise,
)
from tests.helpers.sensors import applied, assert_converts, assert_random, uniform


def test_electrons_grow_with_time() -> None:
    assert_converts(DarkCurrent(kind="dark_current", exposure_time_s=0.1, dark_current_e_per_s=300.0), 50.0, 80.0)


def test_hot_pixels_are_so_many_and_the_same_in_all_images() -> None:
    effect = DarkCurrent(
        kind="dark_current",
        exposure_time_s=0.5,
        dark_current_e_per_s=10.0,
        hot_pixel_share=0.01,
        hot_pixel_current_e_per_s=4000.0,
    )
    image = applied(effect, uniform(0.0))
    assert set(np.unique(image)) == {5.0, 2000.0}
    share = (image == 2000.0).mean()
    # Standard error of a share, five of them.
    assert share == pytest.approx(0.01, abs=5 * np.sqrt(0.01 / image.size))
    np.testing.assert_array_equal(applied(effect, uniform(0.0), s=1), image)


def test_hot_pixels_are_hotter() -> None:
    with pytest.raises(ValidationError, match="must not be below dark_current_e_per_s, 10"):
        DarkCurrent(kind="dark_current", exposure_time_s=1.0, dark_current_e_per_s=10.0, hot_pixel_share=0.1)


def test_offsets_scatter_as_stated_and_stay() -> None:
    effect = DarkSignalNonuniformity(kind="dark_signal_nonuniformity", dsnu_e=4.0)
    image = applied(effect, uniform(0.0))
    assert_random(image, 0.0, 4.0)
    np.testing.assert_array_equal(applied(effect, uniform(0.0), s=2), image)


def test_noise_is_as_strong_as_stated_at_any_signal() -> None:
    for signal in (0.0, 0.7):
        noise = applied(GaussianNoise(kind="gaussian_noise", noise_std=0.02), uniform(signal)) - signal
        assert_random(noise, 0.0, 0.02)


def test_two_noises_with_names_are_independent() -> None:
    first, second = (
        applied(GaussianNoise(kind="gaussian_noise", noise_std=1.0, name=name), uniform(0.0)) for name in ("a", "b")
    )
    correlation = np.corrcoef(first.ravel(), second.ravel())[0, 1]
    assert abs(correlation) < 5 / np.sqrt(first.size)


def test_sensitivities_scatter_as_stated_and_stay() -> None:
    effect = PhotoResponseNonuniformity(kind="photo_response_nonuniformity", prnu=0.02)
    image = applied(effect, uniform(5000.0))
    assert_random(image, 5000.0, 100.0)
    np.testing.assert_array_equal(applied(effect, uniform(10000.0), s=3), 2 * image)


def test_no_pixel_gives_negative_signals() -> None:
    strong = PhotoResponseNonuniformity(kind="photo_response_nonuniformity", prnu=0.9)
    assert applied(strong, uniform(1.0)).min() == 0.0


def test_noise_is_as_strong_as_stated_and_anew_in_every_image() -> None:
    effect = ReadoutNoise(kind="readout_noise", temporal_dark_noise_e=6.0)
    first, second = (applied(effect, uniform(100.0), s=s) for s in (0, 1))
    assert_random(first, 100.0, 6.0)
    assert_random(second - first, 0.0, 6.0 * np.sqrt(2))


@pytest.mark.parametrize("mean", [40.0, 5000.0, 4e9])
def test_variance_is_the_mean(mean: float) -> None:
    assert_random(applied(ShotNoise(kind="shot_noise"), uniform(mean)), mean, np.sqrt(mean))


def test_electrons_are_counted() -> None:
    drawn = applied(ShotNoise(kind="shot_noise"), uniform(2.5))
    np.testing.assert_array_equal(drawn, np.rint(drawn))
    # The chance of none at all.
    none = np.exp(-2.5)
    assert (drawn == 0).mean() == pytest.approx(none, abs=5 * np.sqrt(none / drawn.size))


def test_no_light_no_noise() -> None:
    assert (applied(ShotNoise(kind="shot_noise"), uniform(-1.0)) == 0).all()


def test_every_image_has_its_own() -> None:
    first, second = (applied(ShotNoise(kind="shot_noise"), uniform(1000.0), s=s).ravel() for s in (0, 1))
    assert abs(np.corrcoef(first, second)[0, 1]) < 5 / np.sqrt(first.size)
