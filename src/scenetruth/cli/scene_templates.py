"""The command `init` and the commented scene files it writes: a cube, a leaf, or a mesh of the user."""

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
    """What distinguishes one scene to start from among others.

    ``summary``: What the scene shows, in one line.
    ``first``: What to change first, a line each.
    ``objects``: The list of objects, in YAML with comments.
    ``focal_length_px``, ``focal_note``: Focal length of the camera in px, and what that makes of the scene.
    ``baseline_mm``, ``baseline_note``: Way of the stage from position to position in mm, and what that makes of the
      scene.
    ``frame_interval_s``: Time from frame to frame in s.
    ``blocks``: Further blocks, in YAML with comments.
    ``sensor``, ``estimate``: Fields of the sensor and of the method, in YAML.
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
# Lengths are in mm, times in s, images in px. X points to the right, Y down, Z away from the camera, which looks along
# +Z from the origin. All fields with their defaults: scenetruth schema. Scenes to copy from: scenetruth list scenes.
#
# What to change first:
{first}
#
#     scenetruth check {file}                        what will be made of it, and what that takes
#     scenetruth run {file} -o outputs/first         images, truth, estimate, score, report

# What the scene is for, in one line; pages show it.
description: {description}

# The camera: size of the images in px, and focal length in px, which is the one in mm divided by the distance of two
# pixels on the sensor in mm: 25 mm and 3.45 um are 7246 px.
camera:
  width: 640
  height: 480
  focal_length_px: {focal_length_px:g}        # {focal_note}

# The stage carries the camera along X: so many images of every frame, so many mm from one to the next. A longer way
# tells depth better, as far as all images still show the same.
stage:
  positions: 5
  baseline_mm: {baseline_mm:g}        # {baseline_note}

# Frames: how often the stage takes its images, and how many seconds pass from one frame to the next. Motions are told
# per frame, growth per hour.
frames:
  count: 9
  frame_interval_s: {frame_interval_s:g}

# What stands before the camera. Each object has a name, a mesh (its shape), a texture (what is seen on it: radiance
# from 0 to 1), a pose (where it stands at the reference frame, t = 0, the middle one), and may deform and move.
objects:
{objects}
{blocks}
# The sensor: bits of a digital number, and the noise of a grey value as a fraction of full scale.
# `sensor: ideal` has neither.
sensor:
{sensor}

# How images are made: OpenGL where it runs, else ray casting; every pixel is a mean of 4 x 4 samples.
render:
  backend: auto
  supersampling: 4

# How depth and motion are estimated from the images: any of `scenetruth list methods`, with its settings.
estimate:
{estimate}

# Scores of the interior leave out what is nearer to an edge than this, in px.
score:
  interior_margin_px: 20

# All random numbers, of textures and noise, follow from this one.
seed: 1
"""

_SCHEMA = "# yaml-language-server: $schema={}"
_NO_SCHEMA = """\
# Editors complete and check this file if a line `# yaml-language-server: $schema=scene.schema.json` stands above all
# others (not behind this text), and that file lies beside it: scenetruth schema > scene.schema.json"""


