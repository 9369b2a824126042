"""Formats of cameras and points: COLMAP, OpenCV's YAML, PLY."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.errors import Problem
from scenetruth.exporters.camera_geometry import CameraPose, compute_pose, point_problems, points_in_world, project
from scenetruth.exporters.export_source import ExportSource
from scenetruth.exporters.format_base import ExportFormat, PictureOptions
from scenetruth.exporters.image_files import image_name, write_picture

__all__ = ["Colmap", "OpencvYaml", "Ply"]


_HALF_PIXEL = 0.5
_COLMAP_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class Colmap(PictureOptions):
    """Cameras and points of one frame as COLMAP's text model, with the images.

    ``images/s+0_t+0.png`` and ``sparse/0/cameras.txt``, ``images.txt``, ``points3D.txt``, for all cameras of one frame,
    because COLMAP assumes a rigid scene. In COLMAP, the centre of the upper left pixel is at (0.5, 0.5): the principal
    point and all 2D points are 0.5 px larger than in the data sets. Cameras are ``PINHOLE``, or ``FULL_OPENCV`` with
    lens distortion. Poses transform the world, in mm, to the camera, as a quaternion (w, x, y, z) and a translation:
    the poses of the maps (actual poses of a truth, unless computed for nominal poses), for an estimate the nominal
    poses. Points are those of every n-th pixel of the reference camera (``every``), with the grey value or colour of
    the image, in double precision; their tracks are the images in which they are visible, if available (``visible``, at
    t = 0), otherwise the reference image. Pixels without a surface yield no point. Lost: dense depth, motion, the order
    of the cameras on the stage.
    """

    kind: Literal["colmap"] = "colmap"
    """Name of the format."""
    frame: int = 0
    """The frame t."""
    every: Annotated[int, Field(ge=1, le=10_000)] = 4
    """Sampling interval of points along rows and columns, px."""
    summary: ClassVar[str] = "cameras, poses, points of one frame as COLMAP's text model, with the images"

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements."""
        yield from super().problems(source)
        if self.frame not in source.frames:
            yield Problem("frame", f"must be one of the frames {source.frames}", self.frame)
        yield from point_problems(source)

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write images, cameras, poses and points."""
        t, model = self.frame, folder / "sparse" / "0"
        model.mkdir(parents=True)
        rows, columns, points = self._points(source)
        colours = _colours(source.image(0, t)[rows, columns])
        images: list[str] = []
        tracks: list[list[str]] = [[] for _ in colours]
        for number, s in enumerate(source.cameras, start=1):
            name, pose = f"{image_name(s, t)}.png", compute_pose(source, s, t)
            write_picture(folder / "images" / name, source.image(s, t), self.image_bits)
            seen = np.flatnonzero(_select_points(source, s, t)[rows, columns]).tolist()
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
        _write_lines(model / "cameras.txt", "CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", [_colmap_camera(source)])
        head = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then POINTS2D[] as (X, Y, POINT3D_ID)"
        _write_lines(model / "images.txt", head, images)
        _write_lines(
            model / "points3D.txt", "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)", lines
        )
        return [f"{len(lines)} points of frame {t}; principal point and 2D points are in COLMAP's pixels (+0.5)"]

    def _points(self, source: ExportSource) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
        """Return rows, columns and positions (3, n) of the points of every n-th pixel."""
        points = points_in_world(source, 0, self.frame)
        rows, columns = np.nonzero(np.isfinite(points).all(axis=0))
        chosen = (rows % self.every == 0) & (columns % self.every == 0)
        return rows[chosen], columns[chosen], points[:, rows[chosen], columns[chosen]]


def _select_points(source: ExportSource, s: int, t: int) -> NDArray[np.bool_]:
    """Return the mask of the points of the reference camera that are visible in an image, shape (y, x)."""
    if s == 0:
        return np.full(source.size, True)
    # Visibility is available for t = 0 only.
    if "visible" not in source.maps or t != 0:
        return np.full(source.size, False)
    return np.asarray(source.maps["visible"].sel(s=s, t=t).values, dtype=bool)


def _colours(values: NDArray[np.float64]) -> list[str]:
    bytes_ = np.rint(255 * np.clip(values, 0, 1)).astype(int).reshape(len(values), -1)
    bytes_ = bytes_ if bytes_.shape[1] == 3 else np.repeat(bytes_[:, :1], 3, axis=1)
    return [" ".join(map(str, colour)) for colour in bytes_.tolist()]


def _write_lines(file: Path, head: str, lines: list[str]) -> None:
    file.write_text("".join(f"{line}\n" for line in [f"# {head}", *lines]), encoding="ascii")


def _colmap_camera(source: ExportSource) -> str:
    own, (height, width) = source.intrinsics, source.size
    numbers = [own.focal_length_px, own.focal_length_px, *(value + _HALF_PIXEL for value in own.principal_point_px)]
    model = "PINHOLE"
    if source.distortion:
        model = "FULL_OPENCV"
        numbers += [source.distortion.get(name, 0.0) for name in _COLMAP_ORDER]
    return f"1 {model} {width} {height} {_numbers(numbers)}"


def _quaternion(pose: CameraPose) -> list[float]:
    """Return the quaternion (w, x, y, z) of the rotation from the world to the camera."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose.axes.T).as_quat().tolist()
    return [-value for value in (w, x, y, z)] if w < 0 else [w, x, y, z]


