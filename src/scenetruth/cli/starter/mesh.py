"""A scene to start from around a mesh file: read, measured, and placed so that the camera sees all of it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.cli.starter.kinds import image_block
from scenetruth.cli.starter.text import Start
from scenetruth.errors import visible

if TYPE_CHECKING:
    from scenetruth.scene.mesh import TriangleMesh

__all__ = ["Measured", "mesh_start", "place_mesh"]

_WIDTH_PX, _HEIGHT_PX = 640, 480
_SHARE = 0.75
"""Part of the image that the mesh takes: the rest is for the stage's way and for motion."""
_DISPARITY_PX = 30.0
"""Disparity from image to image at the nearest point: twice that, to either side, is less than the margin of 80 px."""
_FAR = 10.0
"""Distance, where none is given, in sizes of the mesh across the line of sight."""
_NEARER = 1 / 660
"""Part of its distance by which the mesh comes nearer from frame to frame, as the noise cube does."""
_WAVES_PX = (6.0, 30.0)


@dataclass(frozen=True)
class Measured:
    """A mesh file as read, and where it was placed.

    Parameters
    ----------
    vertices, faces
        How many it has.
    size_mm
        Its size along X, Y and Z.
    position_mm
        Where its origin stands: its middle on the camera's axis, its nearest point at the distance.
    distance_mm
        Distance of its nearest point from the camera, along Z.
    focal_length_px
        Focal length with which it takes three quarters of the image.
    baseline_mm
        Way of the stage with 30 px of disparity at the nearest point.
    has_image
        Whether the file brings a texture image or colours of its own.
    has_uv
        Whether an image can be laid on it.
    """

    vertices: int
    faces: int
    size_mm: tuple[float, float, float]
    position_mm: tuple[float, float, float]
    distance_mm: float
    focal_length_px: float
    baseline_mm: float
    has_image: bool
    has_uv: bool

    @property
    def words(self) -> str:
        """What was read, and where it was placed, in one sentence."""
        size = " x ".join(f"{value:.4g}" for value in self.size_mm)
        return (
            f"{self.vertices:,} vertices and {self.faces:,} faces, {size} mm; its nearest point {self.distance_mm:g} "
            f"mm from the camera, with {self.focal_length_px:g} px of focal length"
        )


def place_mesh(file: Path, unit_mm: float = 1.0, distance_mm: float | None = None) -> Measured:
    """Read a mesh file, and find place, focal length and baseline with which the camera sees all of it.

    Parameters
    ----------
    file
        OBJ, PLY, GLB, STL or OFF.
    unit_mm
        Length of the file's unit in mm.
    distance_mm
        Distance of the nearest point in mm; ten times the mesh's size across the line of sight if not given.

    Returns
    -------
    Measured
        Its size and its place.

    Raises
    ------
    SceneError
        If the file cannot be read as a mesh.
    """
    from scenetruth.scene.mesh.file import load

    return _placed(load(file, unit_mm), distance_mm)


def _placed(read: TriangleMesh, distance_mm: float | None) -> Measured:
    # Vertices that no face uses are not seen.
    used = read.vertices_mm[read.faces.ravel()]
    low, high = used.min(axis=0), used.max(axis=0)
    size = high - low
    across = float(max(size[0], size[1], 1e-3 * size[2]))
    distance = _rounded(_FAR * across) if distance_mm is None else distance_mm
    # At the depth of its nearest point the whole of it would still fit.
    focal = (
        _SHARE
        * distance
        * min(_WIDTH_PX / max(float(size[0]), 1e-3 * across), _HEIGHT_PX / max(float(size[1]), 1e-3 * across))
    )
    focal = _rounded(focal, down=True)
    middle = (low + high) / 2
    position = (-float(middle[0]), -float(middle[1]), distance - float(low[2]))
    return Measured(
        vertices=len(read.vertices_mm),
        faces=len(read.faces),
        size_mm=(float(size[0]), float(size[1]), float(size[2])),
        position_mm=(_tidy(position[0], across), _tidy(position[1], across), _tidy(position[2], across)),
        distance_mm=distance,
        focal_length_px=focal,
        baseline_mm=_rounded(_DISPARITY_PX * distance / focal, down=True),
        has_image=read.image is not None or read.vertex_colours is not None,
        has_uv=read.uv is not None,
    )


