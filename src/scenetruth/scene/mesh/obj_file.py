"""Wavefront OBJ files and their material libraries."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.file_preflight import MAX_ELEMENTS, read_checked_bytes
from scenetruth.scene.mesh.polygon_mesh import FileMaterial, MeshFileError, PolygonMesh, TextureMap

__all__ = ["list_obj_references", "read_obj"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_FREE_FORM = ("vp", "cstype", "deg", "bmat", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "con")
_HARMLESS = ("g", "o", "s", "mg", "usemap", "maplib", "lod", "shadow_obj", "trace_obj", "bevel", "c_interp", "d_interp")
_NO_INDEX = 0  # of a texture coordinate or normal that a corner does not have


def read_text(content: bytes) -> str:
    """Return the text of a file, without a byte-order mark and with continued lines joined."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        msg = "is a text in UTF-16; save it in UTF-8 or ASCII"
        raise MeshFileError(msg)
    if b"\0" in content:
        msg = "is no text: it has bytes of value 0"
        raise MeshFileError(msg)
    text = content.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="surrogateescape")
    return re.sub(r"\\[ \t]*\r?\n", " ", text)


@dataclass
class _Lines:
    """Content of the lines, still as words."""

    positions: list[list[str]] = field(default_factory=list)
    texture: list[list[str]] = field(default_factory=list)
    normals: list[list[str]] = field(default_factory=list)
    faces: list[list[str]] = field(default_factory=list)
    before: list[tuple[int, int, int]] = field(default_factory=list)
    """Numbers of positions, texture coordinates and normals before each face, for negative indices."""
    material_of: list[str | None] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)
    ignored: dict[str, int] = field(default_factory=dict)


def _split(text: str) -> _Lines:
    """Return the words of the lines by keyword."""
    found = _Lines()
    material: str | None = None
    lists = {"v": found.positions, "vt": found.texture, "vn": found.normals}
    for line in text.splitlines():
        words = line.split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        keyword = words[0]
        rest = words[1].strip() if len(words) > 1 else ""
        if keyword in lists:
            lists[keyword].append(rest.partition("#")[0].split())
        elif keyword in ("f", "fo"):
            found.faces.append(rest.partition("#")[0].split())
            found.before.append((len(found.positions), len(found.texture), len(found.normals)))
            found.material_of.append(material)
        elif keyword == "usemtl":
            material = rest or None
        elif keyword == "mtllib":
            found.libraries.append(rest)
        elif keyword in _FREE_FORM:
            msg = f"has free-form geometry ({keyword}), which is not read; export it as polygons"
            raise MeshFileError(msg)
        elif keyword in ("call", "csh"):
            msg = f"refers to other files or commands ({keyword}), which is not read; export it as a single file"
            raise MeshFileError(msg)
        elif keyword not in _HARMLESS:
            found.ignored[keyword] = found.ignored.get(keyword, 0) + 1
    return found


def _numbers(rows: list[list[str]], keyword: str) -> Floats:
    """Return the numbers of lines of the same length, shape (n, count)."""
    if not rows:
        return np.zeros((0, 0))
    count = len(rows[0])
    for number, row in enumerate(rows, 1):
        if len(row) != count:
            msg = f"line {number} of those with {keyword} has {len(row)} numbers, and the first has {count}"
            raise MeshFileError(msg)
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), count)
    except ValueError as error:
        for number, row in enumerate(rows, 1):
            for word in row:
                if not _is_number(word):
                    remedy = "; use a decimal point" if "," in word else ""
                    msg = f'line {number} of those with {keyword} has "{word}", which is not a number{remedy}'
                    raise MeshFileError(msg) from error
        raise


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    # Python allows digit groups.
    return "_" not in word


def _same_length(rows: list[list[str]], least: int, most: int) -> list[list[str]]:
    """Return lines cut to the length of the shortest, which must be long enough."""
    shortest = min(map(len, rows), default=0)
    return [row[: min(max(shortest, least), most)] for row in rows]


