"""Polygons of mesh files by plain readers: a line or a number at a time, without tolerance for anything unusual."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["PLAIN_READERS", "figures_of"]

Polygon = list[tuple[float, float, float]]


def read_obj(content: bytes) -> list[Polygon]:
    points: Polygon = []
    found: list[Polygon] = []
    for line in content.decode().splitlines():
        words = line.split("#")[0].split()
        if words[:1] == ["v"]:
            points.append((float(words[1]), float(words[2]), float(words[3])))
        elif words[:1] == ["f"]:
            polygon = []
            for word in words[1:]:
                index = int(word.split("/")[0])
                polygon.append(points[index if index < 0 else index - 1])
            found.append(polygon)
    return found


def read_off(content: bytes) -> list[Polygon]:
    lines = [line for line in content.decode().splitlines() if line.strip()]
    vertices, faces = (int(word) for word in lines[1].split()[:2])
    points = [tuple(float(word) for word in line.split()[:3]) for line in lines[2 : 2 + vertices]]
    polygons = []
    for line in lines[2 + vertices : 2 + vertices + faces]:
        words = [int(word) for word in line.split()]
        polygons.append([points[index] for index in words[1 : 1 + words[0]]])
    return polygons  # type: ignore[return-value]


def read_stl(content: bytes) -> list[Polygon]:
    count = struct.unpack_from("<I", content, 80)[0]
    found = []
    for n in range(count):
        numbers = struct.unpack_from("<12f", content, 84 + 50 * n)
        found.append([numbers[3:6], numbers[6:9], numbers[9:12]])
    return found


_LETTERS = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "float": "f",
    "double": "d",
}


def read_ply(content: bytes) -> list[Polygon]:
    head, _, data = content.partition(b"end_header\n")
    elements: list[tuple[str, int, list[list[str]]]] = []
    order = "<"
    for line in head.decode().splitlines():
        words = line.split()
        if words[0] == "format":
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            elements[-1][2].append(words[1:])
    numbers = _text_numbers(data) if order == "" else _binary_numbers(data, order)
    points: Polygon = []
    found: list[Polygon] = []
    for name, count, properties in elements:
        for _ in range(count):
            values: dict[str, Any] = {}
            for each in properties:
                if each[0] == "list":
                    size = int(numbers(each[1]))
                    values[each[3]] = [numbers(each[2]) for _ in range(size)]
                else:
                    values[each[1]] = numbers(each[0])
            if name == "vertex":
                points.append((values["x"], values["y"], values["z"]))
            elif name == "face":
                listed = values["vertex_indices" if "vertex_indices" in values else "vertex_index"]
                found.append([points[int(index)] for index in listed])
    return found


def _text_numbers(data: bytes) -> Callable[[str], float]:
    words: Iterator[bytes] = iter(data.split())
    return lambda _: float(next(words))


def _binary_numbers(data: bytes, order: str) -> Callable[[str], float]:
    place = 0

    def following(kind: str) -> float:
        nonlocal place
        value = struct.unpack_from(order + _LETTERS[kind], data, place)[0]
        place += struct.calcsize(_LETTERS[kind])
        return float(value)

    return following


def read_gltf(content: bytes) -> list[Polygon]:
    """Read positions and indices of triangles at the nodes of the default scene, moved and scaled."""
    tree = json.loads(content)
    data = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])

    def values(index: int, letter: str, width: int) -> list[tuple[float, ...]]:
        entry = tree["accessors"][index]
        view = tree["bufferViews"][entry["bufferView"]]
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        step = view.get("byteStride", width * struct.calcsize(letter))
        return [struct.unpack_from(f"<{width}{letter}", data, start + n * step) for n in range(entry["count"])]

    found: list[Polygon] = []
    for number in tree["scenes"][tree.get("scene", 0)]["nodes"]:
        node = tree["nodes"][number]
        scale, move = node.get("scale", [1, 1, 1]), node.get("translation", [0, 0, 0])
        for primitive in tree["meshes"][node["mesh"]]["primitives"]:
            points = [
                tuple(s * c + m for s, c, m in zip(scale, point, move, strict=True))
                for point in values(primitive["attributes"]["POSITION"], "f", 3)
            ]
            index = [int(each[0]) for each in values(primitive["indices"], "H", 1)]
            found += [[points[k] for k in index[n : n + 3]] for n in range(0, len(index), 3)]
    return found


PLAIN_READERS: dict[str, Callable[[bytes], list[Polygon]]] = {
    "obj": read_obj,
    "off": read_off,
    "stl": read_stl,
    "ply": read_ply,
    "gltf": read_gltf,
}


def figures_of(polygons: list[Polygon]) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the area of different polygons by the Newell sum, and the bounding box of those with an area."""
    area, corners, seen = 0.0, [], set()
    for polygon in polygons:
        points = np.array(polygon, dtype=np.float64)
        around = points - points[0]
        own = 0.5 * float(np.linalg.norm(np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)))
        key = frozenset(map(tuple, points.tolist()))
        sides = float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())
        # Needles without an area within rounding.
        if own <= 1e-14 * sides**2 or (len(points) == 3 and key in seen):
            continue
        seen.add(key)
        area += own
        corners.append(points)
    stacked = np.concatenate(corners)
    return area, stacked.min(axis=0), stacked.max(axis=0)
