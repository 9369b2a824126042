"""STL and OFF files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.mesh_files import area_of, read, refusal, volume_of

# Tetrahedron of three unit edges at right angles: 1.5 + sqrt(3) / 2, volume 1 / 6.
CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
SIDES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
AREA, VOLUME = 1.5 + 3**0.5 / 2, 1 / 6


def binary(header: bytes = b"", tail: bytes = b"") -> bytes:
    data = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(float(c) for corner in side for c in CORNERS[corner]), 0) for side in SIDES
    )
    return header.ljust(80, b"\0") + struct.pack("<I", len(SIDES)) + data + tail


def ascii_stl() -> str:
    lines = ["solid thing"]
    for side in SIDES:
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += ["  vertex {} {} {}".format(*CORNERS[corner]) for corner in side]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid thing", ""])


@pytest.mark.parametrize(
    "content",
    [binary(), binary(b"solid by a program"), binary(tail=b"\0" * 7), binary(tail=b"\r\n"), binary(tail=b"\1" * 50),
     ascii_stl(), ascii_stl().upper(), ascii_stl().replace("\n", "\r\n"), 2 * ascii_stl()],
)  # fmt: skip
def test_stl(tmp_path: Path, content: str | bytes) -> None:
    mesh = read(tmp_path / "a.stl", content)
    assert area_of(mesh) == pytest.approx(AREA)
    assert volume_of(mesh) == pytest.approx(VOLUME)
    assert any("1 components, closed" in note for note in mesh.file_notes)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (binary()[:-1], "declares 4 triangles and has 3: it is cut off"),
        (b"\0" * 60, "neither an ASCII nor a binary"),
        (ascii_stl().replace(" endloop", "  vertex 1 1 1\n endloop", 1), "facet 1 of 4 is not a triangle"),
        (ascii_stl()[:-60], "facet 4 of 4 is not a triangle"),
        (ascii_stl().replace("vertex 1 0 0", "vertex 1 0 x", 1), "not a number"),
        (binary()[:80] + struct.pack("<I", 0), "no faces"),
    ],
)
def test_stl_that_is_refused(tmp_path: Path, content: str | bytes, reason: str) -> None:
    assert reason in refusal(tmp_path / "a.stl", content)


def off(head: str = "OFF\n4 4 6\n", points: list[str] | None = None, faces: list[str] | None = None) -> str:
    points = ["{} {} {}".format(*corner) for corner in CORNERS] if points is None else points
    faces = ["3 {} {} {}".format(*side) for side in SIDES] if faces is None else faces
    return head + "\n".join([*points, *faces, ""])


@pytest.mark.parametrize(
    "content",
    [
        off(),
        off("OFF 4 4 6\n"),
        off("# made by hand\nOFF # of type\n\n4 4 0 # counts\n"),
        off("4 4 6\n"),
        off("COFF\n4 4 6\n", ["{} {} {} 255 0 0 255".format(*corner) for corner in CORNERS]),
        off("NOFF\n4 4 6\n", ["{} {} {} 0 0 1".format(*corner) for corner in CORNERS]),
        off("STOFF\n4 4 6\n", ["{} {} {} 0.5 0.5".format(*corner) for corner in CORNERS]),
        off(faces=["3 {} {} {} 0.25 0.5 0.5".format(*side) for side in SIDES]),
    ],
)
def test_off(tmp_path: Path, content: str) -> None:
    mesh = read(tmp_path / "a.off", content)
    assert area_of(mesh) == pytest.approx(AREA)
    assert volume_of(mesh) == pytest.approx(VOLUME)
    np.testing.assert_array_equal(mesh.vertices_mm, CORNERS)


def test_off_polygons_and_colours(tmp_path: Path) -> None:
    shape = ["0 0 0", "2 0 0", "2 1 0", "1 1 0", "1 2 0", "0 2 0"]
    mesh = read(tmp_path / "l.off", off("OFF\n6 1 0\n", shape, ["6 0 1 2 3 4 5 0 255 0"]))
    assert area_of(mesh) == pytest.approx(3)
    assert mesh.appearance is not None
    np.testing.assert_allclose(mesh.appearance.radiances(None), 0.7152)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (off("4OFF\n4 4 6\n"), "four or more dimensions"),
        (off("OFF BINARY\n4 4 6\n"), "binary OFF"),
        (off("OFF\n5 4 6\n"), "declares 5 vertices and 4 faces and has 8 lines"),
        (off("OFF\n3 4 6\n"), "face 1"),
        (off(faces=["3 0 1 2", "3 0 1 4", "3 0 1 2", "3 0 1 2"]), "face 2 refers to vertex 4"),
        (off(faces=["3 0 1 2", "4 0 1 2", "3 0 1 2", "3 0 1 2"]), 'face 2 has "4" corners and 3 numbers'),
        (off(points=["0 0 0", "1 0 0", "0 1 0", "0 0"]), "vertex 4 has 2 numbers"),
        (off("COFF\n4 4 6\n", ["{} {} {} 300 0 0 255".format(*corner) for corner in CORNERS]), "colours outside"),
        ("OFF\n", "no numbers of vertices"),
    ],
)
def test_off_that_is_refused(tmp_path: Path, content: str, reason: str) -> None:
    assert reason in refusal(tmp_path / "a.off", content)