def _corner_indices(lines: _Lines) -> tuple[Indices, Indices]:
    """Return the indices of position, texture coordinate and normal of all corners from 1, and counts of corners.

    0 stands for a missing texture coordinate or normal. Negative indices count back from the face.
    """
    counts = np.array([len(face) for face in lines.faces], dtype=np.int64)
    if (counts < 3).any():
        n = int(np.argmax(counts < 3))
        msg = f"face {n + 1} has {counts[n]} corners, fewer than 3"
        raise MeshFileError(msg)
    out = np.zeros((int(counts.sum()), 3), dtype=np.int64)
    words = list(itertools.chain.from_iterable(lines.faces))
    slashes = {word.count("/") for word in words}
    joined = " ".join(words)
    try:
        if slashes == {0}:
            out[:, 0] = np.array(words, dtype=np.int64)
        elif slashes == {1} and "/ " not in joined + " ":
            out[:, :2] = np.array(joined.replace("/", " ").split(), dtype=np.int64).reshape(-1, 2)
        elif slashes == {2} and "//" not in joined and "/ " not in joined + " ":
            out[:] = np.array(joined.replace("/", " ").split(), dtype=np.int64).reshape(-1, 3)
        else:
            for n, word in enumerate(words):
                for k, part in enumerate(word.split("/")):
                    # A fourth part raises an IndexError.
                    out[n, k] = int(part) if part or k == 0 else _NO_INDEX
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshFileError(_bad_corner(lines)) from error
    given = np.array([[bool(part) for part in (word.split("/") + ["", ""])[:3]] for word in words]) if not (
        slashes <= {0} or (slashes == {2} and "//" not in joined)
    ) else np.broadcast_to(np.arange(3) <= max(slashes), out.shape)  # fmt: skip
    before = np.repeat(np.array(lines.before, dtype=np.int64).reshape(-1, 3), counts, axis=0)
    total = np.array([len(lines.positions), len(lines.texture), len(lines.normals)])
    absolute = np.where(out < 0, before + out + 1, out)
    if not total[2] and given[:, 2].any():
        # Some exporters omit the normals, but not the references; they matter for shading only.
        given = given & (np.arange(3) != 2)
        lines.ignored["reference to a normal (vn), of which there are none"] = int(np.count_nonzero(out[:, 2]))
    for k, name in enumerate(("vertex", "texture coordinate", "normal")):
        wrong = given[:, k] & ((absolute[:, k] < 1) | (absolute[:, k] > total[k]))
        if wrong.any():
            place = int(np.argmax(wrong))
            face = int(np.searchsorted(np.cumsum(counts), place, side="right"))
            index = out[place, k]
            why = "indices begin at 1" if index == 0 else f"there are {total[k]:,}" if index > 0 else (
                f"there are {before[place, k]:,} before it")  # fmt: skip
            msg = f"face {face + 1} refers to {name} {index}: {why}"
            raise MeshFileError(msg)
    absolute[~given] = _NO_INDEX
    return absolute, counts


def _bad_corner(lines: _Lines) -> str:
    """Return a message on the first corner that is no index."""
    for number, face in enumerate(lines.faces, 1):
        for word in face:
            parts = word.split("/")
            if len(parts) > 3 or not all(re.fullmatch(r"[+-]?\d{1,18}", part) or (k and not part) for k, part in enumerate(parts)):  # fmt: skip # noqa: E501
                return f'face {number} has the corner "{word}", which is no index'
    return "has faces whose corners are no indices"


