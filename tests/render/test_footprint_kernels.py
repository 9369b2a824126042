"""Means over footprints, against samples that are walked, textured and lit one after another."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenetruth.camera import Viewpoint
from scenetruth.raycast import Hits, ImageRays, RayCaster, TexturedMesh
from scenetruth.raycast.hit_kernels import walk_footprints
from scenetruth.render.footprint_kernels import (
    Footprints,
    LampLight,
    Raster,
    add_samples,
    average_footprints,
    order_samples,
    sample_hits,
    sample_raster,
    sort_by_body,
)
from scenetruth.render.footprint_rules import raster_of
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.render.sampling_rules import gauss_rule, square_rule
from scenetruth.scene.texture import Picture
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of


@pytest.mark.parametrize("cubic", [True, False])
@pytest.mark.parametrize("lamps", [0, 2])
def test_means_equal_walked_samples(cubic: bool, lamps: int) -> None:
    scene = scene_of(
        {}, {"pose": {"position_mm": [8, 5, 640]}}, camera={"width": 64, "height": 48, "focal_length_px": 600}
    )
    world = world_of(scene, relief(1, 40), ball(3, 3))
    renderer, origin = RaycastRenderer(world, scene.camera), np.zeros(3)
    caster = RayCaster(world.at(0).vertices_mm, renderer._topology)
    assert Viewpoint.on_axis(0.0).position_mm.tolist() == origin.tolist()
    hits = caster.cast(origin, renderer._directions, grid_width=64)
    rays = ImageRays(origin, renderer._directions, renderer._across, renderer._down, hits.face, 64)
    mesh = TexturedMesh(caster.vertices_mm, world.faces, caster.topology.face_neighbours, world.face_body, world.uv)
    generator = np.random.default_rng(2)
    texture: Any = world.bodies[0].texture if cubic else Picture(generator.random((50, 70)).astype(np.float32), True)
    raster = raster_of(texture)
    assert raster is not None
    pixels = np.flatnonzero(hits.face >= 0)
    offsets, weights = square_rule(*gauss_rule(3))
    light = np.where(generator.random((len(world.faces), lamps)) < 0.5, 1.0, -1.0)
    light *= generator.random(light.shape)
    blocked = generator.integers(0, 4, len(pixels)).astype(np.uint64)
    every = np.zeros(len(pixels), dtype=np.int64)
    footprints = Footprints(pixels, every, every + 9, offsets, weights, np.empty(0, dtype=np.bool_))
    lit = LampLight(light if lamps else np.empty((0, 0)), blocked, 0.3)
    arrived, means = average_footprints(mesh, rays, footprints, raster, lit)
    walked, face, _, _, uv = walk_footprints(mesh, rays, pixels, offsets)
    np.testing.assert_array_equal(arrived, walked)
    assert 100 < walked.sum() < len(walked)
    radiance = texture.radiance(uv[walked].reshape(-1, 2)).reshape(-1, 9).astype(np.float64)
    if lamps:
        reached = (blocked[walked, None] >> np.arange(2, dtype=np.uint64)) & np.uint64(1) == 0
        parts = light[face[walked]]
        radiance *= 0.3 + np.where(parts >= 0, parts, np.where(reached[:, None], -parts, 0)).sum(axis=-1)
    # Values are float32.
    np.testing.assert_allclose(means[walked], radiance @ weights, atol=3e-7)
    where, out = np.arange(0, 9 * walked.sum(), 7), np.zeros(9 * walked.sum(), dtype=np.float32)
    sample_raster(raster, uv[walked].reshape(-1, 2), where, out)
    np.testing.assert_allclose(out[where], texture.radiance(uv[walked].reshape(-1, 2))[where], atol=3e-7)
    assert not np.delete(out, where).any()


def test_next_to_other_bodies_walks_end_at_intersecting_faces_only() -> None:
    scene = scene_of(
        {}, {"pose": {"position_mm": [8, 5, 640]}}, camera={"width": 64, "height": 48, "focal_length_px": 600}
    )
    world = world_of(scene, relief(1, 40), ball(3, 3))
    renderer, origin = RaycastRenderer(world, scene.camera), np.zeros(3)
    caster = RayCaster(world.at(0).vertices_mm, renderer._topology)
    hits = caster.cast(origin, renderer._directions, grid_width=64)
    rays = ImageRays(origin, renderer._directions, renderer._across, renderer._down, hits.face, 64)
    mesh = TexturedMesh(caster.vertices_mm, world.faces, caster.topology.face_neighbours, world.face_body, world.uv)
    raster, pixels = raster_of(world.bodies[0].texture), np.flatnonzero(hits.face >= 0)
    assert raster is not None
    offsets, weights = square_rule(*gauss_rule(2))
    every, none = np.zeros(len(pixels), dtype=np.int64), LampLight(np.empty((0, 0)), np.empty(0, dtype=np.uint64), 0.0)
    number = []
    for meeting in (np.ones(len(world.faces), dtype=np.bool_), np.zeros(len(world.faces), dtype=np.bool_)):
        footprints = Footprints(pixels, every, every + 4, offsets, weights, meeting)
        number.append(average_footprints(mesh, rays, footprints, raster, none)[0].sum())
    strict = Footprints(pixels, every, every + 4, offsets, weights, np.empty(0, dtype=np.bool_))
    assert number[0] == average_footprints(mesh, rays, strict, raster, none)[0].sum() < number[1]


def test_hits_are_sorted_by_body_and_looked_up() -> None:
    generator = np.random.default_rng(5)
    face = generator.integers(-1, 20, 300).astype(np.int32)
    face_body = generator.integers(0, 4, 20).astype(np.int32)
    order, starts = sort_by_body(face, face_body, 5)
    for body in range(5):
        own = np.flatnonzero((face >= 0) & (face_body[face] == body))
        np.testing.assert_array_equal(order[starts[body] : starts[body + 1]], own)
    assert len(order) == np.count_nonzero(face >= 0)
    hits = Hits(face, np.ones(300), generator.random((300, 2)) / 2)
    uv = generator.normal(size=(20, 3, 2))
    values = generator.random((30, 40)).astype(np.float32)
    where, found, expected = order[: starts[2]], *np.zeros((2, 300), dtype=np.float32)
    for raster in (Raster(values, True, True, 0.5, 0.2), Raster(values, False, True, 1.0, 0.0)):
        sample_hits(raster, uv, hits.face, hits.weights, where, found)
        sample_raster(raster, hits.interpolate_corners(uv), where, expected)
        np.testing.assert_array_equal(found, expected)
        assert np.count_nonzero(found) == len(where)


def test_samples_are_ordered_and_added_by_pixel() -> None:
    generator = np.random.default_rng(6)
    pixels, counts = np.array([9, 2, 5]), np.array([2, 1, 3])
    starts, order = np.cumsum(counts) - counts, np.argsort(pixels)
    offsets, weights, cells = generator.random((6, 2)), generator.random(6), np.arange(6, dtype=np.int32)
    owner, moved, shares, numbers = order_samples(order, pixels, starts, counts, offsets, weights, cells)
    expected = [2, 3, 4, 5, 0, 1]
    assert owner.tolist() == [2, 5, 5, 5, 9, 9]
    assert numbers.tolist() == expected
    np.testing.assert_array_equal(moved, offsets[expected])
    np.testing.assert_array_equal(shares, weights[expected])
    firsts = np.array([0, 1, 4])
    again = order_samples(np.arange(3), pixels[order], firsts, counts[order], moved, shares, numbers)
    np.testing.assert_array_equal(again[0], owner)
    np.testing.assert_array_equal(again[1], moved)
    np.testing.assert_array_equal(again[2], shares)
    np.testing.assert_array_equal(again[3], expected)
    radiance = generator.random(6).astype(np.float32)
    means = add_samples(counts[order], radiance, shares)
    product = radiance * shares
    np.testing.assert_allclose(means, [product[:1].sum(), product[1:4].sum(), product[4:].sum()], rtol=1e-15)
