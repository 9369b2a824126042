"""The command `init` and its commented scene files: a cube, a leaf, or a user-defined mesh."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING

import typer

from scenetruth.cli import options
from scenetruth.cli.messages import print_wrote
from scenetruth.cli.options import TemplateType
from scenetruth.errors import visible

if TYPE_CHECKING:
    from scenetruth.errors import Problem
    from scenetruth.scene.mesh import TriangleMesh

__all__ = ["PlacedMesh", "SceneTemplate", "mesh_template", "place_mesh", "register", "scene_text"]


@dataclass(frozen=True)
class SceneTemplate:
    """Parameters of a scene template; ``objects``, ``blocks``, ``sensor`` and ``estimate`` are YAML.

    ``first``: Fields to change first, one per line.
    """

    summary: str
    first: tuple[str, ...]
    objects: str
    focal_length_px: float
    focal_note: str
    baseline_mm: float
    baseline_note: str
    frame_interval_s: float = 1.0
    blocks: str = ""
    sensor: str = "bit_depth: 8\nnoise_std: 0.01"
    estimate: str = "method: structure_tensor"


_TEXT = """\
{schema}
# {summary}
#
# Lengths are in mm, times in s, images in px. X points to the right, Y down, Z away from the camera, which is at the
# origin and faces +Z. All fields with their defaults: scenetruth schema. Bundled scenes: scenetruth list scenes.
#
# Fields to change first:
{first}
#
#     scenetruth check {file}                        validate the scene, predict resources and precision
#     scenetruth run {file} -o outputs/first         images, truth, estimate, score, report

# One-line description, shown in reports.
description: {description}

# The camera: image size in px, and focal length in px, which is the focal length in mm divided by the pixel pitch of
# the sensor in mm: 25 mm and 3.45 um are 7246 px.
camera:
  width: 640
  height: 480
  focal_length_px: {focal_length_px:g}        # {focal_note}

# The stage moves the camera along X: number of images per frame, and distance between them in mm. A longer baseline
# improves the precision of depth, provided that all images show the same surface.
stage:
  positions: 5
  baseline_mm: {baseline_mm:g}        # {baseline_note}

# Frames: number of scans of the stage, and time between them in s. Each frame contains the images of all positions.
# Motions are specified per frame, growth per hour.
frames:
  count: 9
  frame_interval_s: {frame_interval_s:g}

# The objects. Each has a name, a mesh (its shape), a texture (the radiance of its surface, from 0 to 1), a pose (at
# the reference frame, t = 0, the middle frame), and optionally deformation and motion.
objects:
{objects}
{blocks}
# The sensor: bits of a digital number, and the noise of a grey value as a fraction of full scale.
# `sensor: ideal` has neither.
sensor:
{sensor}

# Rendering: ray casting; every pixel is a mean over its area, by as many samples as texture and edges require.
render:
  backend: raycast
  supersampling: auto

# Estimation of depth and motion from the images: a method of `scenetruth list methods`, with its settings.
estimate:
{estimate}

# Scores of the interior exclude pixels closer to an edge than this, in px.
score:
  interior_margin_px: 20

# Seed of all random numbers, of textures and noise.
seed: 1
"""

_SCHEMA = "# yaml-language-server: $schema={}"
_NO_SCHEMA = """\
# Editors complete and check this file if the line `# yaml-language-server: $schema=scene.schema.json` precedes all
# others (including this text), and that file is in the same directory: scenetruth schema > scene.schema.json"""


def scene_text(start: SceneTemplate, file: str, schema: str = "") -> str:
    """Return the text of a scene file."""
    return _TEXT.format(
        schema=_SCHEMA.format(schema) if schema else _NO_SCHEMA,
        summary=start.summary,
        # File names may contain special characters of YAML.
        description=json.dumps(start.summary, ensure_ascii=False),
        first="\n".join(f"# - {line}" for line in start.first),
        file=visible(file, lines=False),
        sensor=indent(start.sensor, "  "),
        estimate=indent(start.estimate, "  "),
        objects=indent(start.objects.strip("\n"), "  "),
        focal_length_px=start.focal_length_px,
        focal_note=start.focal_note,
        baseline_mm=start.baseline_mm,
        baseline_note=start.baseline_note,
        frame_interval_s=start.frame_interval_s,
        blocks=f"\n{start.blocks.strip()}\n" if start.blocks else "",
    )


