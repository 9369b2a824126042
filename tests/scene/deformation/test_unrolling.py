"""Unrolling: lengths stay, the front is smooth, and the roll never meets itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from pydantic import ValidationError

from scenetruth.scene.deformation import Unrolling, roll_problem
from scenetruth.scene.motion import compose
from tests.scene.moving import body, made, metric, positions, sheet, surface


def roll(**changes: Any) -> Unrolling:
    plain: dict[str, Any] = {"kind": "unrolling", "length_mm": 40, "front_mm": 10.0, "radius_mm": 4, "tightening": 0.05}
    return Unrolling.model_validate(plain | changes)


rolls = some.fixed_dictionaries(
    {
        "front_mm": some.floats(-5, 45),
        "radius_mm": some.floats(0.5, 10),
        "tightening": some.floats(1e-6, 0.5) | some.just(0.0),
        "side": some.sampled_from(["upper", "lower"]),
    }
)


def profile(entry: Unrolling, count: int) -> NDArray[np.float64]:
    """The sheet from the side, (X, Z), at the time 0."""
    x = np.linspace(-40, 40, count)
    return positions([made(entry)], np.stack([x, 0 * x, 0 * x], 1), 0.0)[:, [0, 2]]


def crossings(line: NDArray[np.float64]) -> int:
    """Pairs of a line's segments that are no neighbours and cross, each against each."""

    def side(p: Any, q: Any, r: Any) -> Any:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    a, b, c, d = line[:-1, None], line[1:, None], line[None, :-1], line[None, 1:]
    crossed = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    n = np.arange(len(line) - 1)
    return int((crossed & (np.abs(n[:, None] - n) > 1)).sum())


@settings(deadline=None, max_examples=50)
@given(values=rolls)
def test_rolls_keep_the_metric(values: dict[str, Any]) -> None:
    assume(not roll_problem(40.01 - values["front_mm"], values["radius_mm"], values["tightening"]))
    a, b = np.random.default_rng(0).uniform([[0], [-12]], [[40], [12]], (2, 200))
    found = metric(surface([made(roll(**values))], a, b, 0.0))
    # exp(-c θ) against 1 - c u / ρ0: the angle's rounding grows with the number of turns.
    np.testing.assert_allclose(found, np.broadcast_to([[1.0], [0], [1]], (3, 200)), atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(values=rolls)
def test_rolls_never_cross_themselves(values: dict[str, Any]) -> None:
    rolled = 40 - values["front_mm"]
    assume(rolled > 0)
    assume(not roll_problem(rolled * 1.01, values["radius_mm"], values["tightening"]))
    # Where turns are closer than chords of 0.1 mm stand off their arcs, it is the chords that cross.
    inner = values["radius_mm"] - values["tightening"] * rolled
    assume(inner > 0.2)
    assume(rolled < 2 * np.pi * inner or inner * np.expm1(2 * np.pi * values["tightening"]) > 0.1**2 / inner)
    assert crossings(profile(roll(**values), 801)) == 0


def test_a_circle_that_closes_would_cross_itself() -> None:
    open_circle = roll(front_mm=40 - 0.99 * 2 * np.pi * 4, tightening=0)
    assert crossings(profile(open_circle, 801)) == 0
    line = positions([made(open_circle)], np.stack([x := np.linspace(0, 45, 801), 0 * x, 0 * x], 1), 0.0)[:, [0, 2]]
    assert crossings(line) > 0


@pytest.mark.parametrize("side", ["upper", "lower"])
def test_the_roll_is_the_integral_of_its_angle(side: str) -> None:
    """Against sums of cos θ and sin θ, with θ the integral of the curvature 1 / (ρ0 - c u)."""
    x = np.linspace(10, 40, 300001)
    middle = 0.5 * (x[1:] + x[:-1]) - 10
    angle = np.log(4 / (4 - 0.05 * middle)) / 0.05
    step = x[1] - x[0]
    found = positions([made(roll(side=side))], np.stack([x, 0 * x, 0 * x], 1), 0.0)
    sign = -1 if side == "upper" else 1
    np.testing.assert_allclose(found[-1, 0], 10 + np.cos(angle).sum() * step, atol=1e-8)
    np.testing.assert_allclose(found[-1, 2], sign * np.sin(angle).sum() * step, atol=1e-8)
    assert (sign * found[1:, 2] > 0).all()


def test_points_off_the_plane_keep_their_distance() -> None:
    x = np.linspace(0, 40, 100)
    for side in ("upper", "lower"):
        plane, off = (positions([made(roll(side=side))], np.stack([x, 0 * x, z + 0 * x], 1), 0.0) for z in (0.0, 0.3))
        np.testing.assert_allclose(np.linalg.norm(off - plane, axis=1), 0.3, rtol=1e-12)
        np.testing.assert_allclose((off - plane)[x < 10], np.broadcast_to([0, 0, 0.3], off[x < 10].shape), atol=1e-14)


def test_positions_and_velocities_join_at_the_front() -> None:
    entry = roll(front_mm={"kind": "linear", "start": 10, "rate_per_frame": 2})
    beside = np.array([[12 - 1e-9, 3, 0], [12 + 1e-9, 3, 0]])
    found = compose([made(entry)], beside, 1.0)
    np.testing.assert_allclose(found.positions_mm[0], found.positions_mm[1], atol=3e-9)
    np.testing.assert_allclose(found.velocities, 0, atol=1e-8)


def test_what_has_passed_the_front_lies_flat() -> None:
    entry = roll(front_mm={"kind": "linear", "start": 10, "rate_per_frame": 2})
    points = np.concatenate([sheet(40, 4).material_mm, np.zeros((205, 1))], 1)
    np.testing.assert_allclose(positions([made(entry)], points, 15.0), points, atol=1e-14)


def test_edges_keep_their_length_within_a_millionth_on_a_fine_mesh() -> None:
    """An edge of h at the radius r is shortened by (h / r)^2 / 24; the tightest radius is 2.5 mm."""
    print("\n| edge in mm | largest change of length |\n|---|---|")
    for columns in (1000, 2000, 4000):
        start = sheet(columns, 1, width=0.5)
        moved = body(start, [made(roll())]).at(0.0).positions_mm
        flat = np.concatenate([start.material_mm, np.zeros((len(moved), 1))], 1)
        one, other = start.faces, np.roll(start.faces, 1, axis=1)
        before, after = (np.linalg.norm(p[one] - p[other], axis=2) for p in (flat, moved))
        change = float(np.abs(after / before - 1).max())
        print(f"| {40 / columns:g} | {change:.2e} |")
        assert change == pytest.approx((40 / columns / 2.5) ** 2 / 24, rel=0.02)
    assert change <= 1e-6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tightening": 0.2}, "self-intersecting unrolling: the radius falls to zero within 20 mm, but 30 mm are"),
        ({"tightening": 0, "front_mm": 10}, "self-intersecting unrolling: 30 mm exceed 25.1327 mm, one turn"),
        ({"tightening": 1.0}, "less than 1"),
        ({"radius_mm": -1}, "greater than 0"),
    ],
)
def test_rolls_that_cannot_be(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        roll(**changes)
