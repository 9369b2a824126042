"""The workload of a scene, counted from its models alone: no mesh is made, no texture painted, no file decoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scenetruth.cache import has_entry
from scenetruth.camera import build_sensor_chain
from scenetruth.errors import Problem, SceneError
from scenetruth.random_streams import generator_for
from scenetruth.render.lens_and_shutter import fine_parts, margin_px
from scenetruth.resources.limits import Limits, too_much
from scenetruth.scene.built_scene import add_missing_files
from scenetruth.scene.leaf.leaf_mesh import LeafMesh
from scenetruth.scene.mesh import MeshSize, TriangleMesh
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.scene_object import SceneObject
from scenetruth.scene.texture.image_textures import ImageTexture

__all__ = [
    "MethodWorkload",
    "ObjectWorkload",
    "RecordingWorkload",
    "Workload",
    "compute_workload",
    "limit_problems",
    "list_object_workloads",
    "object_problems",
    "sharp_images",
]

SKETCHED_FACES = 1_000
"""Triangles of a sketch of an object."""

_ALL_RUN: dict[str, bool | None] = {"pyrender": False, "auto": None}

_AUTOMATIC_MOMENTS = 16
"""Moments of an exposure that are assumed where motion decides: that of four pixels."""


@dataclass(frozen=True, eq=False)
class ObjectWorkload:
    """One object of a scene, a leaf too, as far as it is known without being made.

    ``path``, ``item``: The object's path in the scene, and the object.
    ``size``: How large its mesh will be.
    ``sketch``: A coarse mesh of about its form; None if its file is too large to be read in passing.
    ``texels``: Points of its texture.
    ``painted``: Whether the finished texture is kept from an earlier run.
    """

    path: str
    item: SceneObject
    size: MeshSize
    sketch: TriangleMesh | None
    texels: int
    painted: bool


@dataclass(frozen=True)
class MethodWorkload:
    """What a method of estimation takes.

    ``in_memory``: Whether it holds all frames.
    ``bytes_per_pixel``: Memory for a pixel of the frames that are estimated together.
    ``pixels_at_once``: Pixels of all frames that are estimated together, if one frame has no more.
    ``seconds_per_sample``: Time for a pixel of one image of an estimated frame, on two processors.
    """

    in_memory: bool = False
    bytes_per_pixel: float = 195.0
    pixels_at_once: float = 2.3e6
    seconds_per_sample: float = 1.6e-6


@dataclass(frozen=True)
class RecordingWorkload:
    """What the work on a recording grows with.

    ``pixels``: Pixels of one image.
    ``positions``: Cameras, of all rows.
    ``frames``: Frames.
    ``sample_bytes``: Bytes of a pixel.
    ``effort``: What the method of estimation takes.
    """

    pixels: float
    positions: int
    frames: int
    sample_bytes: int
    effort: MethodWorkload = MethodWorkload()


@dataclass(frozen=True, kw_only=True)
class Workload(RecordingWorkload):
    """What the work on a scene grows with, beside the recording that it gives.

    ``fine_pixels``: Pixels of one sharp image: more than `pixels` where light is spread by a lens.
    ``save_radiance``: Whether linear images are kept too.
    ``sharp_images``: Sharp images that one image is the mean of.
    ``supersampling``: Samples of a pixel of a sharp image along either side.
    ``strips``: Parts of which an image consists, each with a time of its own: one, or with a rolling shutter its rows.
    ``lamps``: Lights.
    ``lit``: Whether light is computed.
    ``vertices``, ``faces``: Of all meshes together.
    ``leaf_faces``: Faces of leaves, which are meshed with more care.
    ``texels``: Points of all textures together.
    ``largest_texels``: Points of the largest texture.
    ``noise_texels_to_paint``, ``leaf_texels_to_paint``: Points that are not kept from an earlier run.
    ``views``: Cameras that a truth is made for.
    ``complete``: Whether the truth has all maps.
    ``narrow``: Whether the truth is stored in 32 bits.
    ``rays``: Whether images are made by ray casting; None: by what runs.
    """

    fine_pixels: float
    save_radiance: bool
    sharp_images: int
    supersampling: int
    strips: int
    lamps: int
    lit: bool
    vertices: float
    faces: float
    leaf_faces: float
    texels: float
    largest_texels: float
    noise_texels_to_paint: float
    leaf_texels_to_paint: float
    views: int
    complete: bool
    narrow: bool
    rays: bool | None

    @property
    def images(self) -> int:
        """Number of images."""
        return self.positions * self.frames


def list_object_workloads(scene: Scene, folder: Path = Path()) -> tuple[list[ObjectWorkload], list[Problem]]:
    """Return all objects with their sizes, and what can be seen to be wrong with their meshes and textures."""
    parts, problems = [], []
    for path, item in scene.parts:
        place = "mesh"
        try:
            size = item.mesh.size(folder)
            sketch = item.mesh.sketch(folder, SKETCHED_FACES)
            place = "texture"
            texels, painted = _texture(scene, item, sketch, folder)
        except SceneError as error:
            problems += [
                Problem(f"{path}.{place}.{problem.path}", problem.message, problem.value) for problem in error.problems
            ]
            continue
        parts.append(ObjectWorkload(path, item, size, sketch, texels, painted))
    return parts, add_missing_files(problems, scene, folder) if problems else []


def _texture(scene: Scene, item: SceneObject, sketch: TriangleMesh | None, folder: Path) -> tuple[int, bool]:
    """Return the points of a texture, and whether it is there already."""
    if sketch is None:
        return 0, False
    rows, columns = item.texture.raster_shape(sketch, folder)
    key = item.texture.cache_key(sketch, generator_for(scene.seed, "texture", item.name))
    return rows * columns, key is not None and has_entry(key)


def sharp_images(scene: Scene) -> int:
    """Return of how many sharp images one image is the mean, by aperture and exposure."""
    shutter, defocus = scene.shutter, scene.optics.defocus
    moments = 1
    if shutter.exposure_time_s > 0:
        moments = _AUTOMATIC_MOMENTS if shutter.samples == "auto" else shutter.samples
    return max(moments, 1 if defocus is None else defocus.samples)


def limit_problems(scene: Scene, limits: Limits) -> list[Problem]:
    """Return which bounds a scene passes that are counted from its numbers alone."""
    camera, stage = scene.camera, scene.stage
    images = stage.rows * stage.positions * scene.frames.count
    inner = -(-scene.render.supersampling // fine_parts(scene.optics.psf))
    samples = sharp_images(scene) * (fine_parts(scene.optics.psf) * inner) ** 2
    leaves = [(f"plants.{number}.leaves", float(len(plant.places()))) for number, plant in enumerate(scene.plants)]
    total = sum(count for _, count in leaves)
    if total > limits.leaves >= max((count for _, count in leaves), default=0):
        leaves = [("plants", total)]
    return [
        *too_much("frames", [("frames.count", scene.frames.count)], limits, "frames"),
        *too_much("images", [("stage", images)], limits, "images"),
        *too_much("pixels", [("camera", camera.width * camera.height)], limits, "pixels"),
        *too_much("samples", [("render.supersampling", samples)], limits, "samples in every pixel"),
        *too_much("objects", [("objects", len(scene.objects) + total)], limits, "objects"),
        *too_much("leaves", leaves, limits, "leaves"),
    ]


def object_problems(parts: Sequence[ObjectWorkload], limits: Limits) -> list[Problem]:
    """Return which bounds the meshes and textures of a scene pass."""
    vertices = [(f"{part.path}.mesh", float(part.size.vertices)) for part in parts]
    total = sum(count for _, count in vertices)
    if total > limits.vertices >= max((count for _, count in vertices), default=0.0):
        vertices = [("objects", total)]
    pictures = [part for part in parts if isinstance(part.item.texture, ImageTexture)]
    painted = [part for part in parts if part not in pictures]
    return [
        *too_much("vertices", vertices, limits, "vertices"),
        *too_much("texels", [(f"{part.path}.texture", part.texels) for part in painted], limits, "texels"),
        *too_much("image_pixels", [(f"{part.path}.texture.file", part.texels) for part in pictures], limits, "pixels"),
    ]


def compute_workload(
    scene: Scene,
    parts: Sequence[ObjectWorkload],
    *,
    views: int = 1,
    complete: bool = False,
    save_radiance: bool = False,
) -> Workload:
    """Count what the work on a scene grows with."""
    camera, psf = scene.camera, scene.optics.psf
    fine, margin = fine_parts(psf), margin_px(psf)
    to_paint = [part for part in parts if not part.painted]
    leaves = [part for part in parts if isinstance(part.item.mesh, LeafMesh)]
    return Workload(
        pixels=camera.width * camera.height,
        fine_pixels=(camera.width + 2 * margin) * (camera.height + 2 * margin) * fine**2,
        sample_bytes=build_sensor_chain(scene.sensor).dtype.itemsize,
        save_radiance=save_radiance,
        positions=scene.stage.positions * scene.stage.rows,
        frames=scene.frames.count,
        sharp_images=sharp_images(scene),
        supersampling=-(-scene.render.supersampling // fine),
        strips=camera.height if scene.shutter.readout_time_s > 0 else 1,
        lamps=len(scene.lighting.lights),
        lit=scene.lighting.lit,
        vertices=sum(part.size.vertices for part in parts),
        faces=sum(part.size.faces for part in parts),
        leaf_faces=sum(part.size.faces for part in leaves),
        texels=sum(part.texels for part in parts),
        largest_texels=max((part.texels for part in parts), default=0),
        noise_texels_to_paint=sum(part.texels for part in to_paint if part.item.texture.kind == "noise"),
        leaf_texels_to_paint=sum(part.texels for part in to_paint if part.item.texture.kind == "leaf"),
        views=views,
        complete=complete,
        narrow=scene.storage.truth == "float32",
        rays=True if scene.needs_rays or scene.render.backend == "raycast" else _ALL_RUN[scene.render.backend],
    )
