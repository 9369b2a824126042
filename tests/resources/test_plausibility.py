"""Likely slips of a unit are warned of by check, with the unit; what is rare but right is not."""

from __future__ import annotations

import pytest

import scenetruth as st
from scenetruth.resources.limits import find_unit_errors
from tests.cli.calling import scenetruth
from tests.scenes import LIBRARY

GROWTH = "objects.0.deformation=[{kind: growth, "


@pytest.mark.parametrize(
    ("scene", "override", "told"),
    [
        ("cube", "sensor={noise_std: 2}", "sensor.noise_std: is 2 times full scale"),
        ("leaf", GROWTH + "rate_per_hour: 3}]", "objects.0.deformation.0.rate_per_hour: is 300 % per hour"),
        (
            "leaf",
            GROWTH + "rate_per_hour: -3, along_share: 0.5}]",
            "is -300 % per hour; specify a fraction of the area",
        ),
        ("rosette", "plants.0.growth.rate_per_hour=3", "plants.0.growth.rate_per_hour: is 300 % per hour"),
        ("cube", "camera.focal_length_px=50", "camera.focal_length_px: is 50 px for an image of 640 px"),
    ],
)
def test_values_in_another_unit_are_told_with_the_right_one(scene: str, override: str, told: str) -> None:
    (message,) = find_unit_errors(st.load_scene(scene, overrides=[override]))
    assert told in message


@pytest.mark.parametrize(
    ("scene", "overrides"),
    [
        ("cube", ["sensor={noise_std: 0.5}"]),
        ("cube", ["camera.focal_length_px=64"]),
        ("cube", ["camera.focal_length_px=null", "camera.focal_length_mm=0.5", "camera.pixel_pitch_um=10"]),
        ("leaf", [GROWTH + "rate_per_hour: 1}]"]),
        # Rubber that is pulled, along X and along Y.
        ("leaf", [GROWTH + "rate_per_hour: 30, along_share: 2}]"]),
        ("leaf", [GROWTH + "rate_per_hour: 30, along_share: -1}]"]),
    ],
)
def test_what_is_rare_but_right_is_not_warned_of(scene: str, overrides: list[str]) -> None:
    assert find_unit_errors(st.load_scene(scene, overrides=overrides)) == []


def test_no_scene_of_the_library_is_warned_of() -> None:
    assert [message for file in LIBRARY for message in find_unit_errors(st.load_scene(file))] == []


def test_check_warns_and_goes_on() -> None:
    done = scenetruth("check", "plaid", "--set", "sensor={noise_std: 2}")
    assert done.returncode == 0
    assert "warning: sensor.noise_std: is 2 times full scale" in done.stderr
    assert "the scene is valid, with " in done.stdout
