"""Meshes of surfaces that follow a formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import (
    TriangleMesh,
    make_cylinder,
    make_relief,
    make_saddle,
    make_sheet,
    make_sphere,
    make_spherical_cap,
    make_stairs,
)
from tests.helpers.scenes import cube
from tests.helpers.smooth_surfaces import POSITION, SPEED, SPIN_DEG, TILT_DEG, scene_of

Array = NDArray[np.float64]

ALL = {
    "plane": make_sheet((30, 20), 2),
    "sphere": make_sphere(12, 1),
    "cap": make_spherical_cap(20, 50, 1.5),
    "cylinder": make_cylinder(9, 25, 1),
    "closed cylinder": make_cylinder(9, 25, 1, caps=True),
    "saddle": make_saddle((30, 20), 0.03, 1.5),
    "relief": make_relief((30, 20), 1.0, (12, None), (10, 0), 1.0),
    "stairs": make_stairs((10, 30), (5, -3), risers=True),
}


def face_normals(mesh: TriangleMesh) -> Array:
    corners = mesh.vertices_mm[mesh.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def symmetric(six: Array) -> Array:
    xx, yy, zz, xy, xz, yz = six.T
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)


def test_faces_of_closed_surfaces_face_outwards_and_enclose_the_volume() -> None:
    for name, volume in (("sphere", 4 / 3 * np.pi * 12**3), ("closed cylinder", np.pi * 9**2 * 25)):
        mesh = ALL[name]
        normals, corners = face_normals(mesh), mesh.vertices_mm[mesh.faces]
        # Closed: areas with their directions cancel. Volume by Gauss; facets of 1 mm on 9 mm lose (1/9)²/6.
        np.testing.assert_allclose(normals.sum(axis=0), 0, atol=1e-10)
        found = np.einsum("ij,ij->", normals, corners.mean(axis=1)) / 3
        assert found == pytest.approx(volume, rel=0.003)
        assert found < volume


@pytest.mark.parametrize("name", ["plane", "cap", "saddle", "relief"])
def test_upper_sides_face_the_camera(name: str) -> None:
    assert (face_normals(ALL[name])[:, 2] < 0).all()


def test_areas() -> None:
    areas = {name: float(np.linalg.norm(face_normals(mesh), axis=1).sum()) for name, mesh in ALL.items()}
    assert areas["plane"] == pytest.approx(600, rel=1e-12)
    assert areas["cap"] == pytest.approx(2 * np.pi * 20**2 * (1 - np.cos(np.deg2rad(50))), rel=0.002)
    assert areas["cylinder"] == pytest.approx(2 * np.pi * 9 * 25, rel=0.002)
    assert areas["stairs"] == pytest.approx(30 * (3 * 10 + 5 + 3), rel=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_charts_and_images_lie_upright_and_keep_lengths(name: str) -> None:
    mesh = ALL[name]
    assert mesh.uv is not None
    assert mesh.uv.min() >= -1e-12
    assert mesh.uv.max() <= 1 + 1e-12
    for flat in (mesh.chart_mm, mesh.uv):
        one, two = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        # As seen from outside, x to the right and y down: no triangle is mirrored or without area.
        assert (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] < 0).all()
    edges = mesh.vertices_mm[mesh.faces] - np.roll(mesh.vertices_mm[mesh.faces], 1, axis=1)
    flat_edges = mesh.chart_mm - np.roll(mesh.chart_mm, 1, axis=1)
    stretch = np.linalg.norm(flat_edges, axis=2) / np.linalg.norm(edges, axis=2)
    # Lambert's projection: 1 / cos(half the angle to the middle), 54.7° of a sphere's side. Slopes of the sheets
    # are up to (0.45, 0.3) and 0.52. Chords are shorter than arcs by (1/9)² / 24.
    bounds = {
        "sphere": 1.127,
        "cap": 1 / np.cos(np.deg2rad(25)),
        "saddle": np.sqrt(1 + 0.45**2 + 0.3**2),
        "relief": 1.13,
    }
    bound = bounds.get(name, 1.0) * 1.001
    assert stretch.max() < bound
    assert stretch.min() > 1 / bound


def test_every_place_of_a_chart_is_used_once() -> None:
    for name in ("sphere", "closed cylinder", "stairs"):
        chart = ALL[name].chart_mm
        # Sum of the triangles' areas is the area that they cover, found on a fine raster.
        low, high = chart.min(axis=(0, 1)), chart.max(axis=(0, 1))
        one, two = chart[:, 1] - chart[:, 0], chart[:, 2] - chart[:, 0]
        total = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2
        x, y = (np.linspace(a, b, 41)[:-1] + (b - a) / 80 for a, b in zip(low, high, strict=True))
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
        covered = np.zeros(len(points), dtype=np.int64)
        sides = []
        for corner in range(3):
            start, edge = chart[:, corner], chart[:, (corner + 1) % 3] - chart[:, corner]
            away = points - start
            sides.append(edge[:, 0] * away[..., 1] - edge[:, 1] * away[..., 0] < 0)
        covered = np.logical_and.reduce(sides).sum(axis=1)
        assert covered.max() == 1
        assert covered.mean() * np.prod(high - low) == pytest.approx(total, rel=0.04)


def test_image_faces_the_camera_with_its_middle() -> None:
    for name in ("sphere", "cap", "cylinder", "saddle"):
        mesh = ALL[name]
        assert mesh.uv is not None
        corners = mesh.vertices_mm[mesh.faces]
        front = np.argmin(np.where(np.abs(corners[..., :2]).max(axis=-1) < 1.3, corners[..., 2], np.inf))
        np.testing.assert_allclose(mesh.uv.reshape(-1, 2)[front], 0.5, atol=0.05)
        right = np.argmax(
            corners[..., 0]
            - 1e3 * (np.abs(corners[..., 1]) > 1.5)
            - 1e3 * (corners[..., 2] > 1e-6) * (name != "saddle")
        )
        assert mesh.uv.reshape(-1, 2)[right, 0] > 0.6


def own_frame(mesh: dict[str, Any], t: float) -> tuple[Array, Array, Array, Rotation]:
    """Return the vertices in the own frame, normals and curvature tensors turned back into it, and the turn."""
    world = build_scene(scene_of(mesh))
    tensors = world.surface_at(t)
    turn = Rotation.from_euler("z", SPIN_DEG * t, degrees=True) * Rotation.from_euler("yx", TILT_DEG, degrees=True)
    back = turn.inv()
    matrix = back.as_matrix()
    vertices = back.apply(world.at(t).vertices_mm - POSITION - SPEED * t)
    return vertices, back.apply(tensors[:, :3]), matrix @ symmetric(tensors[:, 12:]) @ matrix.T, turn


@pytest.mark.parametrize(
    "mesh",
    [
        {"kind": "sphere", "radius_mm": 22, "resolution_mm": 5},
        {"kind": "sphere", "radius_mm": 22, "cap_deg": 70, "resolution_mm": 5},
    ],
)
def test_normals_and_curvature_of_a_sphere(mesh: dict[str, Any]) -> None:
    vertices, normals, curvature, _ = own_frame(mesh, 0.7)
    outward = vertices / 22
    # Coordinates of 660 mm are rounded to 1e-13; they are not differentiated.
    np.testing.assert_allclose(normals, outward, atol=1e-12)
    np.testing.assert_allclose(curvature, -(np.eye(3) - outward[:, :, None] * outward[:, None, :]) / 22, atol=1e-13)


def test_normals_and_curvature_of_a_cylinder() -> None:
    mesh = {"kind": "cylinder", "radius_mm": 11, "length_mm": 30, "caps": True, "resolution_mm": 4}
    vertices, normals, curvature, _ = own_frame(mesh, 0.7)
    flat = np.abs(normals[:, 1]) > 0.5
    assert flat.sum() == 2 * (18 + 1)
    np.testing.assert_allclose(normals[flat][:, 1], np.sign(vertices[flat, 1]), atol=1e-12)
    np.testing.assert_allclose(curvature[flat], 0, atol=1e-14)
    outward = (vertices * (1, 0, 1) / 11)[~flat]
    np.testing.assert_allclose(normals[~flat], outward, atol=1e-12)
    around = np.column_stack([-outward[:, 2], np.zeros(len(outward)), outward[:, 0]])
    np.testing.assert_allclose(curvature[~flat], -around[:, :, None] * around[:, None, :] / 11, atol=1e-13)


def graph_curvatures(x: Array, y: Array, kind: str) -> tuple[Array, Array, Array]:
    """Return Gaussian and mean curvature of a graph Z(X, Y), and its slopes' direction (-Z_X, -Z_Y, 1)."""
    if kind == "saddle":
        p, q, xx, xy, yy = 0.02 * x, -0.02 * y, 0.02 + 0 * x, 0 * x, -0.02 + 0 * x
    else:
        kx, ky, a = 2 * np.pi / 16, 2 * np.pi / 24, -0.8
        cx, sx = np.cos(kx * x + np.deg2rad(20)), np.sin(kx * x + np.deg2rad(20))
        cy, sy = np.cos(ky * y - np.deg2rad(40)), np.sin(ky * y - np.deg2rad(40))
        p, q = -a * kx * sx * cy, -a * ky * cx * sy
        xx, xy, yy = -a * kx * kx * cx * cy, a * kx * ky * sx * sy, -a * ky * ky * cx * cy
    w = 1 + p * p + q * q
    gauss = (xx * yy - xy * xy) / w**2
    mean = ((1 + q * q) * xx - 2 * p * q * xy + (1 + p * p) * yy) / (2 * w**1.5)
    return gauss, mean, np.column_stack([-p, -q, np.ones_like(x)]) / np.sqrt(w)[:, None]