_CUBE = """
- name: cube
  # A box centred at its own origin, X x Y x Z. Others: plane, sphere, cylinder, torus, relief, leaf, file, ...
  mesh: {{kind: box, size_mm: [49, 49, 49]}}
  # Successive rotations about fixed axes (degrees, X towards Y about Z), then translation: position of its origin.
  pose:
    position_mm: [0, 0, 692.56]
    rotations:
      - {{axis: [0, 1, 0], angle_deg: 45}}
      - {{axis: [1, 0, 0], angle_deg: 20}}
  # {texture_note}
  texture: {texture}
  # Constant velocity in mm per frame, along X, Y, Z, here towards the camera. Others: rotation, waves, splines, ...
  motion:
    - {{kind: velocity, velocity_mm_per_frame: [0, 0, -1]}}
"""

_LEAF = """
- name: leaf
  # A leaf in the plane Z = 0, its petiole at the origin, its tip along +X; bent and folded out of that plane, degrees.
  mesh:
    kind: leaf
    outline: palmate
    lobes: 7
    lobe_cut: 0.5
    length_mm: 57
    width_mm: 89
    petiole: {length_mm: 30, diameter_mm: 2.4}
    bend_along_deg: -25
    bend_across_deg: -35
    fold_deg: 20
    resolution_mm: 0.8
  # Veins and mottling of a green leaf, in one channel of a camera: red, green or nir.
  texture: {kind: leaf, channel: green}
  pose:
    position_mm: [2, 13.5, 600]
    rotations:
      - {axis: [0, 1, 0], angle_deg: 10}
      - {axis: [0, 0, 1], angle_deg: -100}
  # Growth rate of the area per hour: 0.03 is 3 %/h. At the base (X = base_mm) 1.5 times as much as in the middle,
  # at the tip (X = tip_mm) half as much.
  deformation:
    - {kind: growth, rate_per_hour: 0.03, along_share: 0.6, base_to_tip: [1.5, 0.5], base_mm: -25, tip_mm: 57}
    # It also rises by 0.2 degrees per frame, about the end of its petiole.
    - {kind: hinge, axis: [0, 1, 0], point_mm: [-30, 0, 0], angle_deg: {kind: linear, rate_per_frame: 0.2}}
- name: soil
  mesh: {kind: plane, size_mm: [200, 160]}
  pose: {position_mm: [0, 0, 640]}
  texture: {kind: noise, wavelength_mm: [0.8, 6.0], mean: 0.12, rms_contrast: 0.3}
"""

_LIGHT = """
# The illumination: ambient light, and lamps; a directional lamp shines along its direction. Without this block, the
# texture values are the radiance.
lighting:
  ambient: 0.25
  lights:
    - {kind: directional, direction: [-0.6, 0.45, 0.65], irradiance: 0.85}
"""


def image_block(file: str) -> str:
    """Return the YAML of a texture that maps an image file onto a mesh."""
    return f"{{kind: image, file: {json.dumps(file)}, encoding: srgb}}"


def cube_template(image: str = "") -> SceneTemplate:
    """Return a cube that moves towards the camera, with a noise texture or an image."""
    noise = "{kind: noise, wavelength_mm: [0.8, 4.0], mean: 0.5, rms_contrast: 0.25}"
    text_ = "Noise with wavelengths in this range, here 6 to 30 px, with mean and contrast (standard deviation / mean)."
    if image:
        text_ = "An image, mapped onto each face; its grey values are sRGB, or linear."
    return SceneTemplate(
        summary="A textured cube that moves towards the camera",
        first=(
            "objects: shape, pose, motion and texture",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "sensor.noise_std: that of your camera",
        ),
        objects=_CUBE.format(texture=image_block(image) if image else noise, texture_note=text_),
        focal_length_px=5016,
        focal_note="field of view 84 x 63 mm at 660 mm",
        baseline_mm=5,
        baseline_note="disparity of 38 px per step at 660 mm",
    )


