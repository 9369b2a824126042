"""Maps of points, their derivatives and their order; exponential growth against its differential equation."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene import motion
from scenetruth.scene.mesh import PlaneMesh
from scenetruth.scene.motion import ConstantRotation, ConstantVelocity, Exponential, Motion, compose
from scenetruth.scene.scene_object import Pose, SceneObject
from scenetruth.scene.texture import UniformTexture
from tests.helpers.moving_sheets import differences
from tests.helpers.scenes import cube

vectors = some.tuples(*[some.floats(-50, 50)] * 3)
axes = vectors.filter(lambda v: sum(x * x for x in v) > 1e-2)


def item(*motions: Motion) -> SceneObject:
    return SceneObject(
        name="thing",
        mesh=PlaneMesh(kind="plane", size_mm=(1, 1)),
        texture=UniformTexture(kind="uniform"),
        pose=Pose(position_mm=(1, 2, 600)),
        motion=motions,
    )


def motions_of(thing: SceneObject) -> list[motion.PointMap]:
    return [entry.point_map(thing.pose.position_mm) for entry in thing.motion]


def moved(
    maps: list[motion.PointMap], points: NDArray[np.float64], t: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    result = motion.compose(maps, points, t)
    return result.positions_mm, result.velocities


@given(velocity=vectors, t=some.floats(-10, 10))
def test_constant_velocity(velocity: tuple[float, float, float], t: float) -> None:
    motions = motions_of(item(ConstantVelocity(kind="velocity", velocity_mm_per_frame=velocity)))
    start = np.array([[1.0, -2, 3], [4, 5, 6]])
    points, speeds = moved(motions, start, t)
    np.testing.assert_allclose(points, start + t * np.asarray(velocity), rtol=1e-14, atol=1e-12)
    assert (speeds == velocity).all()


def turned(
    point: list[float], axis: tuple[float, float, float], centre: tuple[float, float, float], angle: Any
) -> list[Any]:
    """Rodrigues' formula in extended precision."""
    length = mpmath.sqrt(sum(mpmath.mpf(x) ** 2 for x in axis))
    n = [mpmath.mpf(x) / length for x in axis]
    p = [mpmath.mpf(x) - mpmath.mpf(c) for x, c in zip(point, centre, strict=True)]
    cross = [n[1] * p[2] - n[2] * p[1], n[2] * p[0] - n[0] * p[2], n[0] * p[1] - n[1] * p[0]]
    along = sum(a * b for a, b in zip(n, p, strict=True))
    cosine, sine = mpmath.cos(angle), mpmath.sin(angle)
    return [
        c + a * cosine + b * sine + k * along * (1 - cosine) for a, b, k, c in zip(p, cross, n, centre, strict=True)
    ]


@given(axis=axes, centre=vectors, rate=some.floats(-20, 20), velocity=vectors, t=some.floats(-5, 5))
def test_composed_motion_against_extended_precision(
    axis: tuple[float, float, float],
    centre: tuple[float, float, float],
    rate: float,
    velocity: tuple[float, float, float],
    t: float,
) -> None:
    motions = motions_of(
        item(
            ConstantVelocity(kind="velocity", velocity_mm_per_frame=velocity),
            ConstantRotation(kind="rotation", axis=axis, rate_deg_per_frame=rate, point_mm=centre),
        )
    )
    start = [3.0, -4.0, 5.0]
    point, speed = moved(motions, np.array([start]), t)

    with mpmath.workdps(50):

        def position(time: Any) -> list[Any]:
            moved = [mpmath.mpf(x) + mpmath.mpf(u) * time for x, u in zip(start, velocity, strict=True)]
            return turned(moved, axis, centre, mpmath.radians(rate) * time)

        step = mpmath.mpf(10) ** -15
        time = mpmath.mpf(t)
        expected = [float(value) for value in position(time)]
        ahead, behind = position(time + step), position(time - step)
        derivative = [float((a - b) / (2 * step)) for a, b in zip(ahead, behind, strict=True)]
    # Float64 rounding of coordinates of a few hundred millimetres.
    np.testing.assert_allclose(point[0], np.array(expected), atol=1e-11)
    np.testing.assert_allclose(speed[0], np.array(derivative), atol=1e-11)


def test_rotation_turns_about_the_objects_position_by_default() -> None:
    motions = motions_of(item(ConstantRotation(kind="rotation", axis=(0, 0, 1), rate_deg_per_frame=90)))
    points, speeds = moved(motions, np.array([[1.0, 2, 600], [2.0, 2, 600]]), 1)
    # About Z the X axis turns towards the Y axis.
    np.testing.assert_allclose(points, [[1, 2, 600], [1, 3, 600]], atol=1e-12)
    np.testing.assert_allclose(speeds, np.array([[0, 0, 0], [-np.pi / 2, 0, 0]]), atol=1e-12)


def test_pose_turns_in_the_given_order_then_moves() -> None:
    place = motion.pose_map((10, 0, 0), [((0, 0, 1), 90), ((1, 0, 0), 90)])
    found = motion.compose([place], np.array([[1.0, 0, 0]]), 0.0)
    np.testing.assert_allclose(found.positions_mm, np.array([[10, 0, 1]]), atol=1e-15)


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
