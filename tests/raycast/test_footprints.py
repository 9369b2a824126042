"""Footprints as linear forms against rays of their own for every sample."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.raycast import ImageRays, RayCaster, TexturedMesh, Topology
from scenetruth.raycast.hit_kernels import footprint_forms
from scenetruth.scene.mesh.solids import make_box


@pytest.mark.parametrize("per_pixel", [False, True])
def test_forms_give_the_texture_coordinates_of_every_sample(per_pixel: bool) -> None:
    mesh = make_box((40, 50, 60))
    generator = np.random.default_rng(3)
    vertices = mesh.vertices_mm @ np.linalg.qr(generator.normal(size=(3, 3)))[0] + [2, -3, 200]
    uv = generator.uniform(-2, 3, (len(mesh.faces), 3, 2))
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces))
    y, x = np.mgrid[:48, :64].astype(np.float64)
    directions = np.stack([(x - 31.5) / 160, (y - 23.5) / 160, np.ones_like(x)], axis=-1).reshape(-1, 3)
    origin = np.array([0.5, 0.25, 0.0])
    across, down = np.array([[1 / 160, 1e-4, 0]]), np.array([[-2e-4, 1 / 160, 0]])
    if per_pixel:
        scale = generator.uniform(0.8, 1.2, (len(directions), 1))
        across, down = across * scale, down / scale
    hits = caster.cast(origin, directions, grid_width=64)
    pixels = np.flatnonzero(hits.face >= 0)
    reach = 0.375
    bodies = np.zeros(len(mesh.faces), dtype=np.int32)
    textured = TexturedMesh(vertices, mesh.faces, caster.topology.face_neighbours, bodies, uv)
    rays = ImageRays(origin, directions, across, down, hits.face, 64)
    forms, whole = footprint_forms(textured, rays, pixels, reach)
    assert 0.5 < whole.mean() < 1
    steps = np.linspace(-reach, reach, 4)
    stay = np.ones(len(pixels), dtype=bool)
    for u in steps:
        for v in steps:
            moved = directions[pixels] + u * np.broadcast_to(across, directions.shape)[pixels]
            moved = moved + v * np.broadcast_to(down, directions.shape)[pixels]
            each = caster.cast(origin, moved)
            same = each.face == hits.face[pixels]
            stay &= same
            found = forms @ [1, u, v]
            expected = each.interpolate_corners(uv)
            np.testing.assert_allclose(found[same, :2] / found[same, 2:], expected[same], rtol=1e-11, atol=1e-12)
    # The box is convex: who leaves its face, sees another one or nothing.
    np.testing.assert_array_equal(whole, stay)
