"""PLY files: ASCII and binary polygons with normals, colours and texture coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.file_preflight import MAX_ELEMENTS, read_checked_bytes
from scenetruth.scene.mesh.obj_file import describe_absent, find_beside
from scenetruth.scene.mesh.polygon_mesh import FileMaterial, MeshFileError, PolygonMesh, TextureMap

__all__ = ["list_ply_references", "read_ply"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8"},
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_MOST_CORNERS = 100_000  # largest plausible number of corners of a polygon


@dataclass
class _Property:
    """A scalar, or a list with the type of its length."""

    name: str
    kind: str
    length: str | None = None


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class _List:
    """Values of lists one after the other, and their lengths."""

    values: NDArray[Any]
    lengths: Indices


Table = dict[str, "NDArray[Any] | _List"]


def _header(content: bytes) -> tuple[str, list[_Element], list[str], bytes]:
    """Return format, elements, comments, and the data behind the header."""
    # Lines end in a carriage return alone if the first one does: binary data may begin with any byte.
    ends = rb"\r" if re.match(rb"ply[ \t]*\r(?!\n)", content) else rb"\r?\n"
    match = re.match(rb"ply[ \t]*" + ends + rb"(.*?)\bend_header[ \t]*" + ends, content, re.DOTALL)
    if match is None:
        msg = "has no header of a PLY file"
        raise MeshFileError(msg)
    kind, elements, comments = "", list[_Element](), list[str]()
    for line in match[1].decode("utf-8", errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] in ("comment", "obj_info"):
            comments.append(line.split(None, 1)[1] if len(words) > 1 else "")
        elif words[0] == "format" and len(words) == 3 and words[1] in _FORMATS and words[2] == "1.0":
            kind = words[1]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,18}", words[2]):
            elements.append(_Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            elements[-1].properties.append(_Property(words[2], _TYPES[words[1]]))
        elif (
            words[0] == "property"
            and elements
            and len(words) == 5
            and words[1] == "list"
            and {*words[2:4]} <= {*_TYPES}
        ):
            elements[-1].properties.append(_Property(words[4], _TYPES[words[3]], _TYPES[words[2]]))
        else:
            msg = f'has the line "{line[:60]}" in its header, which is no statement of PLY 1.0'
            raise MeshFileError(msg)
    if not kind:
        msg = "names no format in its header"
        raise MeshFileError(msg)
    return kind, elements, comments, content[match.end() :]


def _ends_early(element: _Element) -> MeshFileError:
    return MeshFileError(f'ends within the element "{element.name}", which has {element.count:,} entries')


def _binary_table(element: _Element, data: bytes, at: int, order: str) -> tuple[Table, int]:
    """Return the properties of an element that begins at a byte, and the byte behind it."""
    if not any(each.length for each in element.properties):
        dtype = np.dtype([(f"{n}", order + each.kind) for n, each in enumerate(element.properties)])
        end = at + dtype.itemsize * element.count
        if end > len(data):
            raise _ends_early(element)
        values = np.frombuffer(data, dtype, element.count, at)
        return {each.name: values[f"{n}"] for n, each in enumerate(element.properties)}, end
    # Lists of one length, as usual, have a type for the whole entry.
    quick = _regular_table(element, data, at, order)
    return quick if quick is not None else _irregular_table(element, data, at, order)


def _regular_table(element: _Element, data: bytes, at: int, order: str) -> tuple[Table, int] | None:
    """Return an element whose lists all have the lengths of its first entry, or None."""
    lengths, place = [], at
    for each in element.properties:
        if each.length is None:
            place += np.dtype(each.kind).itemsize
            continue
        size = np.dtype(each.length).itemsize
        if place + size > len(data):
            return None
        count = int(np.frombuffer(data, order + each.length, 1, place)[0])
        if not 0 <= count <= _MOST_CORNERS:
            return None
        lengths.append(count)
        place += size + count * np.dtype(each.kind).itemsize
    parts: list[Any] = []
    left = iter(lengths)
    for n, each in enumerate(element.properties):
        if each.length is None:
            parts.append((f"{n}", order + each.kind))
        else:
            parts += [(f"{n} length", order + each.length), (f"{n}", order + each.kind, (next(left),))]
    dtype = np.dtype(parts)
    end = at + dtype.itemsize * element.count
    if end > len(data):
        return None
    values = np.frombuffer(data, dtype, element.count, at)
    table: Table = {}
    left = iter(lengths)
    for n, each in enumerate(element.properties):
        if each.length is None:
            table[each.name] = values[f"{n}"]
            continue
        count = next(left)
        if not (values[f"{n} length"] == count).all():
            return None
        table[each.name] = _List(values[f"{n}"].reshape(-1), np.full(element.count, count, dtype=np.int64))
    return table, end


def _irregular_table(element: _Element, data: bytes, at: int, order: str) -> tuple[Table, int]:
    """Return an element whose lists differ in length."""
    kinds = [
        (np.dtype(order + each.kind), each.length and np.dtype(order + each.length)) for each in element.properties
    ]
    starts = [np.empty(element.count, dtype=np.int64) for _ in element.properties]
    lengths = [np.ones(element.count, dtype=np.int64) for _ in element.properties]
    for entry in range(element.count):
        for n, (kind, length) in enumerate(kinds):
            if length:
                if at + length.itemsize > len(data):
                    raise _ends_early(element)
                count = int(np.frombuffer(data, length, 1, at)[0])
                if not 0 <= count <= _MOST_CORNERS:
                    msg = f'entry {entry + 1} of the element "{element.name}" has a list of {count} values'
                    raise MeshFileError(msg)
                lengths[n][entry] = count
                at += length.itemsize
            starts[n][entry] = at
            at += int(lengths[n][entry]) * kind.itemsize
            if at > len(data):
                raise _ends_early(element)
    raw = np.frombuffer(data, np.uint8)
    table: Table = {}
    for n, (each, (kind, _)) in enumerate(zip(element.properties, kinds, strict=True)):
        own = lengths[n]
        first = np.repeat(starts[n] - kind.itemsize * (np.cumsum(own) - own), own)
        places = first + kind.itemsize * np.arange(int(own.sum()))
        values = raw[places[:, None] + np.arange(kind.itemsize)].reshape(-1).view(kind)
        table[each.name] = values if each.length is None else _List(values, own)
    return table, at


def _text_table(element: _Element, words: list[bytes], at: int) -> tuple[Table, int]:
    """Return the properties of an element of a text that begins at a word, and the word behind it."""
    found: list[list[bytes]] = [[] for _ in element.properties]
    lengths: list[list[int]] = [[] for _ in element.properties]
    if not any(each.length for each in element.properties):
        width = len(element.properties)
        end = at + width * element.count
        if end > len(words):
            raise _ends_early(element)
        found = [words[at + n : end : width] for n in range(width)]
        at = end
    else:
        for _ in range(element.count):
            for n, each in enumerate(element.properties):
                count = 1
                if each.length is not None:
                    if at >= len(words):
                        raise _ends_early(element)
                    count = _length(words[at], element)
                    lengths[n].append(count)
                    at += 1
                found[n] += words[at : at + count]
                at += count
                if at > len(words):
                    raise _ends_early(element)
    table: Table = {}
    for each, values, sizes in zip(element.properties, found, lengths, strict=True):
        numbers = _numbers(values, each, element)
        table[each.name] = numbers if each.length is None else _List(numbers, np.array(sizes, dtype=np.int64))
    return table, at


def _length(word: bytes, element: _Element) -> int:
    if not re.fullmatch(rb"\d{1,6}", word):
        msg = f'has "{word.decode(errors="replace")[:20]}" as the length of a list of the element "{element.name}"'
        raise MeshFileError(msg)
    return int(word)


def _numbers(words: list[bytes], each: _Property, element: _Element) -> NDArray[Any]:
    kind = np.dtype(each.kind)
    try:
        numbers = np.array([float(word) for word in words], dtype=np.float64)
    except ValueError as error:
        msg = f'has a value of {each.name} in the element "{element.name}" that is not a number: {error}'
        raise MeshFileError(msg) from error
    if kind.kind == "f":
        return numbers
    limits = np.iinfo(kind)
    if not ((numbers == np.rint(numbers)) & (numbers >= limits.min) & (numbers <= limits.max)).all():
        msg = f'has values of {each.name} in the element "{element.name}" that are no integers of type {kind.name}'
        raise MeshFileError(msg)
    return numbers.astype(kind)


def read_ply(file: Path) -> PolygonMesh:
    """Read the polygons of a PLY file.

    Raises
    ------
    MeshFileError
        If the header, the data or an index cannot be read without doubt.
    """
    kind, elements, comments, data = _header(read_checked_bytes(file))
    tables: dict[str, Table] = {}
    words = data.split() if kind == "ascii" else []
    at = 0
    for element in elements:
        if element.count > MAX_ELEMENTS:
            msg = f"declares {element.count:,} elements; the maximum is {MAX_ELEMENTS:,}"
            raise MeshFileError(msg)
        made, at = (
            _text_table(element, words, at) if kind == "ascii" else _binary_table(element, data, at, _FORMATS[kind])
        )
        tables[element.name] = made
    left = len(words) - at if kind == "ascii" else len(data) - at
    unused = [each.name for each in elements if each.name not in ("vertex", "face", "tristrips")]
    ignored = [f"element {name}" for name in unused]
    if left > 0 and not (kind == "ascii" or set(data[at:]) <= {10, 13, 32}):
        ignored.append(f"{left:,} bytes behind the last element")
    elif left > 0 and kind == "ascii":
        msg = f"has {left:,} more values than its header declares"
        raise MeshFileError(msg)
    return _assemble(file, tables, comments, ignored)


def _picture_names(comments: list[str]) -> list[str]:
    return [
        line.split(None, 1)[1] for line in comments if line.lower().startswith("texturefile") and len(line.split()) > 1
    ]


def list_ply_references(file: Path) -> list[Path]:
    """Return the pictures of a PLY file, including those that are missing."""
    names = _picture_names(_header(read_checked_bytes(file))[2])
    return [find_beside(file, name) or file.parent / name for name in names]


def _assemble(file: Path, tables: dict[str, Table], comments: list[str], ignored: list[str]) -> PolygonMesh:
    vertex = tables.get("vertex", {})
    if "tristrips" in tables:
        msg = "has triangle strips, which are not read; export it as polygons"
        raise MeshFileError(msg)
    if not {"x", "y", "z"} <= {*vertex}:
        msg = "has no vertices with x, y and z"
        raise MeshFileError(msg)
    face = tables.get("face", {})
    listed = next((face[name] for name in ("vertex_indices", "vertex_index") if name in face), None)
    if not isinstance(listed, _List) or not len(listed.lengths):
        msg = "has no faces"
        raise MeshFileError(msg)
    if listed.values.dtype.kind not in "iu":
        msg = "has vertex indices that are not integers"
        raise MeshFileError(msg)
    vertices = _columns(vertex, ("x", "y", "z"))
    corners, counts = listed.values.astype(np.int64), listed.lengths
    check_indices(corners, counts, len(vertices))
    starts = np.concatenate([[0], np.cumsum(counts)])
    uv, normals = None, None
    for names in _UV_NAMES:
        if {*names} <= {*vertex}:
            uv = _columns(vertex, names)[corners]
    own = face.get("texcoord")
    if isinstance(own, _List):
        if not ((own.lengths == 2 * counts) | (own.lengths == 0)).all():
            msg = "has faces whose texture coordinates (texcoord) are not two for each corner"
            raise MeshFileError(msg)
        uv = np.full((len(corners), 2), np.nan)
        uv[np.repeat(own.lengths > 0, counts)] = own.values.reshape(-1, 2)
    if {"nx", "ny", "nz"} <= {*vertex}:
        normals = _columns(vertex, ("nx", "ny", "nz"))[corners]
    colours = _colours(vertex)
    for table, name in ((vertex, "vertices"), (face, "faces")):
        alpha = table.get("alpha")
        if (
            isinstance(alpha, np.ndarray)
            and (alpha < (1 if alpha.dtype.kind == "f" else np.iinfo(alpha.dtype).max)).any()
        ):
            ignored.append(f"opacity of {name} (alpha): the surface is opaque")
    if colours is not None:
        colours = colours[corners]
    elif (of_faces := _colours(face)) is not None:
        colours = np.repeat(of_faces, counts, axis=0)
    pictures = _picture_names(comments)
    materials: tuple[FileMaterial, ...] = ()
    material_of = np.full(len(counts), -1, dtype=np.int64)
    if pictures:
        materials = tuple(_material(file, name) for name in pictures)
        number = face.get("texnumber")
        material_of = (
            number.astype(np.int64) if isinstance(number, np.ndarray) else np.zeros(len(counts), dtype=np.int64)
        )
        if not ((material_of >= -1) & (material_of < len(pictures))).all():
            msg = f"has faces with the number of a texture file (texnumber) that is not one of {len(pictures)}"
            raise MeshFileError(msg)
    return PolygonMesh(vertices, corners, starts, uv, normals, colours, materials, material_of, tuple(ignored))


def check_indices(corners: Indices, counts: Indices, vertices: int) -> None:
    """Raise MeshFileError for faces with too few corners, or vertices that do not exist; indices are from 0."""
    if (counts < 3).any():
        n = int(np.argmax(counts < 3))
        msg = f"face {n + 1} has {counts[n]} corners, fewer than 3"
        raise MeshFileError(msg)
    wrong = (corners < 0) | (corners >= vertices)
    if wrong.any():
        place = int(np.argmax(wrong))
        n = int(np.searchsorted(np.cumsum(counts), place, side="right"))
        msg = f"face {n + 1} refers to vertex {corners[place]}, counted from 0: there are {vertices:,}"
        raise MeshFileError(msg)


def _columns(table: Table, names: tuple[str, ...]) -> Floats:
    values = [table[name] for name in names]
    if any(isinstance(each, _List) for each in values):
        msg = f"has lists for {', '.join(names)}"
        raise MeshFileError(msg)
    return np.stack([np.asarray(each, dtype=np.float64) for each in values], axis=-1)


def _colours(table: Table) -> Floats | None:
    """Return red, green and blue from 0 to 1, by the range of their type; None if there are none."""
    for names in (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue")):
        if {*names} <= {*table}:
            kind = np.asarray(table[names[0]]).dtype
            values = _columns(table, names) / (1.0 if kind.kind == "f" else float(np.iinfo(kind).max))
            if not ((values >= 0) & (values <= 1)).all():
                msg = "has colours outside the range of their type: 0 to 1 for floating-point numbers"
                raise MeshFileError(msg)
            return values
    return None


def _material(file: Path, name: str) -> FileMaterial:
    found = find_beside(file, name)
    if found is None:
        return FileMaterial(name, problem=describe_absent(file, name))
    return FileMaterial(name, picture=TextureMap(found))