def _numbers(values: list[float]) -> str:
    # Avoid -0.0.
    return " ".join(repr(float(value) + 0.0) for value in values)


_OPENCV_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class OpencvYaml(ExportFormat):
    """Cameras as OpenCV's FileStorage YAML, one file per camera, or per image with actual poses.

    ``s+0.yml`` contains ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` (k1 k2 p1 p2
    k3 k4 k5 k6, all zero for a pinhole), ``rotation_matrix`` R, ``rotation_vector`` and ``translation_vector`` T: a
    point X of the world, in mm, is at R X + T in the frame of the camera, as required by `cv2.projectPoints`. Pixel
    centres are integers, as in OpenCV. World: X right, Y down, Z forward, origin at the nominal position of the
    reference camera.
    ``poses: nominal`` writes one file per camera; ``poses: actual``, which needs a truth, writes ``s+0_t+0.yml`` per
      image with its actual pose. Numbers have 17 digits. Lost: images, maps, times, sensor noise.
    """

    kind: Literal["opencv_yaml"] = "opencv_yaml"
    """Name of the format."""
    poses: Literal["nominal", "actual"] = "nominal"
    """``nominal``: one file per camera; ``actual``: one file per image, with the poses of the truth."""
    summary: ClassVar[str] = "cameras as OpenCV's YAML: matrix, distortion, pose"

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements of actual poses."""
        if self.poses == "actual" and "camera_position_mm" not in source.maps:
            yield Problem("poses", "needs the actual poses of a truth; use 'nominal', or export the truth", "actual")

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write the cameras."""
        for s in source.cameras:
            if self.poses == "nominal":
                pose = compute_pose(source, s, source.frames[0], real=False)
                (folder / f"s{s:+d}.yml").write_text(_opencv_camera(source, pose), encoding="ascii")
                continue
            for t in source.frames:
                text = _opencv_camera(source, compute_pose(source, s, t, real=True))
                (folder / f"{image_name(s, t)}.yml").write_text(text, encoding="ascii")
        return []


def _opencv_camera(source: ExportSource, pose: CameraPose) -> str:
    from scipy.spatial.transform import Rotation

    own, (height, width) = source.intrinsics, source.size
    (c_x, c_y), f = own.principal_point_px, own.focal_length_px
    matrices = {
        "camera_matrix": np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1]]),
        "distortion_coefficients": np.array([[source.distortion.get(name, 0.0) for name in _OPENCV_ORDER]]),
        "rotation_matrix": pose.axes.T,
        "rotation_vector": Rotation.from_matrix(pose.axes.T).as_rotvec()[:, None],
        "translation_vector": pose.translation_mm[:, None],
    }
    head = f"%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\n"
    return head + "".join(f"{name}: {_opencv_matrix(values)}" for name, values in matrices.items())


