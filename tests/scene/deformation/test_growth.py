"""Growth: areas grow by exactly the given rate, and the truth's tensors say so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.scene.deformation import Bending, Growth, Hinge, Surroundings
from scenetruth.scene.motion import PointMap
from tests.scene.moving import HOUR, LENGTH, body, made, metric, positions, sheet, surface

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
