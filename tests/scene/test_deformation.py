"""Bending, growth and unrolling: lengths that stay, areas that grow as told, and rolls that never meet themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from pydantic import ValidationError

from scenetruth.scene.deformation import Bending, Growth, Hinge, Surroundings, Unrolling, roll_problem
from scenetruth.scene.motion import PointMap, compose
from tests.helpers.moving_sheets import HOUR, LENGTH, body, made, metric, positions, sheet, surface


def bend(**changes: Any) -> Bending:
    plain: dict[str, Any] = {"kind": "bending", "angle_deg": 50.0, "from_mm": 5.0, "length_mm": 20.0}
    return Bending.model_validate(plain | changes)


@settings(deadline=None, max_examples=60)
@given(angle=some.floats(-300, 300), start=some.floats(0, 30), length=some.floats(1, 40), across=some.booleans())
def test_bends_keep_the_metric(angle: float, start: float, length: float, across: bool) -> None:
    entry = bend(angle_deg=angle, from_mm=start, length_mm=length, across=across)
    a, b = np.random.default_rng(0).uniform([[0], [-12]], [[40], [12]], (2, 200))
    expected = np.broadcast_to([[1.0], [0], [1]], (3, 200))
    np.testing.assert_allclose(metric(surface([made(entry)], a, b, 0.0)), expected, atol=1e-12)


def test_the_bend_is_an_arc_to_the_upper_side_that_goes_on_straight() -> None:
    radius = 20 / np.deg2rad(50)
    x = np.array([0.0, 5, 15, 25, 35])
    angle = np.deg2rad([0, 0, 25, 50, 50])
    beyond = np.array([0.0, 0, 0, 0, 10])
    found = positions([made(bend())], np.stack([x, 3 + 0 * x, 0 * x], 1), 0.0)
    np.testing.assert_allclose(
        found[:, 0], np.minimum(x, 5) + radius * np.sin(angle) + beyond * np.cos(angle), atol=1e-13
    )
    np.testing.assert_allclose(found[:, 1], 3)
    np.testing.assert_allclose(found[:, 2], -radius * (1 - np.cos(angle)) - beyond * np.sin(angle), atol=1e-13)


def test_points_off_the_plane_keep_their_distance_when_bent() -> None:
    """Parallel curves: they lie off the bent plane by Z along its normal."""
    x = np.linspace(0, 40, 200)
    plane = positions([made(bend())], np.stack([x, 0 * x, 0 * x], 1), 0.0)
    for z in (-3.0, 2.0):
        off = positions([made(bend())], np.stack([x, 0 * x, z + 0 * x], 1), 0.0) - plane
        np.testing.assert_allclose(np.linalg.norm(off, axis=1), abs(z), rtol=1e-13)
        along = np.gradient(plane, x, axis=0)
        assert np.abs((off * along).sum(1)[2:-2]).max() < 0.05 * abs(z)


def test_across_is_symmetric_and_smooth_at_the_midrib() -> None:
    entry = bend(across=True, from_mm=0.0, length_mm=10.0, angle_deg=90.0)
    y = np.array([-12.0, -4, 0, 4, 12])
    found = positions([made(entry)], np.stack([0 * y, y, 0 * y], 1), 0.0)
    np.testing.assert_allclose(found[:, 1], -found[::-1, 1], atol=1e-14)
    np.testing.assert_allclose(found[:, 2], found[::-1, 2], atol=1e-14)
    radius = 20 / np.pi
    np.testing.assert_allclose(found[3, 1:], [radius * np.sin(4 / radius), radius * (np.cos(4 / radius) - 1)])
    fields = surface([made(entry)], np.zeros(3), np.array([-1e-9, 0.0, 1e-9]), 0.0)
    for field in fields:
        np.testing.assert_allclose(field.coefficients, field.coefficients[:, :1] + np.zeros(3), atol=2e-9)


def test_curvature_of_the_bend() -> None:
    start = sheet(39, 2)
    tensors = body(start, [made(bend())]).surface_at(0.0)
    x = start.material_mm[:, 0]
    curvature = tensors[:, [12, 13, 14]].sum(axis=1)
    inside = (x > 5) & (x < 25)
    # The normal X_a x X_b points to +Z, the lower side, where the bend bulges: negative.
    np.testing.assert_allclose(curvature[inside], -np.deg2rad(50) / 20, rtol=1e-12)
    np.testing.assert_allclose(curvature[~inside & (x != 5) & (x != 25)], 0, atol=1e-14)


def edges(columns: int, entry: Bending) -> float:
    """The largest relative change of the length of an edge, of a sheet with the given number of columns."""
    start = sheet(columns, 2, width=0.5)
    moved = body(start, [made(entry)]).at(0.0).positions_mm
    flat = np.concatenate([start.material_mm, np.zeros((len(moved), 1))], 1)
    one, other = start.faces, np.roll(start.faces, 1, axis=1)
    before, after = (np.linalg.norm(p[one] - p[other], axis=2) for p in (flat, moved))
    return float(np.abs(after / before - 1).max())


def test_chords_keep_their_length_within_a_millionth_on_a_fine_mesh() -> None:
    """An edge of h on a bend of curvature k is shortened by (h k)^2 / 24."""
    found = [edges(columns, bend()) for columns in (125, 250, 500)]
    print("\n| edge in mm | largest change of length |\n|---|---|")
    for columns, change in zip((125, 250, 500), found, strict=True):
        print(f"| {40 / columns:g} | {change:.2e} |")
        assert change == pytest.approx((40 / columns * np.deg2rad(50) / 20) ** 2 / 24, rel=1e-3)
    assert found[-1] <= 1e-6


GROWTH: dict[str, Any] = {"kind": "growth", "rate_per_hour": 0.03}
TRACE = [3, 4, 5]


def rate(entry: Growth, x: Any, hour: Any) -> Any:
    """The relative elemental growth rate in 1/h, as the model says it."""
    base, tip = entry.base_to_tip
    daily = 1 + entry.diel_amplitude * np.cos(2 * np.pi * (entry.start_h + hour - entry.peak_h) / 24)
    return entry.rate_per_hour * (base + (tip - base) * x / LENGTH) * daily


def grown(entry: Growth, x: float, hours: float) -> float:
    """That rate integrated from t = 0 by Gauss's rule with 40 points, exact for a cosine over some days."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    return float(weights @ rate(entry, x, hours / 2 * (1 + nodes)) * hours / 2)


