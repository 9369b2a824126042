"""The torus against its closed formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import make_torus
from scenetruth.scene.reference_configuration import AnalyticConfiguration, make_reference_configuration
from scenetruth.scene.scene_report import find_lighting_problems
from scenetruth.scene.surface_tensor_kernels import CURVATURE, NORMAL, surface_tensors
from scenetruth.scene.taylor import Jet
from tests.helpers.scenes import cube

RING, TUBE = 20.0, 6.0
MESH = make_torus(RING, TUBE, 0.5)


def angles(points: NDArray[np.float64]) -> tuple[Any, Any]:
    """Around the ring and around the tube, by the place alone."""
    return (
        np.arctan2(points[:, 1], points[:, 0]),
        np.arctan2(-points[:, 2], np.hypot(points[:, 0], points[:, 1]) - RING),
    )


def test_vertices_lie_on_the_surface_each_once() -> None:
    x, y, z = MESH.vertices_mm.T
    np.testing.assert_allclose((np.hypot(x, y) - RING) ** 2 + z**2, TUBE**2, rtol=1e-12)
    assert len(np.unique(MESH.vertices_mm.round(9), axis=0)) == len(MESH.vertices_mm)
    # Of a closed surface with one hole, vertices - edges + faces = 0, and every edge has two faces.
    edges = np.sort(MESH.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 2).all()
    assert len(MESH.vertices_mm) - len(uses) + len(MESH.faces) == 0


def test_faces_look_outwards_and_enclose_area_and_volume() -> None:
    corners = MESH.vertices_mm[MESH.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    np.testing.assert_allclose(normals.sum(axis=0), 0, atol=1e-10)
    area, volume = 4 * np.pi**2 * RING * TUBE, 2 * np.pi**2 * RING * TUBE**2
    # Facets of 0.5 mm on a tube of 6 mm lose (0.5 / 6)² / 6 = 1.2e-3.
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=2e-3)
    found = np.einsum("ij,ij->", normals, corners.mean(axis=1)) / 3
    assert 0.998 * volume < found < volume
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert np.sort(edges, axis=1)[:, :2].max() <= 0.5


def test_normals_and_curvature_are_those_of_the_formula() -> None:
    start = make_reference_configuration(MESH)
    assert isinstance(start, AnalyticConfiguration)
    points = start.surface(Jet.variable(np.zeros(1), 0, 3))
    tensors = surface_tensors(*(np.ascontiguousarray(field.coefficients) for field in points))
    phi, theta = angles(MESH.vertices_mm)
    outward = np.column_stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)])
    around = np.column_stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)])
    axis = np.array([0.0, 0.0, 1.0])
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    normal, section = cosine * outward - sine * axis, -sine * outward - cosine * axis
    np.testing.assert_allclose(tensors[:, NORMAL : NORMAL + 3], normal, atol=1e-12)
    # Principal curvatures: 1 / r around the tube and cos θ / (R + r cos θ) around the ring, negative inside.
    expected = -section[:, :, None] * section[:, None, :] / TUBE
    expected -= (cosine / (RING + TUBE * cosine))[:, :, None] * around[:, :, None] * around[:, None, :]
    xx, yy, zz, xy, xz, yz = tensors[:, CURVATURE:].T
    found = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_chart_and_image_lie_upright_and_cover_the_surface_once() -> None:
    assert MESH.uv is not None
    for flat, whole in ((MESH.chart_mm, 4 * np.pi**2 * RING * TUBE), (MESH.uv, 1.0)):
        one, two = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        turned = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
        # As seen from outside, x to the right and y down.
        assert (turned < 0).all()
        assert -turned.sum() / 2 == pytest.approx(whole, rel=1e-12)
        assert np.prod(np.ptp(flat, axis=(0, 1))) == pytest.approx(whole, rel=1e-12)
    # The middle of the image's height is what faces the camera.
    front = MESH.vertices_mm[MESH.faces][..., 2] < -TUBE * np.cos(0.1)
    np.testing.assert_allclose(MESH.uv[front][:, 1], 0.5, atol=0.1 / (2 * np.pi))
    edges = MESH.vertices_mm[MESH.faces] - np.roll(MESH.vertices_mm[MESH.faces], 1, axis=1)
    flat_edges = MESH.chart_mm - np.roll(MESH.chart_mm, 1, axis=1)
    stretch = np.linalg.norm(edges, axis=2) / np.linalg.norm(flat_edges, axis=2)
    assert stretch.max() < 1 + TUBE / RING
    assert stretch.min() > (1 - TUBE / RING) * 0.998


def test_a_lamp_in_the_hole_is_outside_and_one_in_the_tube_is_inside() -> None:
    item = cube().to_dict()["objects"][0]
    mesh = {"kind": "torus", "ring_radius_mm": RING, "tube_radius_mm": TUBE, "resolution_mm": 2}
    thing = {**item, "mesh": mesh, "motion": [], "pose": {"position_mm": [0, 0, 600]}}
    for x_mm, inside in ((0.0, False), (RING, True)):
        lamp = {"kind": "point", "position_mm": [x_mm, 0.3, 600], "irradiance": 1, "reference_distance_mm": 9}
        scene = cube(objects=[thing], lighting={"lights": [lamp]})
        assert bool(find_lighting_problems(scene, build_scene(scene))) == inside


@pytest.mark.parametrize(
    ("changes", "path", "message"),
    [
        ({"tube_radius_mm": 20}, "tube_radius_mm", "less than ring_radius_mm, 20 mm"),
        ({"resolution_mm": 7}, "resolution_mm", "at most tube_radius_mm, 6 mm"),
        ({"resolution_mm": 1e-3}, "resolution_mm", "triangles, more than 2e"),
        ({"ring_radius_mm": 0}, "ring_radius_mm", "greater than 0"),
    ],
)
def test_impossible_tori(changes: dict[str, float], path: str, message: str) -> None:
    item = cube().to_dict()["objects"][0]
    mesh = {"kind": "torus", "ring_radius_mm": RING, "tube_radius_mm": TUBE, **changes}
    with pytest.raises(st.SceneError, match=message) as caught:
        cube(objects=[{**item, "mesh": mesh}])
    assert [problem.path for problem in caught.value.problems] == [f"objects.0.mesh.{path}"]
