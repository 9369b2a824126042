"""PLY files: all number formats, polygons of different lengths, colours and texture coordinates."""

from __future__ import annotations

import struct
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from tests.helpers.mesh_files import area_of, read, refusal

# A unit square beside a triangle, an L of area 3 far away, and a hexagon that stands on edge.
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0),
          (10, 0, 5), (12, 0, 5), (12, 1, 5), (11, 1, 5), (11, 2, 5), (10, 2, 5)]  # fmt: skip
FACES = [(0, 1, 2, 3), (1, 4, 2), (5, 6, 7, 8, 9, 10)]
AREA = 1 + 0.5 + 3


def ply(form: str, *, index: str = "int", length: str = "uchar", coordinate: str = "float", header: str = "") -> bytes:
    """Return a file with a scalar before and after the list of every face."""
    lines = ["ply", f"format {form} 1.0", "comment made by hand", f"element vertex {len(POINTS)}"]
    lines += [f"property {coordinate} {axis}" for axis in "xyz"]
    lines += [f"element face {len(FACES)}", "property uchar flags", f"property list {length} {index} vertex_indices",
              "property short quality", *([header] if header else []), "end_header"]  # fmt: skip
    head = "\n".join(lines).encode() + b"\n"
    if form == "ascii":
        text = "".join(" ".join(map(str, point)) + "\n" for point in POINTS)
        text += "".join(f"7 {len(face)} {' '.join(map(str, face))} -3\n" for face in FACES)
        return head + text.encode()
    order = "<" if "little" in form else ">"
    letters = {"int": "i", "uint": "I", "ushort": "H", "uchar": "B", "float": "f", "double": "d", "short": "h"}
    data = b"".join(struct.pack(order + 3 * letters[coordinate], *point) for point in POINTS)
    for face in FACES:
        data += struct.pack(order + "B" + letters[length], 7, len(face))
        data += struct.pack(order + len(face) * letters[index], *face) + struct.pack(order + "h", -3)
    return head + data


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kinds", [("int", "uchar", "float"), ("uint", "int", "double"), ("uchar", "ushort", "float")])
def test_polygons_of_different_lengths(tmp_path: Path, form: str, kinds: tuple[str, str, str]) -> None:
    mesh = read(tmp_path / "mixed.ply", ply(form, index=kinds[0], length=kinds[1], coordinate=kinds[2]))
    assert area_of(mesh) == pytest.approx(AREA)
    np.testing.assert_array_equal(mesh.vertices_mm, POINTS)
    assert len(mesh.faces) == 2 + 1 + 4


def test_binary_files_end_where_their_header_says(tmp_path: Path) -> None:
    whole = ply("binary_little_endian")
    assert 'ends within the element "face"' in refusal(tmp_path / "cut.ply", whole[:-1])
    assert 'ends within the element "vertex"' in refusal(
        tmp_path / "short.ply", whole[: whole.index(b"end_header") + 30]
    )
    mesh = read(tmp_path / "more.ply", whole + b"rest")
    assert any("4 bytes behind the last element" in note for note in mesh.file_notes)
    assert "2 more values" in refusal(tmp_path / "more.ply", ply("ascii") + b"1 2\n")


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"3 1 4 2", b"3 1 44 2", "face 2 refers to vertex 44, counted from 0: there are 11"),
        (b"3 1 4 2", b"3 1 -1 2", "face 2 refers to vertex -1"),
        (b"3 1 4 2", b"2 1 4", "face 2 has 2 corners"),
        (b"2 0 0\n", b"2 0 x\n", "not a number"),
        (b"property list", b"property lists", "no statement of PLY"),
        (b"format ascii 1.0", b"format ascii 2.0", "no statement of PLY"),
        (b"element face 3", b"element tristrips 3", "triangle strips"),
        (b"property float z", b"property float w", "no vertices with x, y and z"),
        (b"vertex_indices", b"corners", "no faces"),
        (b"end_header", b"end", "no header"),
    ],
)
def test_what_is_no_mesh_is_refused(tmp_path: Path, old: bytes, new: bytes, reason: str) -> None:
    content = ply("ascii")
    assert old in content
    assert reason in refusal(tmp_path / "wrong.ply", content.replace(old, new))


def triangle(vertex: str, values: list[str], face: str = "", face_values: str = "", head: str = "") -> str:
    lines = ["ply", "format ascii 1.0", *([head] if head else []), "element vertex 3", "property float x",
             "property float y", "property float z", *vertex.splitlines(), "element face 1",
             "property list uchar int vertex_index", *face.splitlines(), "end_header"]  # fmt: skip
    places = ["0 0 0", "1 0 0", "0 1 0"]
    lines += [f"{place} {value}" for place, value in zip(places, values, strict=True)]
    return "\n".join([*lines, f"3 0 1 2 {face_values}", ""])


@pytest.mark.parametrize(("kind", "full"), [("uchar", 255), ("ushort", 65535), ("float", 1.0)])
def test_colours_have_the_range_of_their_type(tmp_path: Path, kind: str, full: float) -> None:
    names = "\n".join(f"property {kind} {name}" for name in ("red", "green", "blue"))
    mesh = read(tmp_path / "a.ply", triangle(names, ["0 0 0", f"{full} {full} {full}", f"0 {full} 0"]))
    assert mesh.appearance is not None
    np.testing.assert_allclose(mesh.appearance.radiances(None), [[0, 1, 0.7152]])
    mesh = read(tmp_path / "b.ply", triangle("", ["", "", ""], names, f"{full} 0 0"))
    assert mesh.appearance is not None
    np.testing.assert_allclose(mesh.appearance.radiances(None), [[0.2126] * 3])


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_and_their_picture(tmp_path: Path, names: tuple[str, str]) -> None:
    values = np.array([[10, 60], [120, 250]], dtype=np.uint8)
    imageio.imwrite(tmp_path / "a grey.png", values)
    head = "comment TextureFile a grey.png"
    own = triangle("\n".join(f"property float {name}" for name in names), ["0 0", "1 0", "0 1"], head=head)
    by_face = triangle("", ["", "", ""], "property list uchar float texcoord", "6 0 0 1 0 0 1", head)
    for text in (own, by_face):
        mesh = read(tmp_path / "uv.ply", text)
        assert mesh.uv is not None
        np.testing.assert_array_equal(mesh.uv[0], [[0, 1], [1, 1], [0, 0]])
        assert mesh.appearance is not None
        np.testing.assert_allclose(mesh.appearance.lay(None).values, values / 255, atol=1e-7)
    mesh = read(tmp_path / "uv.ply", own.replace("a grey", "another"))
    assert mesh.appearance is not None
    with pytest.raises(ValueError, match=r'picture "another\.png" is missing'):
        mesh.appearance.lay(None)