@settings(deadline=None, max_examples=60)
@given(
    r=some.floats(-0.05, 0.05),
    gradient=some.tuples(some.floats(-2, 3), some.floats(-2, 3)),
    share=some.none() | some.floats(-1, 2),
    diel=some.floats(0, 1.5),
    hours=some.floats(-30, 30),
)
def test_areas_grow_by_the_given_rate(
    r: float, gradient: tuple[float, float], share: float | None, diel: float, hours: float
) -> None:
    entry = Growth(
        kind="growth", rate_per_hour=r, base_to_tip=gradient, along_share=share, diel_amplitude=diel, start_h=3
    )
    start = sheet(8, 6)
    a, b = np.ascontiguousarray(start.material_mm.T)
    fields = surface([made(entry)], a, b, hours)
    first, mixed, last = metric(fields)
    at_base, at_tip = grown(entry, 0.0, hours), grown(entry, LENGTH, hours)
    expected = at_base + (at_tip - at_base) * a / LENGTH
    np.testing.assert_allclose(0.5 * np.log(first * last - mixed * mixed), expected, atol=1e-11)
    tensors = body(start, [made(entry)]).surface_at(hours)
    np.testing.assert_allclose(tensors[:, TRACE].sum(axis=1), rate(entry, a, hours), atol=1e-13)
    if share is None:
        np.testing.assert_allclose(first, last, rtol=1e-10)
        np.testing.assert_allclose(mixed / first, 0, atol=1e-10)
        np.testing.assert_allclose(tensors[:, 3], tensors[:, 4], atol=1e-13)
    else:
        along = tensors[:, 3]
        midrib = b == 0
        np.testing.assert_allclose(along[midrib], share * rate(entry, a, hours)[midrib], atol=1e-13)


