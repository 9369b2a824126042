"""Footprints as linear forms, and walks over facets, against rays of their own for every sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Camera, Viewpoint, pixel_rays
from scenetruth.raycast import Hits, ImageRays, RayCaster, TexturedMesh, Topology, mixed_pixels
from scenetruth.raycast.hit_kernels import footprint_forms, walk_footprints
from scenetruth.scene.mesh import TriangleMesh, make_box
from tests.helpers.faceted_surfaces import ball, relief


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


CAMERA = Camera(width=80, height=60, focal_length_px=700)
STEPS = np.array([-0.43, -0.17, 0.17, 0.43])
OFFSETS = np.stack(np.meshgrid(STEPS, STEPS), axis=-1).reshape(-1, 2)


def walk_and_cast(
    vertices: NDArray[np.float64], mesh: TriangleMesh, bodies: NDArray[np.int32], camera: Camera = CAMERA
) -> tuple[Any, Hits, NDArray[np.float64], NDArray[np.int64]]:
    """Return what a walk finds, what rays find, their texture coordinates, and the pixels without edges."""
    caster = RayCaster(vertices, Topology.of(vertices, mesh.faces, mesh.crease_deg))
    assert mesh.uv is not None
    viewpoint = Viewpoint.on_axis(2.0)
    rays = pixel_rays(camera)
    across, down = rays.steps
    hits = caster.cast(viewpoint.position_mm, rays.directions, camera.width)
    body = np.where(hits.face >= 0, bodies[hits.face], -1).astype(np.int32)
    mixed = mixed_pixels(caster, viewpoint, camera, body.reshape(camera.height, camera.width)).ravel()
    pixels = np.flatnonzero((hits.face >= 0) & ~mixed)
    walked = walk_footprints(
        TexturedMesh(vertices, mesh.faces, caster.topology.face_neighbours, bodies, mesh.uv),
        ImageRays(viewpoint.position_mm, rays.directions, across, down, hits.face, camera.width),
        pixels,
        OFFSETS,
    )
    right, below = (item[pixels] if len(item) > 1 else item for item in (across, down))
    samples = rays.directions[pixels][:, None] + (OFFSETS[:, :1] * right[:, None] + OFFSETS[:, 1:] * below[:, None])
    cast = caster.cast(viewpoint.position_mm, samples.reshape(-1, 3))
    return walked, cast, cast.interpolate_corners(mesh.uv), pixels


@pytest.mark.parametrize("form", ["leaf", "ball"])
@settings(max_examples=25, deadline=None)
@given(seed=some.integers(0, 10_000), fine=some.integers(0, 2), tilt=some.floats(0, 1.5), inside_out=some.booleans())
def test_walks_arrive_where_rays_do(form: str, seed: int, fine: int, tilt: float, inside_out: bool) -> None:
    # Facets of about 6, 2 and 0.7 px.
    mesh = relief(seed, (10, 30, 90)[fine], height=0.4) if form == "leaf" else ball(seed, fine + 2)
    if inside_out:
        assert mesh.uv is not None
        mesh = TriangleMesh(
            mesh.vertices_mm, mesh.faces[:, ::-1].copy(), mesh.chart_mm, mesh.uv[:, ::-1].copy(), crease_deg=60.0
        )
    axis = np.random.default_rng(seed).normal(size=3)
    vertices = Rotation.from_rotvec(tilt * axis / np.linalg.norm(axis)).apply(mesh.vertices_mm) + [0, 0, 660]
    camera = CAMERA if seed % 2 else CAMERA.model_copy(update={"focal_length_px": 690.0})
    walked, cast, uv, pixels = walk_and_cast(vertices, mesh, np.zeros(len(mesh.faces), np.int32), camera)
    arrived, face, depth, weights, walked_uv = walked
    # Given up are pixels beside the silhouette, and rays exactly through edges.
    assert arrived.mean() > 0.6 or len(pixels) < 300
    chosen = np.repeat(arrived, len(OFFSETS))
    np.testing.assert_array_equal(face.ravel()[chosen], cast.face[chosen])
    np.testing.assert_array_equal(depth.ravel()[chosen], cast.depth[chosen])
    np.testing.assert_array_equal(weights.reshape(-1, 2)[chosen], cast.weights[chosen])
    np.testing.assert_array_equal(walked_uv.reshape(-1, 2)[chosen], uv[chosen])


def test_lenses_that_bend_have_steps_of_their_own() -> None:
    camera = Camera(width=80, height=60, focal_length_px=700, distortion={"k1": -4.0, "p1": 0.05})
    mesh = relief(3, 40)
    bodies = np.zeros(len(mesh.faces), np.int32)
    walked, cast, uv, _pixels = walk_and_cast(mesh.vertices_mm + [0, 0, 660], mesh, bodies, camera)
    assert walked[0].mean() > 0.9
    chosen = np.repeat(walked[0], len(OFFSETS))
    np.testing.assert_array_equal(walked[1].ravel()[chosen], cast.face[chosen])
    np.testing.assert_allclose(walked[4].reshape(-1, 2)[chosen], uv[chosen], atol=1e-13)


def test_walks_end_at_other_bodies() -> None:
    mesh = relief(5, 90)
    vertices = mesh.vertices_mm + [0, 0, 660]
    _walked, cast, _uv, _pixels = walk_and_cast(vertices, mesh, np.zeros(len(mesh.faces), np.int32))
    # Facets that no pixel's centre tells of, but samples meet.
    rays = pixel_rays(CAMERA).directions
    centres = RayCaster(vertices, Topology.of(vertices, mesh.faces)).cast(np.array([2.0, 0, 0]), rays, 80).face
    hidden = np.setdiff1d(cast.face, centres)[::10]
    bodies = np.zeros(len(mesh.faces), np.int32)
    bodies[hidden] = 1
    (arrived, face, *_), cast, _uv, _pixels = walk_and_cast(vertices, mesh, bodies)
    strange = (bodies[cast.face].reshape(face.shape) == 1).any(axis=1)
    assert strange.sum() > 50
    assert not arrived[strange].any()
    assert arrived.mean() > 0.3
    assert (bodies[face[arrived]] == 0).all()


def test_a_walk_around_a_hole_that_no_edge_tells_of_is_given_up() -> None:
    # Nobody tells the kernel that the sheet ends here: it must find out itself.
    mesh = relief(7, 30, size_mm=30.0)
    vertices = mesh.vertices_mm + [0, 0, 660]
    topology = Topology.of(vertices, mesh.faces)
    rays = pixel_rays(CAMERA)
    hits = RayCaster(vertices, topology).cast(np.zeros(3), rays.directions, CAMERA.width)
    outline = np.flatnonzero((topology.face_neighbours < 0).any(axis=1))
    pixels = np.flatnonzero(np.isin(hits.face, outline))
    assert mesh.uv is not None
    alone = np.zeros(len(mesh.faces), np.int32)
    arrived = walk_footprints(
        TexturedMesh(vertices, mesh.faces, topology.face_neighbours, alone, mesh.uv),
        ImageRays(np.zeros(3), rays.directions, *rays.steps, face=hits.face.clip(0), width=CAMERA.width),
        pixels,
        20 * OFFSETS,
    )[0]
    assert len(pixels) > 50
    assert not arrived.any()
