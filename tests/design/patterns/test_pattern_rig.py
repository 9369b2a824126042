"""Rigs of scenes and of numbers."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import scenetruth as st
from scenetruth.design.patterns import PatternRig, compute_grey_level, find_grey_level
from scenetruth.errors import ArgumentError
from tests.helpers.pattern_rigs import plain_rig
from tests.helpers.scenes import SCENES
from tests.helpers.small_recipes import SCENE


def test_a_scene_tells_its_rig() -> None:
    rig = PatternRig.from_scene(SCENES / "plane.yaml")
    # The plane's middle is at 660 mm; it is tilted by 10 degrees along x, and 84 mm of it are seen.
    assert rig.distance_mm == pytest.approx(660, abs=2)
    assert rig.depth_range_mm is not None
    assert rig.depth_range_mm[0] < 655 < 665 < rig.depth_range_mm[1]
    assert (rig.focal_length_px, rig.baseline_mm, rig.positions, rig.frames) == (5016, 5.0, 5, 9)
    assert rig.mm_per_px == pytest.approx(660 / 5016, rel=0.003)
    assert PatternRig.from_scene(SCENES / "plane.yaml", distance_mm=500).depth_range_mm is None


def test_positions_from_a_list_have_a_baseline_of_the_same_spread() -> None:
    scene = copy.deepcopy(SCENE)
    scene["stage"] = {"positions_mm": [-4.0, 0.0, 1.0]}
    rig = PatternRig.from_scene(scene, distance_mm=100)
    # Three positions at b apart have the sum of squares 2 b².
    assert rig.baseline_mm == pytest.approx(np.sqrt(np.sum((np.array([-4, 0, 1]) + 1) ** 2) / 2))


def test_all_that_is_wrong_is_listed() -> None:
    with pytest.raises(
        ArgumentError, match=r"(?s)3 problems with the arguments of the rig.*focal_length_px.*frames.*lens"
    ):
        PatternRig.from_scene(distance_mm=100, focal_length_px=-1, frames=0, lens="good")
    with pytest.raises(ArgumentError, match="distance_mm: is missing"):
        PatternRig.from_scene(focal_length_px=100)
    away = copy.deepcopy(SCENE)
    for item in away["objects"]:
        item["pose"]["position_mm"][0] = 1e6
    with pytest.raises(st.SceneError):
        PatternRig.from_scene(away)


def test_levels_of_light_are_found_again() -> None:
    for sensor in ({"noise_std": 0.01}, {"kind": "emva1288", "preset": "industrial_cmos"}):
        rig = plain_rig(sensor=sensor)
        level = compute_grey_level(rig, 0.3)
        assert find_grey_level(rig, level.grey).grey == pytest.approx(level.grey, rel=1e-3)
        assert level.noise_std > 0
