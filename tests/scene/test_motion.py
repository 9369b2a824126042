"""Every kind of motion and deformation: its velocity and acceleration against differences of its own positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as some
from pydantic import TypeAdapter
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from scenetruth.scene.deformation import Deformation
from scenetruth.scene.motion import Motion, compose, rotate_points
from scenetruth.scene.reference_configuration import SheetConfiguration
from scenetruth.scene.taylor import Jet
from tests.helpers.moving_sheets import body, differences, made, positions, sheet, surface


def swing(amplitude: float, mean: float = 0.0) -> dict[str, Any]:
    return {"kind": "harmonic", "mean": mean, "amplitude": amplitude, "period_frames": 17, "phase_deg": 30}


KEYS = {"times_frames": [-4, -1, 0.5, 2, 5]}
TURN_KEYS = [-3, 0, 1, 4]
PLACES = [[0, 0, 0], [1, 2, 1], [3, 1, 1], [0, 0, 1], [4, 4, 4]]
TURNS = [[0, 0, 0], [1, 20, 1], [3, 1, 1], [0, 0, 1], [40, 4, 4]]
ROLL = {"kind": "unrolling", "length_mm": 60, "radius_mm": 4}
ENTRIES: dict[str, dict[str, Any]] = {
    "velocity": {"kind": "velocity", "velocity_mm_per_frame": [1, -2, 0.5]},
    "rotation": {"kind": "rotation", "axis": [1, 2, 2], "rate_deg_per_frame": 7},
    "acceleration": {
        "kind": "acceleration",
        "velocity_mm_per_frame": [1, 2, 3],
        "acceleration_mm_per_frame2": [0.1, -0.2, 0.3],
    },
    "shift": {"kind": "shift", "direction": [1, 2, 2], "distance_mm": swing(3)},
    "turn": {"kind": "turn", "axis": [1, 2, 2], "angle_deg": swing(30)},
    "turn by keyframes": {
        "kind": "turn",
        "axis": [0, 1, 2],
        "angle_deg": {"kind": "keyframes", "times_frames": TURN_KEYS, "values": [0, 5, 20, 8]},
    },
    "nutation": {
        "kind": "nutation",
        "direction": [0, 0, -1],
        "towards": [1, 0, 1],
        "amplitudes_deg": [10, 5],
        "period_frames": 9,
    },
    "keyframes": {"kind": "keyframes", **KEYS, "positions_mm": PLACES, "rotations_deg": TURNS},
    "hinge": {"kind": "hinge", "angle_deg": swing(20)},
    "growth": {"kind": "growth", "rate_per_hour": 0.03, "base_to_tip": [1.5, 0.5], "diel_amplitude": 0.5},
    "growth alike": {"kind": "growth", "rate_per_hour": 0.03, "diel_amplitude": 0.5},
    "growth along": {
        "kind": "growth",
        "rate_per_hour": 0.03,
        "base_to_tip": [1.5, 0.5],
        "along_share": 0.7,
        "diel_amplitude": 0.5,
    },
    "growth of a solid": {"kind": "growth", "rate_per_hour": 0.03, "solid": True},
    "bending": {"kind": "bending", "angle_deg": swing(40), "from_mm": 5, "length_mm": 30},
    "bending across": {"kind": "bending", "angle_deg": swing(40), "from_mm": 2, "length_mm": 7, "across": True},
    "unrolling": {**ROLL, "front_mm": {"kind": "linear", "start": 15, "rate_per_frame": 0.7}, "tightening": 0.05},
    "unrolling, a circle": {**ROLL, "radius_mm": 8, "front_mm": swing(2, 25), "tightening": 0, "side": "lower"},
    "star": {"kind": "star", "amplitude_mm": swing(0.5), "period_mm": [5, 30]},
    "star of strain": {"kind": "star_strain", "strain": swing(0.1), "period_mm": [5, 30]},
}
MOTIONS: TypeAdapter[Any] = TypeAdapter(Motion | Deformation)


def entry(name: str, **changes: Any) -> Any:
    return MOTIONS.validate_python({**ENTRIES[name], **changes})


def cloud(count: int = 60, seed: int = 0) -> Any:
    """Points of a leaf that is not quite flat."""
    return np.random.default_rng(seed).uniform([0, -12, -1], [40, 12, 1], (count, 3))


def relative(found: Any, expected: Any) -> float:
    # Rates of 1e-3 mm per frame on coordinates of 40 mm: rounding is 1e-11 of them.
    return float(np.abs(found - expected).max() / max(float(np.abs(expected).max()), 1e-3))


@pytest.mark.parametrize("name", list(ENTRIES))
@pytest.mark.parametrize("t", [-2.3, 0.0, 1.3])
def test_velocity_and_acceleration_against_differences(name: str, t: float) -> None:
    maps = [made(entry(name))]
    points = cloud()
    velocity, acceleration = differences(maps, points, t)
    found = compose(maps, points, t)
    np.testing.assert_allclose(found.positions_mm, positions(maps, points, t), rtol=0, atol=1e-13)
    one, two = relative(found.velocities, velocity), relative(found.accelerations, acceleration)
    print(f"| {name} | {t:g} | {one:.1e} | {two:.1e} |")
    assert one <= 1e-11
    assert two <= 1e-8


@pytest.mark.parametrize("name", list(ENTRIES))
def test_jets_in_three_variables_agree(name: str) -> None:
    """Their time derivatives are those of one variable, their derivatives along the surface are differences."""
    maps = [made(entry(name))]
    t, points = 1.3, cloud()
    points[:, 2] = 0
    fields = surface(maps, points[:, 0].copy(), points[:, 1].copy(), t)
    found = compose(maps, points, t)
    for column, field in enumerate(fields):
        np.testing.assert_allclose(field.value, found.positions_mm[:, column], rtol=0, atol=1e-13)
        np.testing.assert_allclose(field.first(0), found.velocities[:, column], rtol=0, atol=1e-13)
        np.testing.assert_allclose(field.second(0, 0), found.accelerations[:, column], rtol=0, atol=1e-13)
    step = np.longdouble(2.0**-12)
    for index in (1, 2):
        aside = np.zeros(3, dtype=np.longdouble)
        aside[index - 1] = step
        ahead, behind = (positions(maps, points.astype(np.longdouble) + sign * aside, t) for sign in (1, -1))
        fast, slow = (compose(maps, (points + sign * aside).astype(np.float64), t) for sign in (1, -1))
        here = positions(maps, points.astype(np.longdouble), t)
        for column, field in enumerate(fields):
            slope = (ahead - behind)[:, column] / (2 * step)
            bend = (ahead - 2 * here + behind)[:, column] / step**2
            rate = (fast.velocities - slow.velocities)[:, column] / (2 * step)
            # step^2 / 6 = 1e-8 of the next derivatives, which are below 3 for the star's shortest period.
            np.testing.assert_allclose(field.first(index), slope.astype(np.float64), rtol=0, atol=5e-8)
            np.testing.assert_allclose(field.second(index, index), bend.astype(np.float64), rtol=0, atol=5e-8)
            np.testing.assert_allclose(field.second(0, index), rate.astype(np.float64), rtol=0, atol=5e-8)


KEYFRAMES: dict[str, Sequence[float]] = {"keyframes": KEYS["times_frames"], "turn by keyframes": TURN_KEYS}
# Where bends and rolls begin there is one derivative in time only, for points that pass there.
SMOOTH = [name for name in ENTRIES if ENTRIES[name]["kind"] not in ("bending", "unrolling")]


@settings(deadline=None, max_examples=40)
@given(names=some.lists(some.sampled_from(SMOOTH), min_size=2, max_size=4), t=some.floats(-3, 3))
# A point crosses the shortest periods of the star at 9 mm per frame.
@example(names=["rotation", "turn", "turn by keyframes", "star"], t=2.0)
def test_composed_motions(names: list[str], t: float) -> None:
    # At keyframes the third derivative jumps; differences use times up to 2^-9 frames away.
    assume(all(abs(t - key) > 0.02 for name in names for key in KEYFRAMES.get(name, [])))
    maps = [made(entry(name)) for name in names]
    points = cloud(20)
    # Rounding of accelerations is 1e-19 · 40 mm / 2^-26 = 3e-10 mm per frame²: 3e-7 of the least of `relative`.
    coarse, fine = (differences(maps, points, t, exponent) for exponent in (9, 11))
    # Differences do not converge where motions carry points to waves of the star far below its stated periods.
    assume(relative(coarse[0], fine[0]) < 1e-6)
    found = compose(maps, points, t)
    assert relative(found.velocities, fine[0]) <= 1e-8
    assert relative(found.accelerations, fine[1]) <= 1e-6


def test_a_leaf_of_all_parts_moves_consistently() -> None:
    """Growth in the flat, a curved shape, a bend, a hinge, and a plant that nutates while it is carried."""

    def shape(points: Any, t: Any) -> Any:
        x, y, z = points
        return x, y, z - 0.02 * y * y + 0.5 * np.sin(0.2 * x) + 0 * t

    names = ["growth", "bending", "hinge", "nutation", "keyframes", "turn"]
    growth, *rest = (made(entry(name)) for name in names)
    start = sheet(23, 14)
    leaf = body(start, [growth, shape, *rest])
    velocity, acceleration = differences(
        leaf.maps, np.concatenate([start.material_mm, 0 * start.material_mm[:, :1]], 1), 0.7
    )
    found = leaf.at(0.7)
    assert relative(found.velocities, velocity) <= 1e-12
    assert relative(found.accelerations, acceleration) <= 1e-9
    tensors = leaf.surface_at(0.7)
    assert tensors.shape == (len(start.material_mm), 18)
    assert np.isfinite(tensors).all()


def test_many_points_are_moved_as_few_of_them() -> None:
    """20,301 points are moved in blocks, 1,000 at once."""
    start = sheet(200, 100)
    maps = [made(entry(name)) for name in ("growth", "bending", "nutation")]
    leaf = body(start, maps)
    blocks, tensors = leaf.at(0.7), leaf.surface_at(0.7)
    for first in range(0, len(start.material_mm), 1000):
        part = slice(first, first + 1000)
        few = body(SheetConfiguration(start.material_mm[part], np.array([[0, 1, 2]], dtype=np.int32)), maps)
        np.testing.assert_array_equal(blocks.accelerations[part], few.at(0.7).accelerations)
        np.testing.assert_array_equal(blocks.positions_mm[part], few.at(0.7).positions_mm)
        np.testing.assert_array_equal(tensors[part], few.surface_at(0.7))
    at_rest = body(start, [])
    np.testing.assert_array_equal(at_rest.at(3.0).positions_mm[:, :2], start.material_mm)


def test_rates_with_the_vertices_are_those_of_the_surface_alone() -> None:
    start = sheet(200, 100)
    leaf = body(start, [made(entry(name)) for name in ("growth", "bending", "nutation", "turn")])
    moved, rates = leaf.at_with_rates(0.7)
    np.testing.assert_array_equal(moved.positions_mm, leaf.at(0.7).positions_mm)
    np.testing.assert_array_equal(moved.velocities, leaf.at(0.7).velocities)
    np.testing.assert_array_equal(moved.accelerations, leaf.at(0.7).accelerations)
    np.testing.assert_array_equal(rates, leaf.surface_at(0.7)[:, 3:6])
    assert np.abs(rates).max() > 0


@pytest.mark.parametrize("variables", [1, 3])
def test_jets_turned_by_a_constant_angle_have_the_bits_of_the_formula(variables: int) -> None:
    generator = np.random.default_rng(variables)
    rows = 1 + variables + variables * (variables + 1) // 2
    x, y, z = (Jet(generator.normal(size=(rows, 50)) * (generator.random((rows, 50)) < 0.8)) for _ in range(3))
    axis, angle, centre = (1.0, -2.0, 0.5), np.deg2rad(37.0), (3.0, 0.0, -1.0)
    found = rotate_points((x, y, z), axis, angle, centre)
    (nx, ny, nz), (a, b, c) = np.asarray(axis) / np.linalg.norm(axis), (x - 3.0, y - 0.0, z - -1.0)
    along = (nx * a + ny * b + nz * c) * (1 - np.cos(angle))
    expected = (
        a * np.cos(angle) + (ny * c - nz * b) * np.sin(angle) + nx * along + 3.0,
        b * np.cos(angle) + (nz * a - nx * c) * np.sin(angle) + ny * along + 0.0,
        c * np.cos(angle) + (nx * b - ny * a) * np.sin(angle) + nz * along + -1.0,
    )
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.coefficients, other.coefficients)
        np.testing.assert_array_equal(np.signbit(one.coefficients), np.signbit(other.coefficients))
    turn = Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis))
    rigid = turn.apply(np.stack([x.value, y.value, z.value], axis=1) - centre) + centre
    np.testing.assert_allclose(np.stack([field.value for field in found], axis=1), rigid, atol=1e-14)


def test_steady_acceleration() -> None:
    moved = compose([made(entry("acceleration"))], np.zeros((1, 3)), 2.0)
    np.testing.assert_allclose(moved.positions_mm, np.array([[2.2, 3.6, 6.6]]), rtol=1e-15)
    np.testing.assert_allclose(moved.velocities, np.array([[1.2, 1.6, 3.6]]), rtol=1e-15)
    np.testing.assert_allclose(moved.accelerations, np.array([[0.1, -0.2, 0.3]]), rtol=1e-15)


def test_sway_and_oscillation_return_after_a_period() -> None:
    points = cloud()
    for name in ("turn", "shift"):
        maps = [made(entry(name))]
        np.testing.assert_allclose(positions(maps, points, 0.4), positions(maps, points, 17.4), atol=1e-12)
    far = positions([made(entry("shift", distance_mm=6.0))], points, 0.0) - points
    np.testing.assert_allclose(far, np.broadcast_to([2.0, 4, 4], far.shape), atol=1e-12)


@given(t=some.floats(-20, 20))
def test_nutation_goes_round(t: float) -> None:
    """An upright organ's direction is turned by the rotation vector of the formula, here by scipy's rotations."""
    nutation = entry("nutation", direction=[0, 0, -2], towards=[1, 0, 1], point_mm=[0, 0, 0], phase_deg=20)
    found = positions([made(nutation)], np.array([[0, 0, -1.0], [0.3, 0.2, 0.1]]), t)
    phase = 2 * np.pi * t / 9 + np.deg2rad(20)
    # d = -Z, e = X, f = d x e = -Y: d x e = -Y and d x f = -X.
    vector = np.deg2rad([10, 5]) * [np.cos(phase), np.sin(phase)]
    turned = Rotation.from_rotvec([-vector[1], -vector[0], 0])
    np.testing.assert_allclose(found, turned.apply([[0, 0, -1.0], [0.3, 0.2, 0.1]]), atol=1e-13)


def test_nutation_begins_in_the_given_direction_and_goes_round_by_the_right_hand_rule() -> None:
    tip = np.array([[0.0, 0, -50]])
    nutation = entry("nutation", point_mm=[0, 0, 0])
    first, quarter = (positions([made(nutation)], tip, t)[0] for t in (0.0, 9 / 4))
    np.testing.assert_allclose(first[:2], [50 * np.sin(np.deg2rad(10)), 0], atol=1e-12)
    # About -Z, from X the right hand goes to -Y.
    np.testing.assert_allclose(quarter[:2], [0, -50 * np.sin(np.deg2rad(5))], atol=1e-12)


def test_keyframes_are_met_and_join_smoothly() -> None:
    points, maps = cloud(), [made(entry("keyframes", point_mm=[1, 2, 3]))]
    for time, place, vector in zip(KEYS["times_frames"], PLACES, TURNS, strict=True):
        turned = Rotation.from_rotvec(vector, degrees=True).apply(points - [1, 2, 3]) + [1, 2, 3] + place
        np.testing.assert_allclose(positions(maps, points, time), turned, atol=1e-12)
    for time in (-1, 0.5, 2):
        before, after = (compose(maps, points, time + side) for side in (-1e-9, 1e-9))
        np.testing.assert_allclose(before.velocities, after.velocities, atol=1e-6)
        np.testing.assert_allclose(before.accelerations, after.accelerations, atol=1e-6)
    only = compose([made(entry("keyframes", rotations_deg=None))], points, 1.1)
    spline = CubicSpline(KEYS["times_frames"], PLACES)
    np.testing.assert_allclose(only.positions_mm, points + spline(1.1), atol=1e-12)
    np.testing.assert_allclose(only.velocities, np.broadcast_to(spline(1.1, 1), points.shape), atol=1e-12)


def test_the_star_has_the_stated_periods() -> None:
    star = made(entry("star", amplitude_mm=0.5, period_mm=[4, 24]))
    y = np.linspace(-12, 12, 49)
    for x, period in ((0.0, 4.0), (40.0, 24.0), (20.0, 14.0)):
        found = positions([star], np.stack([np.full_like(y, x), y, 0 * y], 1), 0.0)
        np.testing.assert_allclose(found[:, 1] - y, 0.5 * np.cos(2 * np.pi * y / period), atol=1e-14)
        np.testing.assert_allclose(found[:, [0, 2]], np.stack([np.full_like(y, x), 0 * y], 1), atol=0)


def test_the_star_of_strain_has_the_same_strain_at_every_period() -> None:
    star = made(entry("star of strain", strain=0.05, period_mm=[4, 24]))
    y, step = np.linspace(-12, 12, 49), 1e-4
    for x, period in ((0.0, 4.0), (40.0, 24.0), (20.0, 14.0)):
        at = [positions([star], np.stack([np.full_like(y, x), y + off, 0 * y], 1), 0.0) for off in (-step, step)]
        strain = (at[1][:, 1] - at[0][:, 1]) / (2 * step) - 1
        # The third derivative of the displacement times a sixth of the square of the step: 2e-10; rounding: 1e-11.
        np.testing.assert_allclose(strain, 0.05 * np.cos(2 * np.pi * y / period), atol=1e-9)
        np.testing.assert_allclose(at[0][:, [0, 2]], np.stack([np.full_like(y, x), 0 * y], 1), atol=0)


def test_sheets_face_the_upper_side() -> None:
    start = sheet(3, 2)
    assert isinstance(start, SheetConfiguration)
    corners = np.concatenate([start.material_mm, 0 * start.material_mm[:, :1]], 1)[start.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()
