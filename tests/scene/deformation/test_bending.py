"""Bending: lengths on the sheet stay as they are, and the bend is an arc."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from scenetruth.scene.deformation import Bending
from tests.scene.moving import body, made, metric, positions, sheet, surface


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


def test_points_off_the_plane_keep_their_distance() -> None:
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
