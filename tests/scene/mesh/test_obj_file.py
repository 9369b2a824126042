"""OBJ files: indices, polygons, text and materials as their specification has them."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from scenetruth.scene.mesh import load_mesh_file
from tests.helpers.mesh_files import area_of, read, refusal

SQUARE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\n"
L_SHAPE = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n"


def test_concave_polygons_keep_their_area(tmp_path: Path) -> None:
    # A fan around the first corner would cover 4.
    for first in range(6):
        order = " ".join(str((first + k) % 6 + 1) for k in range(6))
        mesh = read(tmp_path / "l.obj", f"{L_SHAPE}f {order}\n")
        assert area_of(mesh) == pytest.approx(3.0)
        assert len(mesh.faces) == 4
    # An arrow whose notch is its first corner, in the plane z = x: by the cross product of its diagonals.
    arrow = "v 1 1 1\nv 4 0 4\nv 0 0 0\nv 0 4 0\n"
    exact = 0.5 * float(np.linalg.norm(np.cross([1, 1, 1], [4, -4, 4])))
    assert area_of(read(tmp_path / "arrow.obj", arrow + "f 1 2 3 4\n")) == pytest.approx(exact)


def test_polygons_that_intersect_themselves_are_refused_by_number(tmp_path: Path) -> None:
    assert "face 2 of 2 intersects itself" in refusal(tmp_path / "bow.obj", SQUARE + "f 1 2 3\nf 1 2 4 3\n")


def test_negative_indices_count_back_from_their_face(tmp_path: Path) -> None:
    block = "v {0} 0 0\nv {1} 0 0\nv {1} 1 0\nv {0} 1 0\nf -4 -3 -2 -1\n"
    text = "".join(block.format(3 * n, 3 * n + 1) for n in range(4))
    mesh = read(tmp_path / "blocks.obj", text)
    assert area_of(mesh) == pytest.approx(4.0)
    assert len(mesh.faces) == 8
    assert np.ptp(mesh.vertices_mm[:, 0]) == 10


@pytest.mark.parametrize(
    ("index", "reason"), [("0", "indices begin at 1"), ("5", "there are 4"), ("-5", "there are 4 before it")]
)
def test_indices_that_do_not_exist_are_refused(tmp_path: Path, index: str, reason: str) -> None:
    message = refusal(tmp_path / "wrong.obj", SQUARE + f"f 1 2 3\nf 1 2 {index}\n")
    assert f"face 2 refers to vertex {index}: {reason}" in message


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("byte-order mark", "\ufeff" + SQUARE + "f 1 2 3 4\n"),
        ("tabs", SQUARE.replace(" ", "\t") + "f\t1\t2\t3\t4\n"),
        ("indents", "".join(f"   {line}\n" for line in (SQUARE + "f 1 2 3 4").splitlines())),
        ("comments", SQUARE.replace("\n", " # corner\n") + "f 1 2 3 4# face\n"),
        ("continued", SQUARE + "f 1 2 \\\n 3 4\n"),
        ("continued, Windows", (SQUARE + "f 1 2 \\\n 3 4\n").replace("\n", "\r\n")),
        ("old Macintosh", (SQUARE + "f 1 2 3 4\n").replace("\n", "\r")),
        ("no end of line", SQUARE + "f 1 2 3 4"),
        ("slashes", SQUARE + "vt 0 0\nf 1/ 2/ 3/ 4/\n"),
        ("mixed corners", SQUARE + "vt 0 0\nvn 0 0 1\nf 1/1/1 2//1 3/1 4\n"),
        ("exponents", SQUARE.replace("2", "2.0e+0") + "f 1 2 3 4\n"),
        ("weights", SQUARE.replace(" 0\n", " 0 1.0\n") + "f 1 2 3 4\n"),
        ("groups", "o thing\ng a b\ns off\n" + SQUARE + "f 1 2 3 4\nl 1 2\np 3\n"),
        ("repeated corner", SQUARE + "f 1 2 2 3 4 4\n"),
    ],
)
def test_ways_to_write_a_square(tmp_path: Path, name: str, text: str) -> None:
    mesh = read(tmp_path / "square.obj", text)
    assert area_of(mesh) == pytest.approx(4.0), name
    assert len(mesh.vertices_mm) == 4


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (SQUARE.replace("2 2 0", "2,5 2 0") + "f 1 2 3 4\n", 'has "2,5", which is not a number; use a decimal point'),
        (SQUARE + "f 1 2\n", "face 1 has 2 corners"),
        (SQUARE + "f 1 2 x\n", 'face 1 has the corner "x"'),
        (SQUARE + "f 1/1/1/1 2 3\n", 'face 1 has the corner "1/1/1/1"'),
        (SQUARE + "f 1/1 2/1 3/1\n", "texture coordinate 1: there are 0"),
        ("cstype bezier\n" + SQUARE + "f 1 2 3\n", "free-form geometry"),
        ("v 0 0 0 2\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n", "rational"),
        (SQUARE + "v 1 2\nf 1 2 3\n", "line 5 of those with v has 2 numbers"),
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "1 vertices that are not finite"),
        (SQUARE, "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "zero area"),
    ],
)
def test_what_is_no_mesh_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    assert reason in refusal(tmp_path / "wrong.obj", text)
    with pytest.raises(Exception, match="UTF-16"):
        read(tmp_path / "wide.obj", (SQUARE + "f 1 2 3\n").encode("utf-16"))


def test_vertices_keep_their_order(tmp_path: Path) -> None:
    # With texture seams and normals, vertices are not divided.
    text = SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\nf 1/1 2/2 3/3\nf 1/5 3/1 4/4\n"
    mesh = read(tmp_path / "seam.obj", text)
    np.testing.assert_array_equal(mesh.vertices_mm, [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    assert mesh.uv is not None
    # v increases downwards.
    np.testing.assert_array_equal(mesh.uv[1], [[0.5, 0.5], [0, 1], [0, 0]])


UV = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"


def grey_picture(folder: Path, name: str) -> np.ndarray:
    """Write a picture of four grey values; returns them from 0 to 1."""
    values = np.array([[10, 60], [120, 250]], dtype=np.uint8)
    imageio.imwrite(folder / name, values)
    return values / 255.0


@pytest.mark.parametrize(
    ("statement", "name"),
    [
        ("map_Kd grey.png", "grey.png"),
        ('map_Kd "grey one.png"', "grey one.png"),
        ("map_Kd grey%20one.png", "grey one.png"),
        ("map_Kd grey one.png", "grey one.png"),
        ("map_Kd textures\\grey.png", "textures/grey.png"),
        ("map_Kd -blendu on -blendv off -mm 0 1 -bm 0.2 -texres 1024 -imfchan l grey.png", "grey.png"),
        ("map_Kd -s 1 1 1 -o 0 0 0 -t 0 0 0 grey.png", "grey.png"),
        ("map_Kd -s 1 -o 0.0 grey.png", "grey.png"),
        ("\tmap_Kd\tgrey.png", "grey.png"),
    ],
)
def test_pictures_of_materials_are_found(tmp_path: Path, statement: str, name: str) -> None:
    (tmp_path / "textures").mkdir()
    values = grey_picture(tmp_path, name)
    (tmp_path / "m.mtl").write_bytes(b"\xef\xbb\xbf" + f"newmtl leaf\nKd 1 1 1\n{statement}\n".encode())
    mesh = read(tmp_path / "square.obj", "mtllib m.mtl\n" + SQUARE + UV + "usemtl leaf\n" + FACE)
    assert mesh.appearance is not None
    laid = mesh.appearance.lay(None)
    np.testing.assert_allclose(laid.values, values, atol=1e-7)
    assert laid.tiled


def test_options_move_and_clamp_a_picture(tmp_path: Path) -> None:
    grey_picture(tmp_path, "grey.png")
    (tmp_path / "m.mtl").write_text("newmtl leaf\nmap_Kd -s 2 3 1 -o 0.25 0.5 0 -clamp on grey.png\nKd 0.5 0.5 0.5\n")
    mesh = read(tmp_path / "square.obj", "mtllib m.mtl\n" + SQUARE + UV + "usemtl leaf\n" + FACE)
    assert mesh.appearance is not None
    laid = mesh.appearance.lay(None)
    assert not laid.tiled
    # u = 2 u + 0.25, v = 3 v + 0.5 upwards.
    np.testing.assert_allclose(laid.uv[0], [[0.25, 0.5], [2.25, 0.5], [2.25, -2.5]])
    np.testing.assert_allclose(laid.values[0, 0], 5 / 255, rtol=1e-6)


@pytest.mark.parametrize(
    ("library", "reason"),
    [
        (None, 'material library "m.mtl" is missing'),
        ("newmtl other\nKd 1 1 1\n", "does not have"),
        ("newmtl leaf\nmap_Kd absent.png\n", 'picture "absent.png" is missing'),
        ("newmtl leaf\nmap_Kd -mm 0 2 grey.png\n", "-mm"),
        ("newmtl leaf\nKd 0.5 0.5 0.5\nd 0.5\n", "translucent (opacity 0.5)"),
        ("newmtl leaf\nKd 2 0 0\n", "is not a colour"),
        ("newmtl leaf\nKd 0 0 0\nmap_Kd grey.png\n", "Kd 0 0 0"),
    ],
)
def test_materials_that_cannot_be_shown_say_why_when_they_are_wanted(
    tmp_path: Path, library: str | None, reason: str
) -> None:
    grey_picture(tmp_path, "grey.png")
    if library is not None:
        (tmp_path / "m.mtl").write_text(library)
    mesh = read(tmp_path / "square.obj", "mtllib m.mtl\n" + SQUARE + UV + "usemtl leaf\n" + FACE)
    # The shape is right in any case.
    assert area_of(mesh) == pytest.approx(4.0)
    assert any(reason in note for note in mesh.file_notes)
    assert mesh.appearance is not None
    with pytest.raises(ValueError, match=reason.replace("(", r"\(").replace(")", r"\)")):
        mesh.appearance.lay(None) if mesh.appearance.has_pictures else mesh.appearance.radiances(None)


def test_a_map_of_opacity_is_refused_because_it_outlines_the_surface(tmp_path: Path) -> None:
    grey_picture(tmp_path, "grey.png")
    (tmp_path / "m.mtl").write_text("newmtl leaf\nKd 1 1 1\nmap_Kd grey.png\nmap_d grey.png\n")
    found = refusal(tmp_path / "square.obj", "mtllib m.mtl\n" + SQUARE + UV + "usemtl leaf\n" + FACE)
    assert "(map_d), which is not read; put it into the alpha of map_Kd" in found


def test_colours_of_materials_and_vertices(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl grey\nKd 0.25 0.25 0.25\n")
    text = "mtllib m.mtl\n" + SQUARE + "usemtl red\nf 1 2 3\nusemtl grey\nf 1 3 4\n"
    mesh = read(tmp_path / "two.obj", text)
    assert mesh.appearance is not None
    np.testing.assert_allclose(mesh.appearance.radiances(None), [[0.2126] * 3, [0.25] * 3])
    coloured = "v 0 0 0 0 0 0\nv 1 0 0 1 1 1\nv 0 1 0 0 1 0\nf 1 2 3\n"
    mesh = read(tmp_path / "vertices.obj", coloured)
    assert mesh.appearance is not None
    np.testing.assert_allclose(mesh.appearance.radiances(None), [[0, 1, 0.7152]])


def test_many_faces_are_read_quickly(tmp_path: Path) -> None:
    side = 200
    x, y = np.meshgrid(np.arange(side + 1), np.arange(side + 1))
    lines = [f"v {a} {b} 0" for a, b in zip(x.ravel(), y.ravel(), strict=True)]
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel() + 1
    lines += [f"f {a} {a + 1} {a + side + 2} {a + side + 1}" for a in first]
    (tmp_path / "grid.obj").write_text("\n".join(lines))
    mesh = load_mesh_file(tmp_path / "grid.obj")
    assert len(mesh.faces) == 2 * side**2
    assert area_of(mesh) == pytest.approx(side**2)