def mesh_start(found: Measured, file: str, unit_mm: float = 1.0, image: str = "") -> Start:
    """Return a mesh file that comes towards the camera, with noise on it or an image.

    Parameters
    ----------
    found
        The mesh, as of `place_mesh`.
    file
        Its path, as seen from the scene file.
    unit_mm
        Length of the file's unit in mm.
    image
        Path of an image file, as seen from the scene file; empty for noise.
    """
    per_px = found.distance_mm / found.focal_length_px
    waves = [_rounded(px * per_px) for px in _WAVES_PX]
    texture = f"{{kind: noise, wavelength_mm: [{waves[0]:g}, {waves[1]:g}], mean: 0.5, rms_contrast: 0.25}}"
    told = "Noise with waves of these lengths, here 6 to 30 px, of this mean and contrast (standard deviation / mean)."
    if image:
        texture = image_block(image)
        told = "An image, laid on the surface by the mesh's UV coordinates; its grey values are sRGB, or linear."
    own = (
        "  # What the file brings along is seen with `texture: {kind: own, encoding: srgb}`.\n"
        if found.has_image
        else ""
    )
    size = " x ".join(f"{value:.4g}" for value in found.size_mm)
    seen = " x ".join(f"{length * per_px:.4g}" for length in (_WIDTH_PX, _HEIGHT_PX))
    position = ", ".join(f"{value:.9g}" for value in found.position_mm)
    objects = f"""
- name: object
  # {found.vertices:,} vertices and {found.faces:,} faces, {size} mm. The file's X points to the right, its Y down,
  # its Z away from the camera; unit_mm is the length of its unit in mm.
  mesh: {{kind: file, file: {json.dumps(file)}, unit_mm: {unit_mm:g}}}
  # Its nearest point is {found.distance_mm:g} mm from the camera, its middle on the camera's axis. If its Y points up,
  # turn it about X by 180 degrees, and see `scenetruth check` for its new depth.
  pose:
    position_mm: [{position}]
    rotations: []        # - {{axis: [1, 0, 0], angle_deg: 180}}
  # {told}
{own}  texture: {texture}
  # Constant velocity in mm per frame, along X, Y, Z: this one comes nearer. Others: rotation, waves, splines, ...
  motion:
    - {{kind: velocity, velocity_mm_per_frame: [0, 0, {-_rounded(_NEARER * found.distance_mm):g}]}}
"""
    return Start(
        summary=f"The mesh of {visible(Path(file).name, lines=False)} that comes towards the camera",
        first=(
            "objects.0.pose: how the mesh is turned, and how far away it is; objects.0.motion: how it moves",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "sensor.noise_std: that of your camera",
        ),
        objects=objects,
        focal_length_px=found.focal_length_px,
        focal_note=f"{seen} mm are seen at {found.distance_mm:g} mm",
        baseline_mm=found.baseline_mm,
        baseline_note=f"30 px of disparity from image to image, at {found.distance_mm:g} mm",
    )


def _rounded(value: float, *, down: bool = False) -> float:
    """Return a positive number with three digits; no larger than it was if ``down``."""
    near = float(f"{value:.3g}")
    return near if not down or near <= value else float(f"{0.995 * value:.3g}")


def _tidy(value: float, across: float) -> float:
    """Return a position to a hundred-thousandth of the mesh's size; what is less counts as zero."""
    step = 1e-5 * across
    return float(f"{round(value / step) * step:.9g}")