def read_obj(file: Path) -> PolygonMesh:
    """Read the polygons of an OBJ file.

    Raises
    ------
    MeshFileError
        If an index, a number or a statement cannot be read without doubt.
    """
    lines = _split(read_text(read_checked_bytes(file)))
    if max(len(lines.positions), len(lines.faces)) > MAX_ELEMENTS:
        msg = f"has {len(lines.positions):,} vertices and {len(lines.faces):,} faces; the maximum is {MAX_ELEMENTS:,}"
        raise MeshFileError(msg)
    if not lines.faces:
        msg = "has no faces"
        raise MeshFileError(msg)
    positions = _numbers(lines.positions, "v")
    width = positions.shape[1]
    if width not in (3, 4, 6, 7):
        msg = f"has vertices of {width} numbers; x y z, x y z w, and either with red green blue are read"
        raise MeshFileError(msg)
    if width == 4 and not (positions[:, 3] == 1).all():
        msg = "has rational vertices, with weights other than 1, which are not read"
        raise MeshFileError(msg)
    index, counts = _corner_indices(lines)
    corners = index[:, 0] - 1
    colours = None
    if width >= 6:
        colours = positions[:, 3:6]
        if not ((colours >= 0) & (colours <= 1)).all():
            msg = "has vertex colours outside 0 to 1"
            raise MeshFileError(msg)
        colours = colours[corners]
    uv = _take(_numbers(_same_length(lines.texture, 1, 2), "vt"), index[:, 1], 2)
    normals = _take(_numbers(lines.normals, "vn"), index[:, 2], 3)
    names = list(dict.fromkeys(name for name in lines.material_of if name is not None))
    libraries = _read_libraries(file, lines.libraries) if names else {}
    materials = tuple(
        # Names may contain a number sign, as "FileMaterial #25", or precede a comment.
        libraries.get(name)
        or libraries.get(name.partition("#")[0].strip())
        or FileMaterial(name, problem=_missing(name, file, lines.libraries))
        for name in names
    )
    numbers = {name: n for n, name in enumerate(names)}
    return PolygonMesh(
        positions[:, :3].copy(),
        corners,
        np.concatenate([[0], np.cumsum(counts)]),
        uv,
        normals,
        colours,
        materials,
        np.array([-1 if name is None else numbers[name] for name in lines.material_of], dtype=np.int64),
        tuple(f"{count:,} x {keyword}" for keyword, count in lines.ignored.items()),
    )


def _take(values: Floats, index: Indices, components: int) -> Floats | None:
    """Return values by index from 1, with NaN for 0, shape (k, components); None if there are none."""
    if not values.size or not index.any():
        return None
    if values.shape[1] < components:
        values = np.pad(values, ((0, 0), (0, components - values.shape[1])))
    whole = np.concatenate([np.full((1, components), np.nan), values[:, :components]])
    return np.asarray(whole[index])


def _missing(name: str, file: Path, libraries: list[str]) -> str:
    if not libraries:
        return f'uses the material "{name}", but names no material library (mtllib)'
    absent = [each for each in libraries if not _library_files(file, each)]
    if absent:
        return f'uses the material "{name}"; its material library "{absent[0]}" is missing in its folder'
    return f'uses the material "{name}", which its material library does not have'


def _library_files(file: Path, names: str) -> list[Path]:
    """Return the existing files of an mtllib statement: a single name, possibly with spaces, or several."""
    for text in dict.fromkeys((names, names.partition("#")[0])):
        whole = find_beside(file, text)
        if whole is not None:
            return [whole]
    found = [find_beside(file, name) for name in re.split(r"(?<!\\)\s+", names)]
    return [each for each in found if each is not None]


def find_beside(file: Path, name: str) -> Path | None:
    """Return the file of a name in another file: as it stands, without quotes, or with %20 and backslashes resolved."""
    plain = name.strip().strip("\"'")
    spaced = plain.replace("\\ ", " ")
    before_comment = re.split(r"\s#", name)[0].strip().strip("\"'")
    ways = (name.strip(), plain, unquote(plain), spaced, unquote(spaced).replace("\\", "/"), before_comment)
    for each in dict.fromkeys(ways):
        try:
            if each and (file.parent / each).is_file():
                return file.parent / each
        except (OSError, ValueError):
            continue
    return None


