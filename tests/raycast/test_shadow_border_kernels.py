"""Borders of shadows on faces, against the shadows of random points."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.raycast import ShadowCaster, Topology
from scenetruth.raycast.shadow_border_kernels import measure_faces
from scenetruth.raycast.shadow_kernels import BLOCKED, LIT, UNSURE

TO_LIGHT = np.array([0.36, -0.48, 0.8])
EDGE_ON = 1e-3  # tangent of the angle between face and light below which the light counts as parallel to the face


def soup(seed: int, count: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return random triangles, many of which intersect."""
    generator = np.random.default_rng(seed)
    middles = generator.uniform(-30, 30, (count, 1, 3))
    vertices = (middles + generator.uniform(-15, 15, (count, 3, 3))).reshape(-1, 3)
    return vertices, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


@settings(max_examples=8, deadline=None)
@given(seed=some.integers(0, 10_000), count=some.integers(2, 40))
def test_faces_are_decided_and_cut_where_the_shadow_changes(seed: int, count: int) -> None:
    vertices, faces = soup(seed, count)
    caster = ShadowCaster(vertices, Topology.of(vertices, faces))
    found = caster.on_faces(TO_LIGHT)
    generator = np.random.default_rng(seed + 1)
    own = generator.integers(0, count, 300).astype(np.int32)
    points = np.einsum("nk,nkc->nc", generator.dirichlet([1, 1, 1], len(own)), vertices[faces[own]])
    blocked = caster.blocked_parallel(points, own, np.ones(len(own), dtype=np.bool_), TO_LIGHT, confirmed=False)
    sure = found.state[own] != UNSURE
    np.testing.assert_array_equal(blocked[sure], found.state[own][sure] == BLOCKED)
    # Between points of one face of which one is blocked, a border crosses their connection.
    first = np.array([np.flatnonzero(own == face)[0] for face in own])
    for one, other in zip(first, range(len(own)), strict=True):
        if blocked[one] == blocked[other]:
            continue
        face = own[other]
        starts, ends = found.starts_mm[found.face == face], found.ends_mm[found.face == face]
        normal = np.cross(*(vertices[faces[face, 1:]] - vertices[faces[face, 0]]))
        if abs(normal @ TO_LIGHT) < 1.001 * EDGE_ON * np.linalg.norm(np.cross(normal, TO_LIGHT)):
            # It has no borders, is not decided, and receives less than a thousandth of the light.
            assert found.state[face] == UNSURE
            continue
        across = np.cross(normal, points[other] - points[one])
        sides = (starts - points[one]) @ across, (ends - points[one]) @ across
        along = np.cross(normal, ends - starts)
        apart = [np.einsum("nk,nk->n", along, points[at] - starts) for at in (one, other)]
        crosses = (sides[0] * sides[1] <= 0) & (apart[0] * apart[1] <= 0)
        assert crosses.any()


def test_an_occluder_out_of_the_light_changes_nothing() -> None:
    floor = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], dtype=np.float64)
    sheet = np.array([[-5, -5, 20], [5, -5, 20], [0, 5, 20]], dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], dtype=np.int32)
    states = []
    # In the light; beneath the floor; and beyond its border.
    for shift in ([0, 0, 0], [0, 0, -40], [90, 0, 0]):
        vertices = np.concatenate([floor, sheet + np.array(shift)])
        found = ShadowCaster(vertices, Topology.of(vertices, faces)).on_faces(TO_LIGHT)
        states.append((found.state.tolist(), len(found.face)))
    assert UNSURE in states[0][0][:2]
    assert states[0][1] >= 3
    # The floor shades what is beneath it.
    assert states[1] == ([LIT, LIT, BLOCKED], 0)
    assert states[2] == ([LIT, LIT, LIT], 0)


def test_intersecting_faces_are_cut_along_their_common_line() -> None:
    floor = np.array([[-50, -50, 0], [50, -50, 0], [0, 80, 0]], dtype=np.float64)
    blade = np.array([[-5, 0, -6], [5, 0, -6], [0, 0, 9]], dtype=np.float64)
    vertices, faces = np.concatenate([floor, blade]), np.arange(6, dtype=np.int32).reshape(2, 3)
    found = ShadowCaster(vertices, Topology.of(vertices, faces)).on_faces(TO_LIGHT)
    assert found.meeting.all()
    # At height 0, the blade is as wide as 9 / 15 of its base.
    ends = np.stack([found.starts_mm, found.ends_mm], axis=1)
    level = (np.abs(ends[..., 1:]) < 1e-9).all(axis=(1, 2))
    assert set(found.face[level]) == {0, 1}
    np.testing.assert_allclose(np.sort(ends[level][..., 0], axis=1), [[-3, 3]] * 2, atol=1e-9)


def test_measures_of_faces_against_a_plain_reading() -> None:
    generator = np.random.default_rng(3)
    points, places = generator.normal(size=(2, 30, 3))
    faces = generator.integers(0, 30, (50, 3)).astype(np.int32)
    centres, boxes, front = measure_faces(points, places, faces)
    np.testing.assert_allclose(centres, points[faces].mean(axis=1), rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(boxes[:, ::2], places[faces].min(axis=1))
    np.testing.assert_array_equal(boxes[:, 1::2], places[faces].max(axis=1))
    one, two = places[faces[:, 1]] - places[faces[:, 0]], places[faces[:, 2]] - places[faces[:, 0]]
    np.testing.assert_array_equal(front, np.cross(one, two)[:, 2] > 0)
    assert front.any()
    assert not front.all()
