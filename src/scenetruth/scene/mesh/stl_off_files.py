"""STL and OFF files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.file_preflight import MAX_ELEMENTS, read_checked_bytes
from scenetruth.scene.mesh.obj_file import read_text
from scenetruth.scene.mesh.ply_file import check_indices
from scenetruth.scene.mesh.polygon_mesh import MeshFileError, PolygonMesh

__all__ = ["read_off", "read_stl"]

Floats = NDArray[np.float64]

_STL_HEAD, _STL_FACET = 84, 50  # bytes


def read_stl(file: Path) -> PolygonMesh:
    """Read the triangles of an STL file, ASCII or binary.

    Raises
    ------
    MeshFileError
        If a facet is cut off, or is not a triangle.
    """
    content = read_checked_bytes(file).removeprefix(b"\xef\xbb\xbf")
    ignored: tuple[str, ...] = ()
    count = int.from_bytes(content[80:84], "little") if len(content) >= _STL_HEAD else -1
    end = _STL_HEAD + _STL_FACET * count
    # Binary files may begin with "solid", too.
    text = (
        content.lstrip()[:5].lower() == b"solid"
        and re.search(rb"\bfacet\s+normal\b", content[:65536], re.IGNORECASE) is not None
    )
    if text and len(content) != end:
        corners = _text_facets(read_text(content))
    elif len(content) < _STL_HEAD:
        msg = "is neither an ASCII nor a binary STL file"
        raise MeshFileError(msg)
    elif len(content) < end:
        whole = (len(content) - _STL_HEAD) // _STL_FACET
        msg = f"declares {count:,} triangles and has {whole:,}: it is cut off, or no STL file"
        raise MeshFileError(msg)
    else:
        facets = np.frombuffer(content, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")]),
                               count, _STL_HEAD)  # fmt: skip
        corners = facets["corners"].reshape(-1, 3).astype(np.float64)
        ignored = (f"{len(content) - end:,} bytes behind the last triangle",) if len(content) > end else ()
    if not len(corners):
        msg = "has no faces"
        raise MeshFileError(msg)
    return PolygonMesh(
        corners, np.arange(len(corners)), np.arange(0, len(corners) + 1, 3),
        material_of=np.full(len(corners) // 3, -1, dtype=np.int64), ignored=ignored,
    )  # fmt: skip


_FACET = re.compile(
    r"facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop\s+"
    r"vertex\s+(\S+)\s+(\S+)\s+(\S+)\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)\s+"
    r"endloop\s+endfacet\b",
    re.IGNORECASE,
)


def _text_facets(text: str) -> Floats:
    """Return the corners of the triangles of an ASCII file, shape (3 m, 3)."""
    found = _FACET.findall(text)
    declared = len(re.findall(r"(?<!end)\bfacet\s", text, re.IGNORECASE))
    if len(found) != declared:
        spans = [match.span() for match in _FACET.finditer(text)]
        good = 0
        for (start, end), begun in zip(spans, re.finditer(r"(?<!end)\bfacet\s", text, re.IGNORECASE), strict=False):
            if not start <= begun.start() < end:
                break
            good += 1
        msg = f"facet {good + 1} of {declared:,} is not a triangle of three vertices, or is cut off"
        raise MeshFileError(msg)
    try:
        return np.array(found, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        msg = f"has a vertex that is not a number: {error}"
        raise MeshFileError(msg) from error


_OFF_HEAD = re.compile(r"^(ST)?(C)?(N)?(4)?(n)?OFF\b")


def read_off(file: Path) -> PolygonMesh:
    """Read the polygons of an OFF file, with normals (NOFF) and colours (COFF, or of faces).

    Raises
    ------
    MeshFileError
        If a count, a number or an index cannot be read without doubt.
    """
    lines = [line.partition("#")[0].split() for line in read_text(read_checked_bytes(file)).splitlines()]
    lines = [words for words in lines if words]
    match = _OFF_HEAD.match(lines[0][0]) if lines else None
    textured, coloured, normal = (bool(match and match[k]) for k in (1, 2, 3))
    if match is not None:
        if match[4] or match[5]:
            msg = "has vertices of four or more dimensions (4OFF, nOFF), which are not read"
            raise MeshFileError(msg)
        lines[0] = lines[0][1:]
        lines = lines if lines[0] else lines[1:]
    if not lines or len(lines[0]) < 2 or not all(re.fullmatch(r"\d{1,18}", word) for word in lines[0][:3]):
        remedy = "; binary OFF is not read" if lines and lines[0][:1] == ["BINARY"] else ""
        msg = f"has no numbers of vertices and faces at its begin{remedy}"
        raise MeshFileError(msg)
    vertices, faces = int(lines[0][0]), int(lines[0][1])
    if max(vertices, faces) > MAX_ELEMENTS:
        msg = f"declares {max(vertices, faces):,} elements; the maximum is {MAX_ELEMENTS:,}"
        raise MeshFileError(msg)
    if len(lines) < 1 + vertices + faces:
        msg = f"declares {vertices:,} vertices and {faces:,} faces and has {len(lines) - 1:,} lines"
        raise MeshFileError(msg)
    if not faces:
        msg = "has no faces"
        raise MeshFileError(msg)
    width = {3 + 3 * normal + n * coloured + 2 * textured for n in (3, 4)}
    rows = lines[1 : 1 + vertices]
    for number, words in enumerate(rows, 1):
        if len(words) not in width or len(words) != len(rows[0]):
            msg = f"vertex {number} has {len(words)} numbers instead of {' or '.join(str(n) for n in sorted(width))}"
            raise MeshFileError(msg)
    values = _parse(rows, "vertex")
    corners, counts, colours = _faces(lines[1 + vertices : 1 + vertices + faces])
    check_indices(corners, counts, vertices)
    left = len(lines) - 1 - vertices - faces
    ignored = [f"{left:,} lines behind the last face"] if left else []
    if colours is None and any(len(words) > 1 + int(words[0]) for words in lines[1 + vertices : 1 + vertices + faces]):
        ignored.append("values behind the corners of faces, which are not red, green and blue of every face")
    if coloured:
        at = 3 + 3 * normal
        colours = _in_unit(values[:, at : at + 3], rows, at)[corners]
    elif colours is not None:
        colours = np.repeat(colours, counts, axis=0)
    return PolygonMesh(
        values[:, :3].copy(),
        corners,
        np.concatenate([[0], np.cumsum(counts)]),
        values[:, -2:][corners] if textured else None,
        values[:, 3:6][corners] if normal else None,
        colours,
        material_of=np.full(faces, -1, dtype=np.int64),
        ignored=tuple(ignored),
    )


def _parse(rows: list[list[str]], name: str) -> Floats:
    try:
        return np.array(rows, dtype=np.float64)
    except ValueError as error:
        msg = f"has a {name} that is not a number: {error}"
        raise MeshFileError(msg) from error


def _faces(rows: list[list[str]]) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats | None]:
    """Return the corners of the faces, their counts, and colours of the faces, if all have one."""
    corners: list[int] = []
    counts, colours = [], []
    for number, words in enumerate(rows, 1):
        if not all(re.fullmatch(r"-?\d{1,18}", word) for word in words[:1]) or not 0 <= int(words[0]) <= len(words) - 1:
            msg = f'face {number} has "{words[0]}" corners and {len(words) - 1} numbers'
            raise MeshFileError(msg)
        count = int(words[0])
        own = words[1 : 1 + count]
        if not all(re.fullmatch(r"-?\d{1,18}", word) for word in own):
            msg = f"face {number} has a corner that is no index"
            raise MeshFileError(msg)
        corners += map(int, own)
        counts.append(count)
        colours.append(words[1 + count :])
    if all(len(each) in (3, 4) for each in colours):
        cut = [each[:3] for each in colours]
        return np.array(corners), np.array(counts), _in_unit(_parse(cut, "colour"), cut, 0)
    return np.array(corners, dtype=np.int64), np.array(counts, dtype=np.int64), None


def _in_unit(colours: Floats, words: list[list[str]], at: int) -> Floats:
    """Return colours from 0 to 1: integers are up to 255, numbers with a decimal point up to 1."""
    whole = all(re.fullmatch(r"\d+", word) for row in words for word in row[at : at + 3])
    colours = colours / 255.0 if whole else colours
    if not ((colours >= 0) & (colours <= 1)).all():
        msg = "has colours outside 0 to 255, or 0.0 to 1.0"
        raise MeshFileError(msg)
    return colours