def describe_absent(file: Path, name: str) -> str:
    """Return the message on a picture that another file names, with the remedy if only its folder is wrong."""
    message = f'its picture "{name}" is missing in its folder'
    last = re.split(r"[/\\]", name.strip().strip("\"'"))[-1]
    if last != name and find_beside(file, last) is not None:
        message += f'; the folder of {file.name} has "{last}": remove the path from the name'
    return message


def list_obj_references(file: Path) -> list[Path]:
    """Return the material libraries of an OBJ file and their pictures, including those that are missing."""
    text = read_text(read_checked_bytes(file))
    named = [line.split(None, 1) for line in text.splitlines() if line.lstrip().startswith("mtllib")]
    libraries = [
        path
        for words in named
        for path in _library_files(file, words[-1].strip()) or [file.parent / word for word in words[-1].split()]
    ]
    pictures = []
    for library in libraries:
        if not library.is_file():
            continue
        for line in read_text(read_checked_bytes(library)).splitlines():
            words = line.split(None, 1)
            if len(words) == 2 and words[0].lower() in ("map_kd", "map_ka"):
                name = _split_options(words[1].strip())[1]
                pictures.append(find_beside(library, name) or library.parent / name)
    return [*libraries, *pictures]


def _read_libraries(file: Path, libraries: list[str]) -> dict[str, FileMaterial]:
    """Return the materials of all libraries by name."""
    found: dict[str, FileMaterial] = {}
    for path in itertools.chain.from_iterable(_library_files(file, name) for name in libraries):
        try:
            entries = _entries(read_text(read_checked_bytes(path)))
        except ValueError as error:
            msg = f"its material library {path.name} {error}"
            raise MeshFileError(msg) from error
        for name, statements in entries:
            found[name] = _material(path, name, statements)
    return found


