"""Mutated mesh files: refused with our own error, or read as a plain reader reads them."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenetruth.errors import SceneError
from scenetruth.scene.mesh import load_mesh_file, make_box, make_sphere
from tests.helpers.mesh_files import gltf
from tests.helpers.nightly import NIGHTLY
from tests.helpers.plain_mesh_readers import PLAIN_READERS, figures_of

CASES, NIGHTLY_CASES = 60, 1000
_SLOWEST_S = 5.0
# Words that change the meaning of a text.
WORDS = [b"0", b"-1", b"1e400", b"nan", b"inf", b"-", b"/", b"//", b"1/1", b"99999999999999999999", b"null", b"1.5"]
WORDS += [
    b"\t",
    b"\r",
    b"\0",
    b"#",
    b"\\\n",
    b"v",
    b"f",
    b"vt",
    b"vn",
    b"{}",
    b"[]",
    b'"',
    b"\xff",
    b"list",
    b"element",
]


def originals() -> dict[str, list[bytes]]:
    """Return good files of every format."""
    box, ball = make_box((3, 4, 5)), make_sphere(10, 9.0)
    found: dict[str, list[bytes]] = {name: [] for name in PLAIN_READERS}
    quads = [(0, 1, 2, 3), (4, 5, 6, 7, 8, 9)]
    flat = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (5, 0, 1),
        (7, 0, 1),
        (7, 1, 1),
        (6, 1, 1),
        (6, 2, 1),
        (5, 2, 1),
    ]
    for vertices, faces in ((box.vertices_mm, box.faces), (ball.vertices_mm, ball.faces), (np.array(flat), quads)):
        lines = ["v {:g} {:g} {:g}".format(*vertex) for vertex in vertices]
        found["obj"].append(
            "\n".join([*lines, *("f " + " ".join(str(n + 1) for n in face) for face in faces), ""]).encode()
        )
        plain = ["{:g} {:g} {:g}".format(*vertex) for vertex in vertices]
        listed = [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
        found["off"].append("\n".join(["OFF", f"{len(vertices)} {len(faces)} 0", *plain, *listed, ""]).encode())
        for form in ("ascii", "binary_little_endian", "binary_big_endian"):
            head = ["ply", f"format {form} 1.0", f"element vertex {len(vertices)}"]
            head += [*(f"property double {c}" for c in "xyz"), f"element face {len(faces)}"]
            head += ["property list uchar int vertex_indices", "end_header", ""]
            order = "<" if "little" in form else ">"
            data = "\n".join([*plain, *listed, ""]).encode()
            if form != "ascii":
                data = b"".join(struct.pack(order + "3d", *vertex) for vertex in vertices)
                data += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
            found["ply"].append("\n".join(head).encode() + data)
    for mesh in (box, ball):
        corners = mesh.vertices_mm[mesh.faces].astype(np.float32)
        data = b"".join(struct.pack("<3f", 0, 0, 0) + own.tobytes() + b"\0\0" for own in corners)
        found["stl"].append(bytes(80) + struct.pack("<I", len(corners)) + data)
        arrays: dict[str, Any] = {
            "points": mesh.vertices_mm.astype(np.float32),
            "index": mesh.faces.astype(np.uint16).reshape(-1),
        }
        primitive = {"attributes": {"POSITION": "@points"}, "indices": "@index", "mode": 4}
        found["gltf"].append(
            gltf(arrays, primitive, nodes=[{"mesh": 0, "scale": [1, 2, 3], "translation": [5, 0, 0]}]).encode()
        )
    return found


def mutated(content: bytes, generator: np.random.Generator) -> bytes:
    """Return a file with one to three changes."""
    for _ in range(generator.integers(1, 4)):
        at = int(generator.integers(len(content)))
        kind = generator.integers(6)
        if kind == 0:
            content = content[:at] + bytes([content[at] ^ (1 << int(generator.integers(8)))]) + content[at + 1 :]
        elif kind == 1:
            content = content[:at] + content[at + int(generator.integers(1, 9)) :]
        elif kind == 2:
            content = content[:at] + WORDS[int(generator.integers(len(WORDS)))] + content[at:]
        elif kind == 3:
            line = content.splitlines(keepends=True)
            n, m = generator.integers(len(line), size=2)
            line[n], line[m] = line[m], line[n]
            content = b"".join(line)
        elif kind == 4:
            content = content[:at] if generator.random() < 0.3 else content + content[at : at + 20]
        else:
            # A number for another.
            word = str(int(generator.integers(-3, 300))).encode()
            places = [n for n, byte in enumerate(content) if 48 <= byte <= 57]
            if places:
                n = places[int(generator.integers(len(places)))]
                content = content[:n] + word + content[n + 1 :]
        content = content or b"\0"
    return content


@pytest.mark.parametrize("form", list(PLAIN_READERS))
def test_mutated_files(tmp_path: Path, form: str) -> None:
    generator = np.random.default_rng([len(form), *form.encode()])
    good = originals()[form]
    for content in good:
        check(tmp_path / f"good.{form}", content, form, must_be_read=True)
    read = 0
    for n in range(NIGHTLY_CASES if NIGHTLY else CASES):
        content = mutated(good[n % len(good)], generator)
        read += check(tmp_path / f"mutated.{form}", content, form)
    assert read > 0


def check(file: Path, content: bytes, form: str, *, must_be_read: bool = False) -> bool:
    """Return whether a file was read, after comparison with the plain reader."""
    file.write_bytes(content)
    begun = time.process_time()
    try:
        mesh = load_mesh_file(file)
    except SceneError:
        assert not must_be_read
        return False
    assert time.process_time() - begun < _SLOWEST_S
    try:
        area, low, high = figures_of(PLAIN_READERS[form](content))
    except (
        ValueError,
        IndexError,
        KeyError,
        TypeError,
        struct.error,
        UnicodeDecodeError,
        StopIteration,
        AttributeError,
    ):
        # What is no plain file, as one with an additional byte, may still be read.
        assert not must_be_read
        return True
    size = float(np.linalg.norm(high - low))
    used = mesh.vertices_mm
    np.testing.assert_allclose(
        [used.min(axis=0), used.max(axis=0)], [low, high], atol=1e-6 * size, err_msg=repr(content)
    )
    corners = mesh.vertices_mm[mesh.faces]
    double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    found = 0.5 * float(np.linalg.norm(double, axis=1).sum())
    # Polygons that are not plane have triangles with a larger area.
    plane = not any("not plane" in note for note in mesh.file_notes)
    assert found == pytest.approx(area, rel=1e-5) if plane else found >= area * (1 - 1e-5), content
    return True
