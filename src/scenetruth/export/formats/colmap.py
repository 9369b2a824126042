"""Cameras and points of one frame as COLMAP's text model, with the images.

``images/s+0_t+0.png`` and ``sparse/0/cameras.txt``, ``images.txt``, ``points3D.txt``, for all cameras of one frame:
COLMAP takes the scene for rigid. In COLMAP, the centre of the upper left pixel is at (0.5, 0.5): the principal point
and all 2D points are half a pixel more than in the data sets. Cameras are ``PINHOLE``, with a lens that distorts
``FULL_OPENCV``. Poses lead from the world, in mm, to the camera, as a quaternion (w, x, y, z) and a translation:
those that the maps hold for (real ones of a truth, unless it is made for planned ones), of an estimate the planned
ones. Points are those of every n-th pixel of the reference camera (``every``), with the image's grey or colour, in
double precision; their tracks are the images that show them, if the data set tells which (``visible``, at t = 0), and
else the reference image. Pixels without a surface give no point. Lost: dense depth, motion, the order of the cameras
on the stage.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.errors import Problem
from scenetruth.export.base import PictureOptions
from scenetruth.export.geometry import Pose, point_problems, points_in_world, pose_of, project
from scenetruth.export.raster import image_name, write_picture
from scenetruth.export.source import Source

__all__ = ["Colmap"]

_HALF_PIXEL = 0.5
_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class Colmap(PictureOptions):
    """Cameras and points as COLMAP's text model."""

    kind: Literal["colmap"] = "colmap"
    """Name of the format."""
    frame: int = 0
    """The frame t."""
    every: Annotated[int, Field(ge=1, le=10_000)] = 4
    """Pixels from one point to the next, along rows and columns."""
    summary: ClassVar[str] = "cameras, poses, points of one frame as COLMAP's text model, with the images"

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing."""
        yield from super().problems(source)
        if self.frame not in source.frames:
            yield Problem("frame", f"must be one of the frames {source.frames}", self.frame)
        yield from point_problems(source)

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write images, cameras, poses and points."""
        t, model = self.frame, folder / "sparse" / "0"
        model.mkdir(parents=True)
        rows, columns, points = self._points(source)
        colours = _colours(source.image(0, t)[rows, columns])
        images: list[str] = []
        tracks: list[list[str]] = [[] for _ in colours]
        for number, s in enumerate(source.cameras, start=1):
            name, pose = f"{image_name(s, t)}.png", pose_of(source, s, t)
            write_picture(folder / "images" / name, source.image(s, t), self.image_bits)
            seen = np.flatnonzero(_shown(source, s, t)[rows, columns]).tolist()
            places = (project(source, points[:, seen], pose) + _HALF_PIXEL).T.tolist()
            images.append(f"{number} {_numbers([*_quaternion(pose), *pose.translation_mm.tolist()])} 1 {name}")
            images.append(" ".join(f"{_numbers(place)} {n + 1}" for place, n in zip(places, seen, strict=True)))
            for index, n in enumerate(seen):
                tracks[n].append(f"{number} {index}")
        lines = [
            f"{number} {_numbers(point)} {colour} 0 {' '.join(track)}"
            for number, (point, colour, track) in enumerate(
                zip(points.T.tolist(), colours, tracks, strict=True), start=1
            )
        ]
        _write(model / "cameras.txt", "CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", [_camera(source)])
        head = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then POINTS2D[] as (X, Y, POINT3D_ID)"
        _write(model / "images.txt", head, images)
        _write(model / "points3D.txt", "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)", lines)
        return [f"{len(lines)} points of frame {t}; principal point and 2D points are in COLMAP's pixels (+0.5)"]

    def _points(self, source: Source) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
        """Return rows, columns and places (3, n) of the points of every n-th pixel."""
        points = points_in_world(source, 0, self.frame)
        rows, columns = np.nonzero(np.isfinite(points).all(axis=0))
        chosen = (rows % self.every == 0) & (columns % self.every == 0)
        return rows[chosen], columns[chosen], points[:, rows[chosen], columns[chosen]]


def _shown(source: Source, s: int, t: int) -> NDArray[np.bool_]:
    """Tell which points of the reference's pixels an image shows, shape (y, x)."""
    if s == 0:
        return np.full(source.size, True)
    # Of other frames than t = 0, nothing tells it.
    if "visible" not in source.maps or t != 0:
        return np.full(source.size, False)
    return np.asarray(source.maps["visible"].sel(s=s, t=t).values, dtype=bool)


def _colours(values: NDArray[np.float64]) -> list[str]:
    """Return red, green and blue of points, from values (n,) or (n, channel)."""
    bytes_ = np.rint(255 * np.clip(values, 0, 1)).astype(int).reshape(len(values), -1)
    bytes_ = bytes_ if bytes_.shape[1] == 3 else np.repeat(bytes_[:, :1], 3, axis=1)
    return [" ".join(map(str, colour)) for colour in bytes_.tolist()]


def _write(file: Path, head: str, lines: list[str]) -> None:
    file.write_text("".join(f"{line}\n" for line in [f"# {head}", *lines]), encoding="ascii")


def _camera(source: Source) -> str:
    own, (height, width) = source.intrinsics, source.size
    numbers = [own.focal_length_px, own.focal_length_px, *(value + _HALF_PIXEL for value in own.principal_point_px)]
    model = "PINHOLE"
    if source.distortion:
        model = "FULL_OPENCV"
        numbers += [source.distortion.get(name, 0.0) for name in _ORDER]
    return f"1 {model} {width} {height} {_numbers(numbers)}"


def _quaternion(pose: Pose) -> list[float]:
    """Return the quaternion (w, x, y, z) that turns the world to the camera."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose.axes.T).as_quat().tolist()
    return [-value for value in (w, x, y, z)] if w < 0 else [w, x, y, z]


def _numbers(values: list[float]) -> str:
    # -0.0 reads like a mistake.
    return " ".join(repr(float(value) + 0.0) for value in values)
