"""No ray slips between triangles; the projection in which faces are sorted to rays."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

from scenetruth.raycast import RayCaster, Topology
from scenetruth.raycast import ray_caster as caster_module
from scenetruth.raycast.ray_triangle_kernels import (
    DISTANCE,
    FORMS,
    blurs,
    components,
    edge_functions,
    inside,
    rounding,
    slope,
    weigh,
    write_forms,
)


@pytest.mark.parametrize("path", ["faces", "tiles", "cells", "embree"])
@pytest.mark.parametrize("spacing_px", [1, 2.5, 5])
def test_rays_through_all_corners_of_a_lattice_meet_it(
    path: str, spacing_px: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(caster_module, "_MOST_TILED", 10**9 if path == "tiles" else 0)
    monkeypatch.setattr(caster_module, "_MOST_RASTERED", 0 if path == "embree" else 10**9)
    if path != "faces":
        monkeypatch.setattr(RayCaster, "_cover", lambda *_: None)
    width, height, focal = 120, 90, 3000.0
    step = spacing_px * 600 / focal
    columns, rows = int(width / spacing_px) + 4, int(height / spacing_px) + 4
    i, j = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    x, y = (i - columns // 2) * step, (j - rows // 2) * step
    vertices = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 600.0)])
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    quads = np.stack([corner, corner + 1, corner + columns + 2, corner + columns + 1], axis=1)
    faces = np.concatenate([quads[:, [0, 2, 1]], quads[:, [0, 3, 2]]]).astype(np.int32)
    v, u = np.mgrid[:height, :width]
    rays = np.stack([(u - width // 2) / focal, (v - height // 2) / focal, np.ones(u.shape)], axis=-1).reshape(-1, 3)
    caster = RayCaster(vertices, Topology.of(vertices, faces))
    hits = caster.cast(np.zeros(3), rays, grid_width=width)
    assert (hits.face >= 0).all()
    np.testing.assert_allclose(hits.depth, 600, rtol=1e-13)
    assert hits.weights.min() >= -1e-9
    assert hits.weights.sum(axis=1).max() <= 1 + 1e-9


coordinate = some.floats(-700, 700)


@settings(deadline=None)
@given(
    points=some.lists(coordinate, min_size=9, max_size=9), way=some.lists(some.floats(-2, 2), min_size=3, max_size=3)
)
def test_edge_functions_are_rounded_by_no_more_than_the_bound(points: list[float], way: list[float]) -> None:
    a, b, c = np.array(points).reshape(3, 3)
    for p, q in ((a, b), (b, c), (c, a)):
        n = (p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])
        rounded = way[0] * n[0] + way[1] * n[1] + way[2] * n[2]
        e, f, d = ([Fraction(float(value)) for value in item] for item in (p, q, way))
        exact = (
            d[0] * (e[1] * f[2] - e[2] * f[1]) + d[1] * (e[2] * f[0] - e[0] * f[2]) + d[2] * (e[0] * f[1] - e[1] * f[0])
        )
        blur = sum(abs(component) * size for component, size in zip(way, blurs(*a, *b, *c), strict=True))
        # 1e-300: products of tiny numbers vanish.
        assert abs(Fraction(float(rounded)) - exact) <= Fraction(float(blur)) + Fraction(1e-300)


def test_rule_at_edges() -> None:
    assert inside(1.0, 2.0, 0.0, 0.0)
    assert inside(-1.0, -2.0, 0.0, 0.0)
    assert inside(1.0, 2.0, -1e-9, 1e-9)
    assert inside(-1.0, -2.0, 1e-9, 1e-9)
    assert not inside(1.0, 2.0, -1.1e-9, 1e-9)
    assert not inside(0.0, 0.0, 0.0, 1e-9)
    # Seen edge-on nothing is added.
    assert not inside(1e-8, 1e-8, -1e-9, 1e-9)
    assert inside(1e-8, 1e-8, 0.0, 1e-9)


def test_the_forms_of_a_face_give_edge_functions_depth_and_weights() -> None:
    corners = np.array([[1.0, 2.0, 30.0], [9.0, 1.0, 35.0], [3.0, 8.0, 31.0]])
    origin = np.array([0.5, -1.0, 2.0])
    point = 0.2 * corners[0] + 0.3 * corners[1] + 0.5 * corners[2]
    direction = (point - origin) / 4
    form = np.empty(FORMS)
    write_forms(corners, np.array([[0, 1, 2]], dtype=np.int32), 0, origin, form)
    a, b, c = corners - origin
    volumes = [np.linalg.det([direction, p, q]) for p, q in ((b, c), (c, a), (a, b))]
    np.testing.assert_allclose(edge_functions(form, *direction), volumes, rtol=1e-12)
    np.testing.assert_allclose(weigh(form, *direction), [0.3, 0.5], rtol=1e-12)
    assert form[DISTANCE] / slope(form, *direction) == pytest.approx(4, rel=1e-12)
    bound = rounding(form, *direction)
    assert bound == pytest.approx(np.abs(direction) @ blurs(*a, *b, *c), rel=1e-15)
    assert inside(*edge_functions(form, *direction), bound)


def test_components_are_those_along_the_rows_of_the_frame() -> None:
    frame = np.asarray(Rotation.from_rotvec([0.3, -0.7, 0.2]).as_matrix())
    vector = np.array([2.0, -5.0, 11.0])
    np.testing.assert_allclose(components(*vector, frame), frame @ vector, rtol=1e-14)
