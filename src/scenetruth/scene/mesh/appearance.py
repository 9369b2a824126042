"""Colours that a mesh file gives its surface: materials, pictures, and colours of vertices or faces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.cutouts import CutTriangles, OpacityMap, cut_out
from scenetruth.scene.mesh.file_preflight import MAX_TEXELS, read_checked_bytes
from scenetruth.scene.mesh.polygon_mesh import FileGloss, FileMaterial, MeshFileError, TextureMap
from scenetruth.scene.picture_file import (
    DecodedPicture,
    PictureFileError,
    component_of,
    decode_picture,
    linearise,
)

__all__ = ["LaidPicture", "MeshAppearance"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_MARGIN = 4  # texels around each picture of an atlas, for samples a little beyond its border
_MOST_COPIES = 64  # of a repeated picture in an atlas
_HALF = 0.5  # opacity at which the surface ends


class LaidPicture(NamedTuple):
    """A picture and where it lies on the faces."""

    values: NDArray[np.float32]
    """Radiances, shape (height, width)."""
    uv: Floats
    """Texture coordinates of the corners with v downwards, shape (m, 3, 2)."""
    tiled: bool
    """Whether the picture repeats; otherwise, its border continues."""


@dataclass(frozen=True, eq=False)
class MeshAppearance:
    """Colours of the faces of a mesh file.

    ``colours``: Linear colours of the corners, shape (m, 3, 3); None for white.
    ``uv``: Texture coordinates of the corners with v upwards, shape (m, 3, 2), NaN where missing; None without.
    ``materials``, ``material_of``: Materials, and that of every face, -1 for white, shape (m,).
    ``srgb_pictures``: Whether pictures are sRGB by the definition of the format; None if it does not say.
    ``band``: Band in which the colours are shown; None for their luminance.
    """

    colours: Floats | None
    uv: Floats | None
    materials: tuple[FileMaterial, ...]
    material_of: Indices
    srgb_pictures: bool | None
    band: str | None = None

    @cached_property
    def used(self) -> list[int]:
        """Materials of at least one face."""
        return [int(n) for n in np.unique(self.material_of) if n >= 0]

    @property
    def has_colours(self) -> bool:
        """Whether the file gives any colours."""
        return self.colours is not None or bool(self.used)

    @property
    def has_pictures(self) -> bool:
        """Whether any face shows a picture."""
        return any(self.materials[n].picture is not None for n in self.used)

    def cut(self) -> CutTriangles | None:
        """Return the triangles that remain where opacity cuts parts of the surface out; None if it cuts nothing."""
        count = len(self.material_of)
        parts: list[CutTriangles] = []
        left = np.ones(count, dtype=np.bool_)
        for n in self.used:
            material = self.materials[n]
            if material.outline_problem is not None and (
                material.picture is None or decode(material).alpha is not None
            ):
                raise MeshFileError(material.outline_problem)
            # In formats without a mode of opacity, transparent texels are cut out.
            limit = _HALF if material.alpha_cutoff is None and self.srgb_pictures is None else material.alpha_cutoff
            if limit is None or material.problem is not None:
                continue
            faces = np.flatnonzero(self.material_of == n)
            alpha = np.ones((1, 1), dtype=np.float32) if material.picture is None else decode(material).alpha
            if limit > 1:
                alpha = np.zeros((1, 1), dtype=np.float32)
            if alpha is None or alpha.min() >= limit:
                continue
            left[faces] = False
            if alpha.max() < limit:
                parts.append(CutTriangles(np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)), 0, len(faces)))
                continue
            assert material.picture is not None
            found = cut_out(OpacityMap(alpha, self._coordinates(n), material.picture.wrap, limit))
            parts.append(found._replace(source=faces[found.source]))
        if left.all():
            return None
        rest = np.flatnonzero(left)
        parts.append(CutTriangles(rest, np.broadcast_to(np.eye(3), (len(rest), 3, 3)), 0, 0))
        source = np.concatenate([each.source for each in parts])
        order = np.argsort(source, kind="stable")
        weights = np.concatenate([each.weights for each in parts])
        cut, removed = sum(each.cut for each in parts), sum(each.removed for each in parts)
        return CutTriangles(source[order], weights[order], cut, removed)

    def on_pieces(self, cut: CutTriangles) -> MeshAppearance:
        """Return the appearance of the triangles of a cut."""
        colours, uv = (
            None if each is None else np.einsum("tkc,tcj->tkj", cut.weights, each[cut.source])
            for each in (self.colours, self.uv)
        )
        return replace(self, colours=colours, uv=uv, material_of=self.material_of[cut.source])

    def describe(self) -> list[str]:
        """Return lines for people on the pictures that are used: size, bits, colours, opacity and encoding."""
        lines = []
        for n in self.used:
            material = self.materials[n]
            if material.picture is None or material.problem is not None:
                continue
            name = material.picture.file.name if material.picture.file is not None else f"picture of {material.name}"
            lines.append(f"{name}: {decode(material).describe()}")
        return lines

    def gloss(self) -> tuple[list[FileGloss], Indices]:
        """Return the gloss of the materials that are used, and that of every face, shape (m,).

        Raises MeshFileError if a face has none.
        """
        problems = [problem for n in self.used if (problem := self.materials[n].gloss_problem) is not None]
        if problems:
            raise MeshFileError("; ".join(problems))
        found = {n: gloss for n in self.used if (gloss := self.materials[n].gloss) is not None}
        without = ~np.isin(self.material_of, list(found))
        if without.any():
            msg = f"has {int(without.sum()):,} triangles whose material has no gloss"
            raise MeshFileError(msg)
        return list(found.values()), np.searchsorted(sorted(found), self.material_of)

    def check(self) -> None:
        """Raise MeshFileError if the colours cannot be shown."""
        problems = [problem for n in self.used if (problem := self.materials[n].problem) is not None]
        if problems:
            raise MeshFileError("; ".join(problems))

    def shape(self) -> tuple[int, int]:
        """Return height and width of the picture of `lay`, at low cost if it is a single one."""
        if not self.has_pictures:
            return 2, 256
        height, width = self.lay(None).values.shape
        return height, width

    def radiances(self, encoding: str | None) -> Floats:
        """Return the radiances of the corners of faces without pictures, shape (m, 3)."""
        self.check()
        colours = np.ones((len(self.material_of), 3, 3)) if self.colours is None else self.colours
        factor = np.ones((len(self.materials) + 1, 3))
        for n, material in enumerate(self.materials):
            factor[n] = material.colour
        # The last one is that of -1.
        both = colours * factor[self.material_of][:, None]
        return self._seen(linearise(both, "srgb") if self._by_scene(encoding) == "srgb" else both)

    def _seen(self, colours: Floats) -> Floats:
        """Return linear colours as they are shown."""
        try:
            return component_of(colours, self.band)
        except PictureFileError as error:
            raise MeshFileError(str(error)) from error

    def _by_scene(self, encoding: str | None) -> str:
        """Return the encoding of colours: linear in glTF, otherwise that of the scene."""
        return "linear" if self.srgb_pictures or encoding is None else encoding

    def lay(self, encoding: str | None) -> LaidPicture:
        """Return the picture of all faces: that of the file, or an atlas of several pictures and colours.

        ``encoding``: ``linear`` or ``srgb`` of the pictures; None for that of the format, or linear.
        """
        self.check()
        self._check_colours_beside_pictures()
        if self.uv is None:
            msg = "has materials with pictures, but no texture coordinates"
            raise MeshFileError(msg)
        numbers = self.used + ([-1] if (self.material_of < 0).any() else [])
        laid = [self._one(n, encoding, alone=len(numbers) == 1) for n in numbers]
        if len(laid) == 1:
            return laid[0]
        return _atlas(laid, [self.material_of == n for n in numbers])

    def _check_colours_beside_pictures(self) -> None:
        if self.colours is None or (self.colours == 1.0).all():
            return
        if self.srgb_pictures is None:
            msg = "has colours of vertices and a picture, and does not say which of them counts; remove one of them"
        else:
            msg = "has colours of vertices that multiply a picture, which is not shown; bake them into the picture"
        raise MeshFileError(msg)

    def _one(self, number: int, encoding: str | None, *, alone: bool) -> LaidPicture:
        """Return the picture of the faces of a material."""
        faces = self.material_of == number
        material = self.materials[number] if number >= 0 else FileMaterial("white")
        if material.picture is None:
            value = self._seen(np.array([[material.colour]], dtype=np.float64)).astype(np.float32)
            return LaidPicture(value, np.full((int(faces.sum()), 3, 2), 0.5), tiled=False)
        values = read_radiances(material, self._encoding(encoding), self.band)
        uv = self._coordinates(number)
        wrap = material.picture.wrap
        if alone and wrap == ("repeat", "repeat"):
            return LaidPicture(values, uv, tiled=True)
        if alone and wrap == ("clamp", "clamp"):
            return LaidPicture(values, uv, tiled=False)
        return _unrolled(values, uv, wrap, material.name, alone=alone)

    def _coordinates(self, number: int) -> Floats:
        """Return the coordinates in the picture of a material of its faces, with v downwards, shape (m, 3, 2)."""
        material, faces = self.materials[number], self.material_of == number
        assert material.picture is not None
        if self.uv is None:
            msg = f'has the picture of material "{material.name}", but no texture coordinates'
            raise MeshFileError(msg)
        uv = _moved(self.uv[faces], material.picture)
        if not np.isfinite(uv).all():
            face = int(np.flatnonzero(faces)[np.argmax(~np.isfinite(uv).all(axis=(1, 2)))])
            msg = f'shows the picture of "{material.name}" on triangle {face + 1}, which has no texture coordinates'
            raise MeshFileError(msg)
        # v increases upwards in mesh files, and image rows increase downwards.
        return uv * (1, -1) + (0, 1)

    def _encoding(self, encoding: str | None) -> str | None:
        return ("srgb" if self.srgb_pictures else None) if encoding is None else encoding


def decode(material: FileMaterial) -> DecodedPicture:
    """Return the picture of a material."""
    picture = material.picture
    assert picture is not None
    try:
        content = picture.content if picture.content is not None else _content(picture)
        return decode_picture(content, obey_metadata=picture.file is not None, most_pixels=MAX_TEXELS)
    except PictureFileError as error:
        raise _unreadable(material, error) from error


def read_radiances(material: FileMaterial, encoding: str | None, band: str | None = None) -> NDArray[np.float32]:
    """Return the radiances of the picture of a material times its colour, shape (height, width)."""
    try:
        return decode(material).radiances(encoding, material.colour, band)
    except PictureFileError as error:
        raise _unreadable(material, error) from error


def _unreadable(material: FileMaterial, error: PictureFileError) -> MeshFileError:
    picture = material.picture
    name = picture.file.name if picture is not None and picture.file is not None else "its embedded picture"
    return MeshFileError(f'material "{material.name}": {name} {error}')


def _content(picture: TextureMap) -> bytes:
    assert picture.file is not None
    try:
        return read_checked_bytes(picture.file)
    except (OSError, ValueError) as error:
        msg = f"cannot be read: {error}"
        raise PictureFileError(msg) from error


def _moved(uv: Floats, picture: TextureMap) -> Floats:
    """Return texture coordinates after the transform of a picture."""
    matrix = np.array(picture.transform).reshape(2, 3)
    return np.asarray(uv @ matrix[:, :2].T + matrix[:, 2])


def _unrolled(values: NDArray[np.float32], uv: Floats, wrap: tuple[str, str], name: str, *, alone: bool) -> LaidPicture:
    """Return a picture with as many copies as its faces show, and a margin that continues them."""
    pads, moved = [], np.empty_like(uv)
    for axis, mode in enumerate(wrap):
        size = values.shape[1 - axis]
        low, high = float(uv[..., axis].min()), float(uv[..., axis].max())
        first, last = (floor(low + 1e-9), ceil(high - 1e-9)) if mode != "clamp" else (0, 1)
        last = max(last, first + 1)
        if last - first > _MOST_COPIES:
            msg = f'material "{name}" repeats one of several pictures {last - first} times; bake them into one'
            raise MeshFileError(msg)
        texels = np.arange(first * size - _MARGIN, last * size + _MARGIN)
        if mode == "clamp":
            index = np.clip(texels, 0, size - 1)
        elif mode == "repeat":
            index = texels % size
        else:
            index = np.where(texels % (2 * size) < size, texels % (2 * size), 2 * size - 1 - texels % (2 * size))
        pads.append(index)
        # Beyond a clamped picture, its border continues; in an atlas, the next picture follows.
        beyond = np.abs(uv[..., axis] - 0.5).max() > 0.5 + _MARGIN / size
        if mode == "clamp" and beyond and not alone:
            msg = (
                f'material "{name}" shows what lies beyond its picture, where another picture lies; bake them into one'
            )
            raise MeshFileError(msg)
        moved[..., axis] = (uv[..., axis] * size - texels[0]) / len(texels)
    across, down = pads
    if len(across) * len(down) > MAX_TEXELS:
        msg = f'material "{name}" repeats its picture to {len(across):,} x {len(down):,} texels; bake it'
        raise MeshFileError(msg)
    return LaidPicture(np.ascontiguousarray(values[down][:, across]), moved, tiled=False)


def _atlas(laid: list[LaidPicture], faces: list[NDArray[np.bool_]]) -> LaidPicture:
    """Return all pictures one below the other."""
    padded = [each if min(each.values.shape) > 2 * _MARGIN else _constant(each) for each in laid]
    width = max(each.values.shape[1] for each in padded)
    height = sum(each.values.shape[0] for each in padded)
    if width * height > MAX_TEXELS:
        msg = f"has pictures of {width:,} x {height:,} texels in total, more than {MAX_TEXELS:,}; reduce them"
        raise MeshFileError(msg)
    values = np.zeros((height, width), dtype=np.float32)
    uv = np.empty((len(faces[0]), 3, 2))
    top = 0
    for each, where in zip(padded, faces, strict=True):
        own_height, own_width = each.values.shape
        values[top : top + own_height, :own_width] = each.values
        uv[where, :, 0] = each.uv[..., 0] * own_width / width
        uv[where, :, 1] = (top + each.uv[..., 1] * own_height) / height
        top += own_height
    return LaidPicture(values, uv, tiled=False)


def _constant(each: LaidPicture) -> LaidPicture:
    """Return a single texel with a margin."""
    size = 2 * _MARGIN + 1
    return LaidPicture(np.full((size, size), each.values[0, 0], dtype=np.float32), each.uv, tiled=False)