def test_nothing_has_grown_at_first_and_the_origin_stays() -> None:
    for share in (None, -1.0, 0.0, 0.3, 1.0, 2.0):
        entry = Growth(**GROWTH, base_to_tip=(1.5, 0.5), along_share=share, diel_amplitude=0.5)
        points = np.concatenate([sheet(5, 4).material_mm, np.ones((30, 1))], 1)
        np.testing.assert_allclose(positions([made(entry)], points, 0.0), points, atol=1e-14)
        moved = positions([made(entry)], np.array([[0.0, 0, 2]]), 12.0)
        np.testing.assert_allclose(moved, [[0, 0, 2]], atol=1e-14)


def test_rates_are_per_hour_at_any_frame_interval() -> None:
    entry, points = Growth(**GROWTH, diel_amplitude=0.4), np.array([[10.0, 5, 0]])
    minutes = positions([made(entry, Surroundings((0, LENGTH), 60.0))], points, 90.0)
    np.testing.assert_allclose(minutes, positions([made(entry, HOUR)], points, 1.5), rtol=1e-15)
    np.testing.assert_allclose(minutes, points * np.exp(0.5 * grown(entry, 0.0, 1.5)), rtol=1e-14)


def test_a_day_of_growth_has_the_mean_rate() -> None:
    entry = Growth(**GROWTH, diel_amplitude=0.9, start_h=17)
    moved = positions([made(entry)], np.array([[10.0, 0, 0]]), 24.0)
    assert moved[0, 0] == pytest.approx(10 * np.exp(0.5 * 0.03 * 24), rel=1e-14)
    rates = [body(sheet(1, 1), [made(entry)]).surface_at(t)[0, TRACE].sum() for t in np.arange(0, 24, 0.5)]
    # The peak is at 6 h, 13 h after 17 h.
    assert np.argmax(rates) == 26
    assert max(rates) == pytest.approx(0.03 * 1.9, rel=1e-12)


def test_own_ends_of_the_gradient() -> None:
    entry = Growth(**GROWTH, base_to_tip=(2.0, 0.0), base_mm=10, tip_mm=30)
    start = sheet(8, 2)
    found = body(start, [made(entry)]).surface_at(5.0)[:, TRACE].sum(axis=1)
    np.testing.assert_allclose(found, 0.03 * (2 - (start.material_mm[:, 0] - 10) / 10), atol=1e-14)


@given(nu=some.floats(0.0, 0.5), strain=some.floats(-0.3, 0.3), hours=some.floats(-3, 3))
def test_a_pulled_sheet_gets_narrower_by_its_poisson_ratio(nu: float, strain: float, hours: float) -> None:
    """Lengths along X become exp(ε h) times as long, those along Y exp(-ν ε h), whichever axis is pulled."""
    points = np.array([[10.0, -4, 0], [-3, 7, 0]])
    for along, across, share in ((1.0, -nu, 1 / (1 - nu)), (-nu, 1.0, -nu / (1 - nu))):
        entry = Growth(kind="growth", rate_per_hour=strain * (1 - nu), along_share=share)
        expected = points * np.exp(strain * hours * np.array([along, across, 0]))
        np.testing.assert_allclose(positions([made(entry)], points, hours), expected, rtol=1e-13)


def test_solids_grow_alike() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    moved = positions([made(Growth(**GROWTH, solid=True))], points, 10.0)
    np.testing.assert_allclose(moved, points * np.exp(0.15), rtol=1e-14)