def leaf_template() -> SceneTemplate:
    """Return a growing leaf in front of soil, one frame per minute."""
    return SceneTemplate(
        summary="A growing leaf that rises, one frame per minute",
        first=(
            "objects.0.mesh: shape of the leaf; objects.0.deformation: growth rate",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "frames.frame_interval_s: time between frames; sensor.noise_std: that of your camera",
        ),
        objects=_LEAF,
        focal_length_px=3200,
        focal_note="field of view 120 x 90 mm at 600 mm",
        baseline_mm=5,
        baseline_note="disparity of 27 px per step at 600 mm",
        frame_interval_s=60,
        blocks=_LIGHT,
        sensor="bit_depth: 12\nnoise_std: 0.002",
        estimate="# Resolves slow growth in 1 to 2 min; structure_tensor takes 1 s and does not resolve it.\n"
        "method: refined",
    )


_WIDTH_PX, _HEIGHT_PX = 640, 480
_SHARE = 0.75
"""Fraction of the image covered by the mesh, with a margin for stage travel and motion."""
_DISPARITY_PX = 30.0
"""Disparity per step at the nearest point; twice that, on either side, is less than the margin of 80 px."""
_FAR = 10.0
"""Default distance, in sizes of the mesh perpendicular to the optical axis."""
_NEARER = 1 / 660
"""Fraction of its distance by which the mesh approaches per frame, as for the noise cube."""
_WAVES_PX = (6.0, 30.0)


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh file with its placement in the scene.

    ``position_mm``: Position of its origin, with its centre on the optical axis. ``distance_mm``: Distance of its
    nearest point from the camera, along Z. ``focal_length_px``: Focal length for which it covers three quarters of the
    image. ``baseline_mm``: Distance of stage positions with a disparity of 30 px at the nearest point. ``has_image``:
    Whether the file contains a texture image or colours. ``has_uv``: Whether it has UV coordinates for an image.
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
        """Description of mesh and placement, in one sentence."""
        size = " x ".join(f"{value:.4g}" for value in self.size_mm)
        return (
            f"{self.vertices:,} vertices and {self.faces:,} faces, {size} mm; its nearest point {self.distance_mm:g} "
            f"mm from the camera, with {self.focal_length_px:g} px of focal length"
        )


def place_mesh(file: Path, unit_mm: float = 1.0, distance_mm: float | None = None) -> PlacedMesh:
    """Read a mesh file, and choose position, focal length and baseline such that all of it is visible.

    ``unit_mm``: Length unit of the file in mm.
    ``distance_mm``: Distance of the nearest point in mm; default: ten times the size perpendicular to the optical axis.
    """
    from scenetruth.scene.mesh.mesh_file import load_mesh_file

    return _placed(load_mesh_file(file, unit_mm), distance_mm)


def _placed(read: TriangleMesh, distance_mm: float | None) -> PlacedMesh:
    # Unused vertices are ignored.
    used = read.vertices_mm[read.faces.ravel()]
    low, high = used.min(axis=0), used.max(axis=0)
    size = high - low
    across = float(max(size[0], size[1], 1e-3 * size[2]))
    distance = _rounded(_FAR * across) if distance_mm is None else distance_mm
    # Computed as if the whole mesh were at the depth of its nearest point.
    focal = (
        _SHARE
        * distance
        * min(_WIDTH_PX / max(float(size[0]), 1e-3 * across), _HEIGHT_PX / max(float(size[1]), 1e-3 * across))
    )
    focal = _rounded(focal, down=True)
    middle = (low + high) / 2
    position = (-float(middle[0]), -float(middle[1]), distance - float(low[2]))
    return PlacedMesh(
        vertices=len(read.vertices_mm),
        faces=len(read.faces),
        size_mm=(float(size[0]), float(size[1]), float(size[2])),
        position_mm=(_tidy(position[0], across), _tidy(position[1], across), _tidy(position[2], across)),
        distance_mm=distance,
        focal_length_px=focal,
        baseline_mm=_rounded(_DISPARITY_PX * distance / focal, down=True),
        has_image=read.appearance is not None,
        has_uv=read.uv is not None,
    )


