"""Exponential growth and relaxation against the differential equation that they solve."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.scene.motion import compose
from scenetruth.scene.motion.rigid_motions import Exponential
from tests.scene.moving import differences
from tests.scenes import cube

POINTS = np.array([[1.0, -2, 3], [4, 5, 600]])
ALONG = np.array([1.0, 2, 2]) / 3


def exponential(amplitude_mm: float, time_constant_frames: float) -> Exponential:
    return Exponential(
        kind="exponential",
        direction=(1, 2, 2),
        amplitude_mm=amplitude_mm,
        time_constant_frames=time_constant_frames,
    )


@settings(deadline=None)
@given(
    amplitude=some.floats(-20, 20),
    constant=some.floats(2, 50) | some.floats(-50, -2),
    t=some.floats(-8, 8),
)
def test_it_solves_its_differential_equation(amplitude: float, constant: float, t: float) -> None:
    moved = compose([exponential(amplitude, constant).point_map((0.0, 0.0, 0.0))], POINTS, t)
    distance = (moved.positions_mm - POINTS) @ ALONG
    # d' = (d + amplitude) / T and d'' = d' / T, with d(0) = 0; 600 mm are rounded to 1e-13.
    np.testing.assert_allclose(moved.velocities @ ALONG, (distance + amplitude) / constant, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(moved.accelerations, moved.velocities / constant, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(moved.positions_mm - POINTS, distance[:, None] * ALONG, atol=1e-12)


def test_known_distances() -> None:
    grown = exponential(3.0, 5.0).point_map((0.0, 0.0, 0.0))
    for frames, distance in ((0.0, 0.0), (5 * np.log(2), 3.0), (5.0, 3 * (math.e - 1))):
        found = compose([grown], POINTS, frames).positions_mm - POINTS
        np.testing.assert_allclose(found, np.tile(distance * ALONG, (2, 1)), atol=1e-12)
    relaxed = compose([exponential(3.0, -0.5).point_map((0.0, 0.0, 0.0))], POINTS, 40.0)
    np.testing.assert_allclose(relaxed.positions_mm - POINTS, np.tile(-3 * ALONG, (2, 1)), atol=1e-12)


def test_velocity_and_acceleration_against_differences() -> None:
    maps = [exponential(3.0, 4.0).point_map((0.0, 0.0, 0.0))]
    found = compose(maps, POINTS, 1.3)
    velocity, acceleration = differences(maps, POINTS, 1.3)
    np.testing.assert_allclose(found.velocities, velocity.astype(np.float64), rtol=1e-11)
    np.testing.assert_allclose(found.accelerations, acceleration.astype(np.float64), rtol=1e-8)


def test_objects_and_lights_of_a_scene_move_by_it() -> None:
    plain = cube().to_dict()
    motion = {"kind": "exponential", "direction": [0, 0, -1], "amplitude_mm": 2, "time_constant_frames": 10}
    plain["objects"][0]["motion"] = [motion]
    plain["lighting"]["lights"] = [
        {
            "kind": "point",
            "position_mm": [0, -80, 400],
            "irradiance": 1,
            "reference_distance_mm": 300,
            "motion": [motion],
        }
    ]
    scene = st.Scene.from_dict(plain)
    (lamp,) = scene.lighting.lamps_at(10.0)
    assert lamp.position_mm is not None
    np.testing.assert_allclose(lamp.position_mm, [0, -80, 400 - 2 * (math.e - 1)], rtol=1e-12)
    assert st.Scene.from_dict(scene.to_dict()) == scene


def test_a_time_constant_of_zero_is_refused() -> None:
    plain = cube().to_dict()
    plain["objects"][0]["motion"] = [
        {"kind": "exponential", "direction": [0, 0, 1], "amplitude_mm": 2, "time_constant_frames": 0}
    ]
    with pytest.raises(st.SceneError, match=r"objects\.0\.motion\.0\.time_constant_frames: must not be zero"):
        st.Scene.from_dict(plain)