def areas_and_changes(vertices: NDArray[Any], velocities: NDArray[Any], faces: NDArray[np.int32]) -> tuple[Any, Any]:
    """A and dA / dt of triangles, from their corners and the corners' velocities."""
    p, v = vertices[faces], velocities[faces]
    one, two = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = np.cross(one, two)
    change = np.cross(v[:, 1] - v[:, 0], two) + np.cross(one, v[:, 2] - v[:, 0])
    length = np.linalg.norm(normal, axis=1)
    return length / 2, (normal * change).sum(1) / (2 * length)


def growing_leaf() -> list[PointMap]:
    swing = {"kind": "harmonic", "amplitude": 60, "period_frames": 100}
    return [
        made(Growth(**GROWTH, base_to_tip=(1.5, 0.5), diel_amplitude=0.5)),
        made(Bending(kind="bending", angle_deg=swing, length_mm=200)),
        made(Hinge(kind="hinge", angle_deg=swing)),
    ]


def test_growth_rate_against_the_area_of_triangles() -> None:
    """The truth's rate against the change of the area of the mesh: second order in its size.

    Two triangles that are a cell of the sheet are taken together, for a single one sees the gradient of velocities at
    no point of its own, to first order only.
    """
    errors, t = [], 6.0
    print("\n| edge along X in mm | largest difference in a cell, relative | order | of the whole leaf |")
    print("|---|---|---|---|")
    for columns in (20, 40, 80, 160, 320):
        leaf = body(sheet(columns, columns * 3 // 5), growing_leaf())
        moved, trace = leaf.at(t), leaf.surface_at(t)[:, TRACE].sum(axis=1)
        areas, changes = areas_and_changes(moved.positions_mm, moved.velocities, leaf.faces)
        cells, rates = (values.reshape(2, -1).sum(axis=0) for values in (areas, changes))
        corners = trace[leaf.faces].reshape(2, -1, 3)
        # The corners of the first triangle, and the far one of the second.
        mean = (corners[0].sum(axis=1) + corners[1, :, 2]) / 4
        errors.append(float(np.abs(rates / cells - mean).max() / np.abs(trace).max()))
        order = np.log2(errors[-2] / errors[-1]) if len(errors) > 1 else np.nan
        whole = abs(rates.sum() / (mean * cells).sum() - 1)
        print(f"| {LENGTH / columns:g} | {errors[-1]:.2e} | {order:.2f} | {whole:.2e} |")
        assert len(errors) == 1 or 1.9 < order < 2.1
    assert errors[-1] <= 1e-6


def roll(**changes: Any) -> Unrolling:
    plain: dict[str, Any] = {"kind": "unrolling", "length_mm": 40, "front_mm": 10.0, "radius_mm": 4, "tightening": 0.05}
    return Unrolling.model_validate(plain | changes)


@some.composite
def rolls(draw: some.DrawFn) -> dict[str, Any]:
    """Rolls whose radius stays positive up to 40.01 mm; those of constant radius may be longer than a turn."""
    front, radius = draw(some.floats(-5, 45)), draw(some.floats(0.5, 10))
    tightest = min(0.5, 0.98 * radius / max(40.01 - front, 1.0))
    return {
        "front_mm": front,
        "radius_mm": radius,
        "tightening": draw(some.floats(1e-6, tightest) | some.just(0.0)),
        "side": draw(some.sampled_from(["upper", "lower"])),
    }


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
@given(values=rolls())
def test_rolls_keep_the_metric(values: dict[str, Any]) -> None:
    assume(not roll_problem(40.01 - values["front_mm"], values["radius_mm"], values["tightening"]))
    a, b = np.random.default_rng(0).uniform([[0], [-12]], [[40], [12]], (2, 200))
    found = metric(surface([made(roll(**values))], a, b, 0.0))
    # exp(-c θ) against 1 - c u / ρ0: the angle's rounding grows with the number of turns.
    np.testing.assert_allclose(found, np.broadcast_to([[1.0], [0], [1]], (3, 200)), atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(values=rolls())
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


def test_points_off_the_plane_keep_their_distance_when_unrolled() -> None:
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
