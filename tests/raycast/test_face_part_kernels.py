"""Parts of faces in pixels, against rays through many points of each pixel."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint, pixel_rays
from scenetruth.raycast import ImageRays, RayCaster, TexturedMesh, Topology, mixed_pixels
from scenetruth.raycast.face_part_kernels import MOST_PARTS, FaceParts, divide_pixels
from scenetruth.raycast.pixel_ray_kernels import sample_directions
from scenetruth.scene.mesh import TriangleMesh
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of

ON_AXIS = Viewpoint.on_axis(0.0)
PARTS = 24


def divided(
    mesh: TriangleMesh, size: tuple[int, int] = (40, 30)
) -> tuple[RayCaster, ImageRays, NDArray[np.int64], NDArray[np.bool_], FaceParts]:
    """Return the parts of the pixels of an image that are not mixed."""
    width, height = size
    scene = scene_of({}, camera={"width": width, "height": height, "focal_length_px": 300})
    world = world_of(scene, mesh)
    rays = pixel_rays(scene.camera)
    vertices = world.at(0.0).vertices_mm
    caster = RayCaster(vertices, Topology.of(vertices, world.faces, world.crease_deg))
    hits = caster.cast(np.zeros(3), rays.directions, grid_width=width)
    body = np.where(hits.face >= 0, 0, -1).astype(np.int32)
    mixed = mixed_pixels(caster, ON_AXIS, scene.camera, body.reshape(height, width)).ravel()
    image = ImageRays(np.zeros(3), rays.directions, *rays.steps, hits.face, width)
    textured = TexturedMesh(caster.vertices_mm, world.faces, caster.topology.face_neighbours, world.face_body, world.uv)
    pixels = np.flatnonzero((body >= 0) & ~mixed)
    done, beside, parts = divide_pixels(textured, image, pixels)
    assert not beside.any()
    return caster, image, pixels, done, parts


@pytest.mark.parametrize("mesh", [relief(2, 12), ball(4, 3)])
def test_areas_and_centroids_are_those_of_many_rays(mesh: TriangleMesh) -> None:
    caster, image, pixels, done, parts = divided(mesh)
    assert done.all()
    count = len(pixels)
    # The parts fill the pixel, and its centroid is its centre.
    np.testing.assert_allclose(np.bincount(parts.owner, parts.area, minlength=count), 1.0, atol=1e-9)
    for axis in range(2):
        moment = np.bincount(parts.owner, parts.area * parts.offsets[:, axis], minlength=count)
        np.testing.assert_allclose(moment, 0.0, atol=1e-9)
    some = np.flatnonzero(np.bincount(parts.owner, minlength=count) > 2)[:8]
    steps = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    owner = np.repeat(pixels[some], len(grid))
    hits = caster.cast_in_pixels(np.zeros(3), sample_directions(image, owner, np.tile(grid, (len(some), 1))), owner)
    for number, face in zip(some, hits.face.reshape(len(some), -1), strict=True):
        own = parts.owner == number
        shares = np.array([np.mean(face == one) for one in parts.face[own]])
        # An edge along the grid is up to half a step away from samples, on both sides of a part.
        np.testing.assert_allclose(shares, parts.area[own], atol=1 / PARTS)
        assert np.isin(face, parts.face[own]).mean() > 1 - 1 / PARTS


def test_centroids_are_hits_of_their_rays() -> None:
    caster, image, pixels, done, parts = divided(relief(3, 20))
    assert done.all()
    own = pixels[parts.owner]
    hits = caster.cast_in_pixels(np.zeros(3), sample_directions(image, own, parts.offsets), own)
    np.testing.assert_array_equal(hits.face, parts.face)
    np.testing.assert_allclose(hits.depth, parts.depth, rtol=1e-9)
    large = parts.area > 1e-6
    np.testing.assert_allclose(hits.weights[large], parts.weights[large], atol=1e-6)


def test_pixels_with_too_many_faces_are_not_divided() -> None:
    _, _, pixels, done, parts = divided(relief(1, 400), (12, 9))
    assert len(pixels)
    assert not done.any()
    assert not len(parts.owner)
    # Pixels of 2.2 mm with edges of 60 mm / 400 contain 2 (2.2 / 0.15)² faces.
    assert MOST_PARTS < 2 * (2.2 * 400 / 60) ** 2
