"""Rays anywhere in the pixels of a grid: the same bits as rays in any order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.spatial.transform import Rotation

from scenetruth.raycast import ImageRays, RayCaster, Topology
from scenetruth.raycast.pixel_ray_kernels import sample_directions
from tests.helpers.boxes_and_rays import boxes
from tests.helpers.faceted_surfaces import relief


@settings(max_examples=12, deadline=None)
@given(
    seed=some.integers(0, 10_000), cells=some.integers(2, 60), tilt=some.floats(0, 1.5), per_pixel=some.integers(1, 9)
)
def test_rays_in_pixels_are_cast_as_any_others(seed: int, cells: int, tilt: float, per_pixel: int) -> None:
    generator = np.random.default_rng(seed)
    mesh, (points, triangles) = relief(seed, cells), boxes(generator, 4, 300.0)
    bent = Rotation.from_rotvec([0.3, tilt, 0.1]).apply(mesh.vertices_mm) + [0, 0, 500]
    vertices = np.concatenate([bent, points])
    faces = np.concatenate([mesh.faces, triangles + len(bent)]).astype(np.int32)
    width, height = 37, 23
    turn = Rotation.random(None, generator).as_matrix()
    x, y = np.meshgrid(np.arange(width) - 18.0, np.arange(height) - 11.0)
    grid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 200.0)])
    pixels = np.repeat(np.sort(generator.permutation(width * height)[:300]), per_pixel)
    offsets = np.column_stack([generator.uniform(-0.5, 0.5, (len(pixels), 2)), np.zeros(len(pixels))])
    # At the corners of the pixels, too.
    offsets[:: per_pixel + 1, :2] = np.sign(offsets[:: per_pixel + 1, :2]) / 2
    caster = RayCaster(vertices @ turn.T, Topology.of(vertices @ turn.T, faces))
    origin = turn @ generator.uniform(-20, 20, 3)
    caster.cast(origin, grid @ turn.T, grid_width=width)
    directions = (grid[pixels] + offsets) @ turn.T
    found, expected = caster.cast_in_pixels(origin, directions, pixels), caster.cast(origin, directions)
    assert (expected.face >= 0).any()
    np.testing.assert_array_equal(found.face, expected.face)
    np.testing.assert_array_equal(found.depth, expected.depth)
    np.testing.assert_array_equal(found.weights, expected.weights)


@pytest.mark.parametrize("per_pixel", [8, 64])
def test_pixels_with_hundreds_of_faces(per_pixel: int) -> None:
    """With few rays, the faces of such pixels are not sorted by depth."""
    generator, mesh = np.random.default_rng(7), relief(7, 60)
    vertices = Rotation.from_rotvec([0.9, 0.4, 0.1]).apply(mesh.vertices_mm) + [0, 0, 500]
    x, y = np.meshgrid(np.arange(7) - 3.0, np.arange(5) - 2.0)
    grid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 60.0)])
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    hits = caster.cast(np.zeros(3), grid, grid_width=7)
    assert len(mesh.faces) > 256 * np.count_nonzero(hits.face >= 0)
    pixels = np.repeat(np.arange(35), per_pixel)
    directions = grid[pixels] + np.column_stack([generator.uniform(-0.5, 0.5, (len(pixels), 2)), np.zeros(len(pixels))])
    found, expected = caster.cast_in_pixels(np.zeros(3), directions, pixels), caster.cast(np.zeros(3), directions)
    np.testing.assert_array_equal(found.face, expected.face)
    np.testing.assert_array_equal(found.depth, expected.depth)
    np.testing.assert_array_equal(found.weights, expected.weights)


def test_without_a_grid_rays_are_cast_one_by_one() -> None:
    points, triangles = boxes(np.random.default_rng(1), 3, 300.0)
    caster, directions = RayCaster(points, Topology.of(points, triangles)), np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]])
    found = caster.cast_in_pixels(np.zeros(3), directions, np.array([0, 1]))
    np.testing.assert_array_equal(found.face, caster.cast(np.zeros(3), directions).face)


@pytest.mark.parametrize("apart", [False, True])
def test_directions_of_samples(apart: bool) -> None:
    generator = np.random.default_rng(4)
    directions, offsets = generator.normal(size=(12, 3)), generator.uniform(-0.5, 0.5, (30, 2))
    across, down = generator.normal(size=(2, 12 if apart else 1, 3))
    pixels = np.sort(generator.integers(0, 12, 30))
    rays = ImageRays(np.zeros(3), directions, across, down, np.zeros(12, dtype=np.int32), 4)
    own = pixels if apart else np.zeros(30, dtype=np.int64)
    expected = directions[pixels] + offsets[:, :1] * across[own] + offsets[:, 1:] * down[own]
    np.testing.assert_allclose(sample_directions(rays, pixels, offsets), expected, rtol=1e-14, atol=1e-15)
