"""Triangles that stand twice, and components without a common orientation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.raycast import Topology
from scenetruth.scene.mesh import make_box, make_sphere, repair_topology
from tests.helpers.mesh_files import read, volume_of


def written(vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices]
    return "\n".join([*lines, *("f {} {} {}".format(*(face + 1)) for face in faces)])


@pytest.mark.parametrize("reversed_", [False, True])
def test_two_sided_cards_are_smooth_inside(tmp_path: Path, reversed_: bool) -> None:
    ball = make_sphere(10, 3.0)
    again = ball.faces[:, ::-1] if reversed_ else ball.faces
    mesh = read(tmp_path / "twice.obj", written(ball.vertices_mm, np.concatenate([ball.faces, again])))
    assert len(mesh.faces) == len(ball.faces)
    topology = Topology.of(mesh.vertices_mm, mesh.faces, mesh.crease_deg)
    # Every edge has two triangles and is no crease.
    assert (topology.edge_faces >= 0).all()
    assert any(f"{len(ball.faces):,} triangles that stand twice" in note for note in mesh.file_notes)


@given(some.integers(0, 2**32 - 1), some.floats(0.0, 0.45))
def test_random_windings_are_mended(seed: int, share: float) -> None:
    generator = np.random.default_rng(seed)
    ball = make_sphere(10, 5.0)
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices_mm)]).astype(np.int64)
    vertices = np.concatenate([ball.vertices_mm, ball.vertices_mm + [40, 0, 0]])
    wrong = generator.random(len(faces)) < share
    faces[wrong] = faces[wrong][:, ::-1]
    found = repair_topology(vertices, faces)
    assert (found.components, found.one_sided, found.open_edges) == (2, 0, 0)
    mended = np.where(found.turned[:, None], faces[:, ::-1], faces)
    for ball_faces, middle in ((mended[: len(ball.faces)], [0, 0, 0]), (mended[len(ball.faces) :], [40, 0, 0])):
        volumes = np.linalg.det(vertices[ball_faces] - middle)
        assert (volumes > 0).all() or (volumes < 0).all()
        # The majority of a component decides.
        if share < 0.3:
            assert (volumes > 0).all()


def test_meshes_of_one_winding_stay_as_they_are(tmp_path: Path) -> None:
    box = make_box((3, 4, 5))
    mesh = read(tmp_path / "box.obj", written(box.vertices_mm, box.faces))
    np.testing.assert_array_equal(mesh.vertices_mm[mesh.faces], box.vertices_mm[box.faces])
    inside_out = read(tmp_path / "out.obj", written(box.vertices_mm, box.faces[:, ::-1]))
    assert volume_of(inside_out) == pytest.approx(-volume_of(mesh))


def test_a_moebius_strip_is_named(tmp_path: Path) -> None:
    count = 12
    angle = np.arange(count) * 2 * np.pi / count
    middle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    across = 0.3 * np.column_stack(
        [np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)]
    )
    vertices = np.concatenate([middle + across, middle - across])
    faces = []
    for n in range(count):
        a, b = n, n + count
        c, d = ((n + 1) % count, (n + 1) % count + count) if n < count - 1 else (count, 0)
        faces += [[a, c, d], [a, d, b]]
    mesh = read(tmp_path / "strip.obj", written(vertices, np.array(faces)))
    assert any("1 components without two sides" in note for note in mesh.file_notes)


def test_edges_of_three_triangles_are_named(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 0 0 1\nv 1 0 0\nv 0 1 0\nv -1 -1 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n"
    mesh = read(tmp_path / "fin.obj", text)
    assert any("1 edges of more than two triangles" in note for note in mesh.file_notes)