def _entries(text: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Give the statements of each material of a library."""
    name: str | None = None
    statements: dict[str, str] = {}
    for line in text.splitlines():
        words = line.split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        rest = words[1].strip() if len(words) > 1 else ""
        # Exporters differ in the case of statements.
        keyword = words[0].lower()
        if keyword == "newmtl":
            if name is not None:
                yield name, statements
            name, statements = rest, {}
        else:
            statements[keyword] = rest
    if name is not None:
        yield name, statements


def _material(library: Path, name: str, statements: dict[str, str]) -> FileMaterial:
    """Return a material; what cannot be shown is its problem, which matters only if its colours are wanted."""
    where = f'material "{name}" of {library.name}'
    try:
        colour = _colour(statements.get("kd", "1 1 1" if "map_kd" in statements else "0.8 0.8 0.8"))
        opacity = float(_last_word(statements["d"])) if "d" in statements else None
        if opacity is None and "tr" in statements:
            opacity = 1.0 - float(_last_word(statements["tr"]))
            # MeshLab writes 1 for opaque surfaces; an entire surface that cannot be seen is not meant.
            opacity = 1.0 if opacity == 0.0 else opacity
        if opacity is not None and opacity < 1.0:
            return FileMaterial(name, problem=f"{where} is translucent (opacity {opacity:g}), which is not shown")
        if "map_d" in statements:
            message = f"{where} has a map of opacity (map_d), which is not read; put it into the alpha of map_Kd"
            return FileMaterial(name, problem=message, outline_problem=message)
        if "map_kd" not in statements:
            return FileMaterial(name, colour)
        if not any(colour):
            msg = "Kd 0 0 0 multiplies the picture by zero; set Kd 1 1 1"
            raise ValueError(msg)
        return FileMaterial(name, colour, _texture_map(library, statements["map_kd"]))
    except ValueError as error:
        return FileMaterial(name, problem=f"{where}: {error}")


def _last_word(words: str) -> str:
    """Return the last word of a statement before a comment."""
    return (words.partition("#")[0].split() or [""])[-1]


def _colour(words: str) -> tuple[float, float, float]:
    parts = words.partition("#")[0].split()
    if parts[:1] in (["spectral"], ["xyz"]):
        msg = f"Kd is given as {parts[0]}, which is not read"
        raise ValueError(msg)
    values = [float(part) for part in parts[:3]]
    values = values * 3 if len(values) == 1 else values
    if len(values) != 3 or not all(0 <= value <= 1 for value in values):
        msg = f'Kd "{words}" is not a colour'
        raise ValueError(msg)
    return values[0], values[1], values[2]


class _Option(NamedTuple):
    """Option of a texture map: largest number of arguments, and what its arguments do."""

    least: int
    most: int
    check: Callable[[list[str]], None]


def _ignore(words: list[str]) -> None:
    pass


def _refuse_unless(*allowed: list[str]) -> Callable[[list[str]], None]:
    def check(words: list[str]) -> None:
        plain = [f"{float(word):g}" if _is_number(word) else word for word in words]
        if plain not in allowed:
            msg = f"its option with {' '.join(words)} is not read"
            raise ValueError(msg)

    return check


_OPTIONS = {
    "-blendu": _Option(1, 1, _ignore),
    "-blendv": _Option(1, 1, _ignore),
    "-boost": _Option(1, 1, _ignore),
    "-clamp": _Option(1, 1, _ignore),
    "-colorspace": _Option(1, 1, _refuse_unless()),
    "-s": _Option(1, 3, _ignore),
    "-o": _Option(1, 3, _ignore),
    "-texres": _Option(1, 1, _ignore),
    "-bm": _Option(1, 1, _ignore),
    "-cc": _Option(1, 1, _refuse_unless(["off"])),
    "-imfchan": _Option(1, 1, _ignore),
    "-mm": _Option(2, 2, _refuse_unless(["0", "1"])),
    "-t": _Option(1, 3, _refuse_unless(["0"], ["0", "0"], ["0", "0", "0"])),
    "-type": _Option(1, 1, _refuse_unless(["off"])),
}


def _split_options(statement: str) -> tuple[list[tuple[str, list[str]]], str]:
    """Return the options of a texture map with their arguments, and the name of its picture."""
    options = []
    rest = statement
    while rest.startswith("-"):
        option, _, after = rest.replace("\t", " ").partition(" ")
        if option not in _OPTIONS:
            break
        least, most, _ = _OPTIONS[option]
        words, rest = _take_words(after.strip(), least, most)
        options.append((option, words))
    return options, rest


def _texture_map(library: Path, statement: str) -> TextureMap:
    """Return the picture of map_Kd with its options."""
    scale, offset, wrap = (1.0, 1.0), (0.0, 0.0), "repeat"
    options, rest = _split_options(statement)
    for option, words in options:
        if option in ("-s", "-o"):
            values = [float(word) for word in words]
            values += [(1.0 if option == "-s" else 0.0)] * (3 - len(values))
            if option == "-s":
                scale = (values[0], values[1])
            else:
                offset = (values[0], values[1])
        elif option == "-clamp":
            wrap = "clamp" if words == ["on"] else "repeat"
        try:
            _OPTIONS[option].check(words)
        except ValueError as error:
            msg = f"map_Kd {option}: {error}"
            raise ValueError(msg) from error
    found = find_beside(library, rest)
    if found is None:
        raise ValueError(describe_absent(library, rest))
    transform = (scale[0], 0.0, offset[0], 0.0, scale[1], offset[1])
    return TextureMap(found, transform=transform, wrap=(wrap, wrap))


def _take_words(rest: str, least: int, most: int) -> tuple[list[str], str]:
    """Return the arguments of an option: at least some words, and further numbers, and the rest."""
    words: list[str] = []
    while len(words) < most:
        word, _, after = rest.partition(" ")
        if len(words) >= least and not _is_number(word):
            break
        words.append(word)
        rest = after.strip()
    return words, rest