def mesh_template(found: PlacedMesh, file: str, unit_mm: float = 1.0, image: str = "") -> SceneTemplate:
    """Return the template of a mesh file that moves towards the camera, with a noise texture or an image."""
    per_px = found.distance_mm / found.focal_length_px
    waves = [_rounded(px * per_px) for px in _WAVES_PX]
    texture = f"{{kind: noise, wavelength_mm: [{waves[0]:g}, {waves[1]:g}], mean: 0.5, rms_contrast: 0.25}}"
    text_ = "Noise with wavelengths in this range, here 6 to 30 px, with mean and contrast (standard deviation / mean)."
    if image:
        texture = image_block(image)
        text_ = "An image, mapped by the UV coordinates of the mesh; its grey values are sRGB, or linear."
    own = (
        "  # The texture of the file itself is used with `texture: {kind: embedded, encoding: srgb}`.\n"
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
  # Its nearest point is {found.distance_mm:g} mm from the camera, its centre on the optical axis. If its Y points up,
  # rotate it about X by 180 degrees, and check its new depth with `scenetruth check`.
  pose:
    position_mm: [{position}]
    rotations: []        # - {{axis: [1, 0, 0], angle_deg: 180}}
  # {text_}
{own}  texture: {texture}
  # Constant velocity in mm per frame, along X, Y, Z, here towards the camera. Others: rotation, waves, splines, ...
  motion:
    - {{kind: velocity, velocity_mm_per_frame: [0, 0, {-_rounded(_NEARER * found.distance_mm):g}]}}
"""
    return SceneTemplate(
        summary=f"The mesh of {visible(Path(file).name, lines=False)} that moves towards the camera",
        first=(
            "objects.0.pose: rotation and distance of the mesh; objects.0.motion: its motion",
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
    near = float(f"{value:.3g}")
    return near if not down or near <= value else float(f"{0.995 * value:.3g}")


def _tidy(value: float, across: float) -> float:
    step = 1e-5 * across
    return float(f"{round(value / step) * step:.9g}")


_BESIDE = "scene.schema.json"
_SMALL_MM = 1.0
"""Size below which a file of unspecified unit is probably in metres, such as glTF."""
_NO_UV = (
    "the mesh has no UV coordinates, which an image requires; OBJ, PLY and GLB (glTF) can contain them, STL and "
    "OFF cannot: export the mesh with UV coordinates, or omit --texture for a noise texture"
)


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    options.add_command(app, init)


def init(
    file: options.TemplateFile = Path("scene.yaml"),
    type: options.Type = None,
    mesh: options.Mesh = None,
    texture: options.Texture = None,
    *,
    unit_mm: options.UnitMm = None,
    distance_mm: options.MeshDistanceMm = None,
    schema: options.SchemaFile = None,
) -> None:
    """Write a commented scene file as a template."""
    from scenetruth.cli.console import print_warning
    from scenetruth.errors import Problem, SceneError, visible

    chosen = type or (TemplateType.mesh if mesh is not None else TemplateType.cube)
    problems = _problems(file, chosen, mesh, texture, unit_mm, distance_mm, schema)
    found: PlacedMesh | None = None
    if (
        chosen is TemplateType.mesh
        and mesh is not None
        and not {one.path for one in problems} & {"--unit-mm", "--distance-mm"}
    ):
        try:
            found = place_mesh(mesh, unit_mm or 1.0, distance_mm)
        except SceneError as error:
            problems += [_of_option("--mesh", one) for one in error.problems]
        else:
            if texture is not None and not found.has_uv:
                problems.append(Problem("--texture", _NO_UV, str(texture)))
    if problems:
        raise SceneError(problems)
    image = "" if texture is None else _seen_from(file, texture)
    if found is not None and mesh is not None:
        start = mesh_template(found, _seen_from(file, mesh), unit_mm or 1.0, image)
    else:
        start = leaf_template() if chosen is TemplateType.leaf else cube_template(image)
    _write(start, file, schema)
    if found is not None:
        typer.echo(visible(f"mesh: {found.words}"))
        if max(found.size_mm) < _SMALL_MM and unit_mm is None:
            print_warning(f"the mesh is less than {_SMALL_MM:g} mm wide; if its unit is metres: --unit-mm 1000")
    print_wrote(file, f"next: scenetruth check {file}")


def _problems(
    file: Path,
    kind: TemplateType,
    mesh: Path | None,
    texture: Path | None,
    unit_mm: float | None,
    distance_mm: float | None,
    schema: Path | None,
) -> list[Problem]:
    from scenetruth.errors import Problem

    found = []
    if file.suffix not in (".yaml", ".yml"):
        found.append(Problem("FILE", "must end in .yaml", str(file)))
    elif os.path.lexists(file):
        found.append(Problem("FILE", "exists already; use another name, or move it", str(file)))
    elif not file.absolute().parent.is_dir():
        found.append(Problem("FILE", "its directory does not exist", str(file)))
    if kind is TemplateType.mesh and mesh is None:
        found.append(Problem("--mesh", "is missing: the mesh file that the scene shows"))
    if kind is not TemplateType.mesh and mesh is not None:
        found.append(Problem("--mesh", f"requires --type mesh, not --type {kind.value}", str(mesh)))
    if texture is not None:
        found += _texture_problems(kind, texture)
    for name, value in (("--unit-mm", unit_mm), ("--distance-mm", distance_mm)):
        if value is not None and kind is not TemplateType.mesh:
            message = f"applies to a mesh; --type {kind.value} has a fixed size and position: omit it, and change"
            found.append(Problem(name, f"{message} objects in the written file", value))
        elif value is not None and not 0 < value < float("inf"):
            found.append(Problem(name, "must be a positive number of mm", value))
    if schema is not None and not schema.is_file():
        found.append(Problem("--schema", f"no such file; create it: scenetruth schema > {schema}", str(schema)))
    return found


def _texture_problems(kind: TemplateType, texture: Path) -> list[Problem]:
    from scenetruth.errors import Problem, SceneError
    from scenetruth.scene.texture.image_textures import read_image_header

    if kind is TemplateType.leaf:
        return [Problem("--texture", "a leaf has its own texture; use an image with a cube or a mesh", str(texture))]
    try:
        read_image_header(texture)
    except SceneError as error:
        return [_of_option("--texture", one) for one in error.problems]
    return []


def _of_option(option: str, problem: Problem) -> Problem:
    from scenetruth.errors import Problem

    return Problem(option, problem.message, problem.value)


def _seen_from(file: Path, other: Path) -> str:
    return Path(os.path.relpath(other.resolve(), file.absolute().parent.resolve())).as_posix()


def _write(start: SceneTemplate, file: Path, schema: Path | None) -> None:
    import yaml

    from scenetruth.scene import Scene

    beside = file.absolute().parent / _BESIDE
    pointed = schema if schema is not None else beside if beside.is_file() else None
    # Editors take the path up to the first space.
    place = "" if pointed is None else _seen_from(file, pointed).replace(" ", "%20")
    text = scene_text(start, str(file), place)
    Scene.from_dict(yaml.safe_load(text), source=file, folder=file.absolute().parent)
    with file.open("x", encoding="utf-8") as stream:
        stream.write(text)