@pytest.mark.parametrize(
    "mesh",
    [
        {"kind": "saddle", "size_mm": [40, 32], "curvature_per_mm": 0.02, "resolution_mm": 5},
        {
            "kind": "relief",
            "size_mm": [44, 36],
            "amplitude_mm": 0.8,
            "wavelength_mm": [16, 24],
            "phase_deg": [20, -40],
            "resolution_mm": 4,
        },
    ],
)
def test_normals_and_curvature_of_sheets(mesh: dict[str, Any]) -> None:
    vertices, normals, curvature, _ = own_frame(mesh, 0.7)
    gauss, mean, up = graph_curvatures(vertices[:, 0], vertices[:, 1], mesh["kind"])
    # Curvatures change sign with the side of the sheet from which they are seen.
    side = np.sign(np.einsum("ij,ij->i", normals, up))
    np.testing.assert_allclose(normals * side[:, None], up, atol=1e-12)
    np.testing.assert_allclose(np.trace(curvature, axis1=1, axis2=2) * side / 2, mean, atol=1e-13)
    two = (np.trace(curvature, axis1=1, axis2=2) ** 2 - np.einsum("nij,nji->n", curvature, curvature)) / 2
    np.testing.assert_allclose(two, gauss, atol=1e-14)


@pytest.mark.parametrize(
    ("mesh", "path", "message"),
    [
        ({"kind": "sphere", "radius_mm": 0}, "radius_mm", "greater than 0"),
        ({"kind": "sphere", "radius_mm": 3, "resolution_mm": 4}, "resolution_mm", "at most radius_mm, 3 mm"),
        ({"kind": "sphere", "radius_mm": 3, "cap_deg": 120}, "cap_deg", "less than or equal to 90"),
        ({"kind": "sphere", "radius_mm": 300, "resolution_mm": 1e-3}, "resolution_mm", "triangles, more than 2e"),
        ({"kind": "cylinder", "radius_mm": 3, "length_mm": -1}, "length_mm", "greater than 0"),
        ({"kind": "cylinder", "radius_mm": 3, "length_mm": 9, "resolution_mm": 5}, "resolution_mm", "at most radius"),
        ({"kind": "saddle", "size_mm": [9, 9], "curvature_per_mm": float("nan")}, "curvature_per_mm", "finite"),
        (
            {"kind": "relief", "size_mm": [9, 9], "amplitude_mm": 1, "wavelength_mm": [1, None], "resolution_mm": 0.3},
            "resolution_mm",
            "a quarter of wavelength_mm, 0.25 mm",
        ),
        ({"kind": "plane", "size_mm": [9, 2], "resolution_mm": 3}, "resolution_mm", "the shorter of size_mm, 2 mm"),
        ({"kind": "stairs", "tread_mm": [9, 9], "steps_mm": []}, "steps_mm", "at least 1"),
        ({"kind": "stairs", "tread_mm": [9, 9], "steps_mm": [1, 0]}, "steps_mm", "must not be 0 .got 0 at index 1"),
    ],
)
def test_impossible_surfaces(mesh: dict[str, Any], path: str, message: str) -> None:
    item = cube().to_dict()["objects"][0]
    with pytest.raises(st.SceneError, match=message) as caught:
        cube(objects=[{**item, "mesh": mesh}])
    assert [problem.path for problem in caught.value.problems] == [f"objects.0.mesh.{path}"]
