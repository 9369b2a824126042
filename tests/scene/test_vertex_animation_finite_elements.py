"""The finite elements behind scenes/finite_elements.yaml."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.scene import load_scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import load_mesh_file
from tests.helpers.nightly import nightly
from tests.helpers.scenes import SCENES

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def fe() -> Any:
    spec = importlib.util.spec_from_file_location("make_finite_elements", SCENES / "make_finite_elements.py")
    assert spec is not None
    assert spec.loader is not None
    module: ModuleType = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_script_makes_the_files(fe: Any) -> None:
    nodes, triangles, displacements = fe.states(fe.Plate())
    stored = np.load(SCENES / "finite_elements" / "displacements.npy")
    # Solvers of other machines add up in another order.
    np.testing.assert_allclose(stored, displacements, rtol=1e-9, atol=1e-9 * np.abs(displacements).max())
    mesh = load_mesh_file(SCENES / "finite_elements" / "plate.obj")
    # Written with ten digits.
    np.testing.assert_allclose(mesh.vertices_mm, np.column_stack([nodes, np.zeros(len(nodes))]), atol=1e-8)
    assert (np.sort(mesh.faces, axis=1) == np.sort(triangles, axis=1)).all()
    sizes = [file.stat().st_size for file in (SCENES / "finite_elements").iterdir()]
    assert sum(sizes) < 200_000


def test_the_plate_is_whole_and_faces_the_camera(fe: Any) -> None:
    mesh = load_mesh_file(SCENES / "finite_elements" / "plate.obj")
    corners = mesh.vertices_mm[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert (normals[:, 2] < 0).all()
    # The hole is a polygon whose corners are not evenly spaced.
    assert -normals[:, 2].sum() == pytest.approx(72 * 52 - np.pi * 9**2, rel=1e-3)


def inner_nodes(fe: Any, nodes: Array, triangles: Any) -> Any:
    edges, sides = fe.edges_of(triangles)
    border = edges[np.bincount(sides.ravel()) == 1]
    inner = np.ones(len(nodes), dtype=bool)
    inner[border.ravel()] = False
    return inner


def test_constant_strain_is_in_balance(fe: Any) -> None:
    plate = fe.Plate()
    nodes, triangles = fe.mesh(plate)
    inner = inner_nodes(fe, nodes, triangles)
    gradient = np.array([[0.01, 0.004], [-0.002, 0.02]])
    forces = (fe.membrane(plate, nodes, triangles) @ (nodes @ gradient.T).ravel()).reshape(-1, 2)
    # Stiffness 4, displacements 1, both rounded; the border carries the stress.
    np.testing.assert_allclose(forces[inner], 0, atol=1e-13)
    assert np.abs(forces[~inner]).max() > 1e-2


def test_constant_curvature_is_in_balance_and_has_its_energy(fe: Any) -> None:
    plate = fe.Plate()
    nodes, triangles = fe.mesh(plate)
    edges, sides = fe.edges_of(triangles)
    xx, xy, yy = 0.003, -0.002, 0.001
    along = np.diff(nodes[edges], axis=1)[:, 0]
    normal = along @ np.array([[0.0, -1], [1, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    middle = nodes[edges].mean(axis=1)
    slope = middle @ np.array([[xx, xy], [xy, yy]])
    x, y = nodes.T
    field = np.concatenate([(xx * x * x + 2 * xy * x * y + yy * y * y) / 2, np.einsum("ij,ij->i", slope, normal)])
    stiffness = fe.bending(plate, nodes, triangles)
    forces = stiffness @ field
    inner_edges = np.bincount(sides.ravel()) == 2
    inner = np.concatenate([inner_nodes(fe, nodes, triangles), inner_edges])
    np.testing.assert_allclose(forces[inner], 0, atol=1e-13)
    rigidity = plate.young_mpa * plate.thickness_mm**3 / 12 / (1 - plate.poisson**2)
    density = xx**2 + yy**2 + 2 * plate.poisson * xx * yy + 2 * (1 - plate.poisson) * xy**2
    area = np.abs(fe.doubled_areas(nodes, triangles)).sum() / 2
    assert field @ forces == pytest.approx(rigidity * density * area, rel=1e-12)


@nightly
def test_strain_at_a_small_hole_is_three_times_that_far_away(fe: Any) -> None:
    found = []
    for spacing, rings in ((12, 12), (6, 24), (3, 48)):
        plate = fe.Plate(size_mm=(240, 240), hole_mm=6, spacing_mm=spacing, rings=rings, poisson=0.0)
        nodes, triangles = fe.mesh(plate)
        moved, _ = fe.pulled_and_bent(plate, nodes, triangles)
        count = len(nodes) // (rings + 1)
        ends = np.column_stack([np.arange(count), (np.arange(count) + 1) % count])
        sides, middles = np.diff(nodes[ends], axis=1)[:, 0], nodes[ends].mean(axis=1)
        strain = np.einsum("ij,ij->i", np.diff(moved[ends], axis=1)[:, 0], sides) / (sides**2).sum(axis=1)
        far = 1 / plate.thickness_mm / plate.young_mpa
        # The node at the top of the hole has an edge on either side.
        top = np.argsort(-middles[:, 1])[:2]
        found.append(strain[top].mean() / far)
    # Kirsch: 3; of a plate 20 times as wide as the hole 3.01 (Howland 1930), with no strain across its clamped edge.
    assert found[-1] == pytest.approx(3.0, abs=0.1), found
    assert abs(found[-1] - 3) < abs(found[0] - 3)


def test_a_narrow_plate_bends_like_a_beam(fe: Any) -> None:
    plate = fe.Plate(size_mm=(120, 20), hole_mm=0.5, spacing_mm=2, rings=16, poisson=0.0)
    nodes, triangles = fe.mesh(plate)
    _, bent = fe.pulled_and_bent(plate, nodes, triangles)
    # q L³ / (3 E I / width); elements are long and thin along the beam.
    expected = 120**3 / (3 * plate.young_mpa * plate.thickness_mm**3 / 12)
    assert bent[np.isclose(nodes[:, 0], 60)].mean() == pytest.approx(expected, rel=0.02)


@nightly
def test_the_scene_moves_as_the_array_says() -> None:
    scene = load_scene(SCENES / "finite_elements.yaml")
    body = build_scene(scene).bodies[0]
    stored = np.load(SCENES / "finite_elements" / "displacements.npy")
    cosine, sine = np.cos(np.deg2rad(8)), np.sin(np.deg2rad(8))
    rest = body.at(-4).positions_mm
    for t, move in zip(scene.frames.t, stored, strict=True):
        x, y, z = move.T
        turned = np.column_stack([cosine * x + sine * z, y, -sine * x + cosine * z])
        np.testing.assert_allclose(body.at(float(t)).positions_mm - rest, turned, atol=1e-12)