def scene_text(start: SceneTemplate, file: str, schema: str = "") -> str:
    """Return the text of a scene file."""
    return _TEXT.format(
        schema=_SCHEMA.format(schema) if schema else _NO_SCHEMA,
        summary=start.summary,
        # Names of files may hold what YAML takes for something else.
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
  # A box about its own origin, X x Y x Z. Others: plane, sphere, cylinder, torus, relief, leaf, file, ...
  mesh: {{kind: box, size_mm: [49, 49, 49]}}
  # Turned about fixed axes one after the other (degrees, X towards Y about Z), then moved: position of its origin.
  pose:
    position_mm: [0, 0, 692.56]
    rotations:
      - {{axis: [0, 1, 0], angle_deg: 45}}
      - {{axis: [1, 0, 0], angle_deg: 20}}
  # {texture_note}
  texture: {texture}
  # Constant velocity in mm per frame, along X, Y, Z: this one comes nearer. Others: rotation, waves, splines, ...
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
  # Veins and mottling, as a green leaf has them in one channel of a camera: red, green or nir.
  texture: {kind: leaf, channel: green}
  pose:
    position_mm: [2, 13.5, 600]
    rotations:
      - {axis: [0, 1, 0], angle_deg: 10}
      - {axis: [0, 0, 1], angle_deg: -100}
  # Growth of the area per hour: 0.03 are 3 %/h. At the base one and a half times as much as in the middle, at the tip
  # half as much: from X = base_mm to X = tip_mm.
  deformation:
    - {kind: growth, rate_per_hour: 0.03, base_to_tip: [1.5, 0.5], base_mm: -25, tip_mm: 57}
    # And it rises by 0.2 degrees per frame, about the end of its petiole.
    - {kind: hinge, axis: [0, 1, 0], point_mm: [-30, 0, 0], angle_deg: {kind: linear, rate_per_frame: 0.2}}
- name: soil
  mesh: {kind: plane, size_mm: [200, 160]}
  pose: {position_mm: [0, 0, 640]}
  texture: {kind: noise, wavelength_mm: [0.8, 6.0], mean: 0.12, rms_contrast: 0.3}
"""

_LIGHT = """
# The light: as much from everywhere, and lamps; a directional one shines along its direction. Without this block, what
# textures say is what the camera sees.
lighting:
  ambient: 0.25
  lights:
    - {kind: directional, direction: [-0.6, 0.45, 0.65], irradiance: 0.85}
"""


def image_block(file: str) -> str:
    """Return the texture that lays an image file on a mesh, in YAML."""
    return f"{{kind: image, file: {json.dumps(file)}, encoding: srgb}}"


def cube_template(image: str = "") -> SceneTemplate:
    """Return a cube that comes towards the camera, with noise on it or an image."""
    noise = "{kind: noise, wavelength_mm: [0.8, 4.0], mean: 0.5, rms_contrast: 0.25}"
    told = "Noise with waves of these lengths, here 6 to 30 px, of this mean and contrast (standard deviation / mean)."
    if image:
        told = "An image, laid on each face; its grey values are sRGB, or linear."
    return SceneTemplate(
        summary="A textured cube that comes towards the camera",
        first=(
            "objects: the shape, where it stands and how it moves; what is seen on it",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "sensor.noise_std: that of your camera",
        ),
        objects=_CUBE.format(texture=image_block(image) if image else noise, texture_note=told),
        focal_length_px=5016,
        focal_note="84 x 63 mm are seen at 660 mm",
        baseline_mm=5,
        baseline_note="38 px of disparity from image to image, at 660 mm",
    )


def leaf_template() -> SceneTemplate:
    """Return a growing leaf in front of soil, one frame a minute."""
    return SceneTemplate(
        summary="A growing leaf that rises, one frame a minute",
        first=(
            "objects.0.mesh: the form of the leaf; objects.0.deformation: how fast it grows",
            "camera.focal_length_px and stage.baseline_mm: those of your rig",
            "frames.frame_interval_s: how often you take images; sensor.noise_std: that of your camera",
        ),
        objects=_LEAF,
        focal_length_px=3200,
        focal_note="120 x 90 mm are seen at 600 mm",
        baseline_mm=5,
        baseline_note="27 px of disparity from image to image, at 600 mm",
        frame_interval_s=60,
        blocks=_LIGHT,
        sensor="bit_depth: 12\nnoise_std: 0.002",
        estimate="# Sees slow growth, and takes a minute or two; structure_tensor takes a second, and does not.\n"
        "method: refined",
    )


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
class PlacedMesh:
    """A mesh file as read, and where it was placed.

    ``vertices``, ``faces``: How many it has.
    ``size_mm``: Its size along X, Y and Z.
    ``position_mm``: Where its origin stands: its middle on the camera's axis, its nearest point at the distance.
    ``distance_mm``: Distance of its nearest point from the camera, along Z.
    ``focal_length_px``: Focal length with which it takes three quarters of the image.
    ``baseline_mm``: Way of the stage with 30 px of disparity at the nearest point.
    ``has_image``: Whether the file brings a texture image or colours of its own.
    ``has_uv``: Whether an image can be laid on it.
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


def place_mesh(file: Path, unit_mm: float = 1.0, distance_mm: float | None = None) -> PlacedMesh:
    """Read a mesh file, and find place, focal length and baseline with which the camera sees all of it.

    ``unit_mm``: Length of the file's unit in mm.
    ``distance_mm``: Distance of the nearest point in mm; ten times the mesh's size across the line of sight if not
      given.
    """
    from scenetruth.scene.mesh.mesh_file import load_mesh_file

    return _placed(load_mesh_file(file, unit_mm), distance_mm)


def _placed(read: TriangleMesh, distance_mm: float | None) -> PlacedMesh:
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
    return PlacedMesh(
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


def mesh_template(found: PlacedMesh, file: str, unit_mm: float = 1.0, image: str = "") -> SceneTemplate:
    """Return a mesh file that comes towards the camera, with noise on it or an image.

    ``unit_mm``: Length of the file's unit in mm.
    """
    per_px = found.distance_mm / found.focal_length_px
    waves = [_rounded(px * per_px) for px in _WAVES_PX]
    texture = f"{{kind: noise, wavelength_mm: [{waves[0]:g}, {waves[1]:g}], mean: 0.5, rms_contrast: 0.25}}"
    told = "Noise with waves of these lengths, here 6 to 30 px, of this mean and contrast (standard deviation / mean)."
    if image:
        texture = image_block(image)
        told = "An image, laid on the surface by the mesh's UV coordinates; its grey values are sRGB, or linear."
    own = (
        "  # What the file brings along is seen with `texture: {kind: embedded, encoding: srgb}`.\n"
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
    return SceneTemplate(
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


_BESIDE = "scene.schema.json"
_SMALL_MM = 1.0
"""What is smaller, in a file whose unit was not given, is most likely in metres, as glTF is."""
_NO_UV = (
    "the mesh has no UV coordinates, by which an image is laid on it; OBJ, PLY and GLB (glTF) can carry them, STL and "
    "OFF never do: export it with them, or leave out --texture for noise, which needs none"
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
    """Return all that is wrong with the command, before anything is read or written."""
    from scenetruth.errors import Problem

    found = []
    if file.suffix not in (".yaml", ".yml"):
        found.append(Problem("FILE", "must end in .yaml", str(file)))
    elif os.path.lexists(file):
        found.append(Problem("FILE", "exists already; give another name, or put it away", str(file)))
    elif not file.absolute().parent.is_dir():
        found.append(Problem("FILE", "its folder does not exist", str(file)))
    if kind is TemplateType.mesh and mesh is None:
        found.append(Problem("--mesh", "is missing: the mesh file that the scene shows"))
    if kind is not TemplateType.mesh and mesh is not None:
        found.append(Problem("--mesh", f"goes with --type mesh, not with --type {kind.value}", str(mesh)))
    if texture is not None:
        found += _texture_problems(kind, texture)
    for name, value in (("--unit-mm", unit_mm), ("--distance-mm", distance_mm)):
        if value is not None and kind is not TemplateType.mesh:
            message = (
                f"belongs to a mesh; --type {kind.value} has a size and a place of its own: leave it out, and change"
            )
            found.append(Problem(name, f"{message} objects in the file that is written", value))
        elif value is not None and not 0 < value < float("inf"):
            found.append(Problem(name, "must be a positive number of mm", value))
    if schema is not None and not schema.is_file():
        found.append(Problem("--schema", f"no such file; make it: scenetruth schema > {schema}", str(schema)))
    return found


def _texture_problems(kind: TemplateType, texture: Path) -> list[Problem]:
    from scenetruth.errors import Problem, SceneError
    from scenetruth.scene.texture.image_textures import read_image_header

    if kind is TemplateType.leaf:
        return [Problem("--texture", "a leaf has its own texture; give an image with a cube or a mesh", str(texture))]
    try:
        read_image_header(texture)
    except SceneError as error:
        return [_of_option("--texture", one) for one in error.problems]
    return []


def _of_option(option: str, problem: Problem) -> Problem:
    from scenetruth.errors import Problem

    return Problem(option, problem.message, problem.value)


def _seen_from(file: Path, other: Path) -> str:
    """Return the path of another file as it is seen from the folder of a file."""
    return Path(os.path.relpath(other.resolve(), file.absolute().parent.resolve())).as_posix()


def _write(start: SceneTemplate, file: Path, schema: Path | None) -> None:
    """Write the scene if it is one, and only where nothing is."""
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
