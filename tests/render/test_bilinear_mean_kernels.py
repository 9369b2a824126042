"""Exact means of bilinear textures over polygons, against closed forms and many samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.raycast import ImageRays, RayCaster, TexturedMesh
from scenetruth.render.bilinear_mean_kernels import MOST_CORNERS, MOST_TEXELS, average_bilinear, polygon_mean
from scenetruth.render.footprint_kernels import Footprints, LampLight, average_footprints
from scenetruth.render.footprint_rules import raster_of
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.render.sampling_rules import even_rule, square_rule
from scenetruth.scene.texture import Picture
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of

SHAPE = (40, 50)


def mean_of(values: NDArray[np.float32], corners: NDArray[np.float64], *, tiled: bool = False) -> tuple[bool, float]:
    """Return whether the mean over a polygon is computed, and the mean."""
    padded = np.zeros((MOST_CORNERS + 1, 3))
    padded[: len(corners)] = corners
    texels, sums = np.empty((2, MOST_TEXELS + 3, MOST_TEXELS + 3))
    found, mean = polygon_mean(values, tiled, padded, len(corners), texels, sums)
    return bool(found), float(mean)


def flat(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return corners at the same depth."""
    return np.column_stack([places, np.ones(len(places))])


@pytest.mark.parametrize("tiled", [True, False])
@given(seed=some.integers(0, 1000), step=some.sampled_from([0.03, 0.4, 1.0, 3.0]))
@settings(max_examples=20, deadline=None)
def test_means_over_pixels_in_perspective_agree_with_many_samples(tiled: bool, seed: int, step: float) -> None:
    generator = np.random.default_rng(seed)
    values = generator.random(SHAPE).astype(np.float32)
    # Quotients of linear forms in the pixel, some of them beyond the texture.
    form = np.column_stack([generator.uniform(-0.2, 1.2, 2), generator.standard_normal((2, 2)) * step / 45])
    form = np.vstack([form, [1.0, *generator.uniform(-1e-3, 1e-3, 2)]])
    square = np.array([[1, -0.5, -0.5], [1, 0.5, -0.5], [1, 0.5, 0.5], [1, -0.5, 0.5]])
    u, v, depth = form @ square.T
    found, mean = mean_of(values, np.column_stack([u / depth * 50 - 0.5, v / depth * 40 - 0.5, depth]), tiled=tiled)
    count = 64
    samples = Picture(values, tiled).mean_radiance(form[None], *square_rule(*even_rule(count)))[0]
    # Bends of up to 4 are missed by the samples; the correction for the perspective of 1e-3 is within a tenth.
    slope = 4 * step * max(step, 1.0)
    assert found
    assert abs(mean - samples) < slope / (12 * count**2) + 1e-4 * min(slope, 1.0) + 1e-6


def test_means_of_an_axis_parallel_rectangle_follow_from_sums() -> None:
    """From 16.5 to 22.5 columns and 12.5 to 16.5 rows: weights of the trapezoidal rule."""
    values = np.random.default_rng(5).random(SHAPE).astype(np.float32)
    found, mean = mean_of(values, flat(np.array([[16.5, 12.5], [22.5, 12.5], [22.5, 16.5], [16.5, 16.5]])))
    across, down = (np.array([0.125, 0.875, *[1.0] * k, 0.875, 0.125]) for k in (4, 2))
    # Texels 16 to 23 and 12 to 17.
    assert found
    assert mean == pytest.approx(down @ values[12:18, 16:24].astype(np.float64) @ across / 24, abs=1e-12)


@given(seed=some.integers(0, 1000), count=some.integers(3, MOST_CORNERS), turn=some.floats(0, 6.3))
@settings(max_examples=30, deadline=None)
def test_means_of_a_linear_texture_are_its_value_at_the_centroid(seed: int, count: int, turn: float) -> None:
    across, down = np.random.default_rng(seed).uniform(-0.01, 0.01, 2)
    x, y = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    angles = turn + 2 * np.pi * np.arange(count) / count
    places = np.array([20.3, 17.8]) + 2.2 * np.column_stack([np.cos(angles), np.sin(angles)])
    # Both directions around the polygon.
    places = places[:: 1 if seed % 2 else -1]
    found, mean = mean_of((0.5 + across * x + down * y).astype(np.float32), flat(places))
    assert found
    assert mean == pytest.approx(0.5 + across * 20.3 + down * 17.8, abs=1e-6)


def test_polygons_that_are_large_or_thin_are_left_out() -> None:
    values = np.ones(SHAPE, dtype=np.float32)
    square = np.array([[3.1, 2.0], [4.1, 2.0], [4.1, 3.0], [3.1, 3.0]])
    assert mean_of(values, flat(square))[1] == pytest.approx(1.0)
    assert not mean_of(values, flat(square * (MOST_TEXELS + 1)))[0]
    assert not mean_of(values, flat(square * [1.0, 0.0]))[0]
    assert not mean_of(values, flat(square * [np.nan, 1.0]))[0]


@pytest.mark.parametrize("lamps", [0, 2])
def test_means_across_facets_agree_with_many_samples(lamps: int) -> None:
    """Facets of 6 px with their own light, against 48 x 48 samples that are walked."""
    scene = scene_of(
        {}, {"pose": {"position_mm": [8, 5, 640]}}, camera={"width": 64, "height": 48, "focal_length_px": 600}
    )
    world = world_of(scene, relief(1, 12), ball(3, 2))
    renderer, origin = RaycastRenderer(world, scene.camera), Viewpoint.on_axis(0.0).position_mm
    caster = RayCaster(world.at(0).vertices_mm, renderer._topology)
    hits = caster.cast(origin, renderer._directions, grid_width=64)
    rays = ImageRays(origin, renderer._directions, renderer._across, renderer._down, hits.face, 64)
    mesh = TexturedMesh(caster.vertices_mm, world.faces, caster.topology.face_neighbours, world.face_body, world.uv)
    generator = np.random.default_rng(2)
    raster = raster_of(Picture(generator.random((50, 70)).astype(np.float32), True))
    assert raster is not None
    pixels, count = np.flatnonzero(hits.face >= 0), 48
    light = np.where(generator.random((len(world.faces), lamps)) < 0.5, 1.0, -1.0)
    light *= generator.random(light.shape)
    blocked = generator.integers(0, 4, len(pixels)).astype(np.uint64)
    lit = LampLight(light if lamps else np.empty((0, 0)), blocked, 0.3)
    every = np.zeros(len(pixels), dtype=np.int64)
    rule, none = square_rule(*even_rule(count)), np.empty(0, dtype=np.bool_)
    samples = Footprints(pixels, every, every + count**2, *rule, none)
    arrived, walked = average_footprints(mesh, rays, samples, raster, lit)
    done, means = average_bilinear(mesh, rays, Footprints(pixels, every, every, *rule, none), raster, lit)
    both = arrived & done
    assert 1000 < both.sum() < len(both)
    # At the edge of a facet, the light has a step of up to 0.6 at the mean radiance.
    error = np.abs(means - walked)[both]
    if lamps:
        assert np.sqrt(np.mean(error**2)) < 0.6 / count**1.5
    else:
        assert error.max() < 4 * 1.5 / (12 * count**2)
    # Pixels that are reached by walks are omitted only if they are seen at a grazing angle.
    assert done[arrived].mean() > 0.9
