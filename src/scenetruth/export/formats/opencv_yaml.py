"""Cameras as OpenCV's FileStorage YAML, one file for each camera, or for each image where poses change.

``s+0.yml`` has ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` (k1 k2 p1 p2 k3 k4
k5 k6, all zero for a pinhole), ``rotation_matrix`` R, ``rotation_vector`` and ``translation_vector`` T, with which a
point X of the world, in mm, is at R X + T in the frame of the camera: what `cv2.projectPoints` takes. Pixel centres
are integers, as in OpenCV. World: X right, Y down, Z forward, the origin where the reference camera is planned to
stand. ``poses: planned`` gives one file for each camera; ``poses: real``, which needs a truth, ``s+0_t+0.yml`` for
each image: where it was taken in fact. Numbers have 17 digits. Lost: images, maps, times, the noise of the sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.export.base import ExportFormat
from scenetruth.export.geometry import Pose, pose_of
from scenetruth.export.raster import image_name
from scenetruth.export.source import Source

__all__ = ["OpencvYaml"]

_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class OpencvYaml(ExportFormat):
    """Cameras as OpenCV's YAML."""

    kind: Literal["opencv_yaml"] = "opencv_yaml"
    """Name of the format."""
    poses: Literal["planned", "real"] = "planned"
    """``planned``: one file for each camera; ``real``: one for each image, as the truth tells it."""
    summary: ClassVar[str] = "cameras as OpenCV's YAML: matrix, distortion, pose"

    def problems(self, source: Source) -> Iterator[Problem]:
        """Give what is missing of real poses."""
        if self.poses == "real" and "camera_position_mm" not in source.maps:
            yield Problem("poses", "needs the poses that a truth tells; take 'planned', or the truth", "real")

    def write(self, source: Source, folder: Path) -> list[str]:
        """Write the cameras."""
        for s in source.cameras:
            if self.poses == "planned":
                pose = pose_of(source, s, source.frames[0], real=False)
                (folder / f"s{s:+d}.yml").write_text(_camera(source, pose), encoding="ascii")
                continue
            for t in source.frames:
                text = _camera(source, pose_of(source, s, t, real=True))
                (folder / f"{image_name(s, t)}.yml").write_text(text, encoding="ascii")
        return []


def _camera(source: Source, pose: Pose) -> str:
    from scipy.spatial.transform import Rotation

    own, (height, width) = source.intrinsics, source.size
    (c_x, c_y), f = own.principal_point_px, own.focal_length_px
    matrices = {
        "camera_matrix": np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1]]),
        "distortion_coefficients": np.array([[source.distortion.get(name, 0.0) for name in _ORDER]]),
        "rotation_matrix": pose.axes.T,
        "rotation_vector": Rotation.from_matrix(pose.axes.T).as_rotvec()[:, None],
        "translation_vector": pose.translation_mm[:, None],
    }
    head = f"%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\n"
    return head + "".join(f"{name}: {_matrix(values)}" for name, values in matrices.items())


def _matrix(values: NDArray[np.float64]) -> str:
    rows, columns = values.shape
    # -0.0 reads like a mistake.
    data = ", ".join(repr(float(value) + 0.0) for value in values.ravel())
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"
