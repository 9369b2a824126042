from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.scene import motion
from scenetruth.scene.mesh.sheets import PlaneMesh
from scenetruth.scene.motion.rigid_motions import ConstantRotation, ConstantVelocity, Motion
from scenetruth.scene.scene_object import Pose, SceneObject
from scenetruth.scene.texture.procedural_textures import UniformTexture

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