def _opencv_matrix(values: NDArray[np.float64]) -> str:
    rows, columns = values.shape
    # Avoid -0.0.
    data = ", ".join(repr(float(value) + 0.0) for value in values.ravel())
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"


_SCALARS = ("growth_rate", "depth_std", "depth_std_common", "growth_rate_std", "growth_rate_std_common")


class Ply(ExportFormat):
    """Surface points as PLY, binary little endian, one file per camera and frame.

    ``s+0_t+0.ply`` has one vertex per pixel that shows a surface: ``x y z`` in float64, mm, in the world, which is the
      frame of the nominal reference camera (X right, Y down, Z forward), ``red green blue`` (grey value or colour of
      the image, full scale 255), ``column row`` of the pixel, and where available ``nx ny nz`` (unit normal, towards
      the camera),
    ``velocity_x velocity_y velocity_z`` (instantaneous, mm per frame), ``growth_rate`` (areal growth rate, per frame),
    ``depth_std`` and ``growth_rate_std`` (stated standard deviations), each with ``_common`` (the part that pixels have
    in common), and ``object_id``. Vectors refer to the axes of the world; normals, velocities and scalars are float32.
    Points of cameras with actual poses are at their actual positions. Viewers with an upward Y axis show them upside
    down. Pixels without a surface or a depth have no vertex; invalid velocities are NaN. A velocity is not a
    displacement to the next frame.
    Lost: visibility in other images, digits of vectors beyond float32.
    """

    kind: Literal["ply"] = "ply"
    """Name of the format."""
    coordinates: Literal["float64", "float32"] = "float64"
    """Type of x, y and z; float32 moves points by up to 6e-8 of their distance."""
    summary: ClassVar[str] = "surface points with colour, normal, velocity, growth as .ply"
    packages: ClassVar[tuple[str, ...]] = ("plyfile",)

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements."""
        yield from source.picture_problems()
        yield from point_problems(source)

    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write one file per image with maps."""
        from plyfile import PlyData, PlyElement

        comments = ["made by scenetruth", "mm; X right, Y down, Z forward", "velocity in mm per frame, instantaneous"]
        count = 0
        for s in source.views:
            for t in source.frames:
                vertices = self._vertices(source, s, t)
                count += len(vertices)
                data = PlyData([PlyElement.describe(vertices, "vertex")], text=False, byte_order="<", comments=comments)
                data.write(str(folder / f"{image_name(s, t)}.ply"))
        return [f"{count} points"]

    def _vertices(self, source: ExportSource, s: int, t: int) -> NDArray[Any]:
        points = points_in_world(source, s, t)
        rows, columns = np.nonzero(np.isfinite(points).all(axis=0))
        image = source.image(s, t)[rows, columns]
        colours = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8).reshape(len(rows), -1)
        # Grey images have one channel, written as three equal colours.
        colours = colours if colours.shape[1] == 3 else np.repeat(colours[:, :1], 3, axis=1)
        fields: dict[str, NDArray[Any]] = {
            name: points[axis, rows, columns].astype(self.coordinates) for axis, name in enumerate("xyz")
        }
        axes = compute_pose(source, s, t).axes
        for map_name, names in (
            ("normal", ("nx", "ny", "nz")),
            ("velocity", ("velocity_x", "velocity_y", "velocity_z")),
        ):
            if map_name in source.maps:
                turned = axes @ source.map(map_name, s, t)[:, rows, columns]
                fields |= dict(zip(names, turned.astype(np.float32), strict=True))
        fields |= dict(zip(("red", "green", "blue"), colours.T, strict=True))
        for name in _SCALARS:
            if name in source.maps:
                fields[name] = source.map(name, s, t)[rows, columns].astype(np.float32)
        if "object_id" in source.maps:
            fields["object_id"] = source.raw("object_id", s, t)[rows, columns].astype(np.int32)
        fields |= {"column": columns.astype(np.int32), "row": rows.astype(np.int32)}
        vertices = np.empty(len(rows), dtype=[(name, values.dtype) for name, values in fields.items()])
        for name, values in fields.items():
            vertices[name] = values
        return vertices
