"""Workload of a scene, computed from its models without building meshes, painting textures or decoding files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from scenetruth.cache import has_entry
from scenetruth.camera import build_sensor_chain
from scenetruth.errors import Problem, SceneError
from scenetruth.random_streams import generator_for
from scenetruth.render.lens_and_shutter import fine_parts, margin_px
from scenetruth.resources.limits import Limits, too_much
from scenetruth.scene.built_scene import add_missing_files, find_materials
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
"""Triangles of the sketch of an object."""

_ALL_RUN: dict[str, bool | None] = {"pyrender": False, "auto": None}

_AUTOMATIC_MOMENTS = 16  # assumed exposure samples where the number depends on motion: that of a motion of four pixels


@dataclass(frozen=True, eq=False)
class ObjectWorkload:
    """Workload of an object or leaf before it is built.

    ``sketch``: Coarse mesh; None if its file is too large to read quickly. ``painted``: Whether the texture is cached.
    """

    path: str
    item: SceneObject
    size: MeshSize
    sketch: TriangleMesh | None
    texels: int
    painted: bool


@dataclass(frozen=True)
class MethodWorkload:
    """Resources required by an estimation method.

    ``pixels_at_once``: Pixels of all frames that are estimated together, unless one frame has more.
    ``seconds_per_sample``: Time per pixel and image of an estimated frame, on two processors.
    ``whole_pixels``, ``tile_pixels``: Images with more pixels than the first are processed in tiles of the second.
    ``bytes_per_tiled_pixel``: Memory per pixel of an image that is processed in tiles, in addition to that of a tile.
    """

    in_memory: bool = False
    bytes_per_pixel: float = 195.0
    pixels_at_once: float = 2.3e6
    seconds_per_sample: float = 1.6e-6
    whole_pixels: float = math.inf
    tile_pixels: float = math.inf
    bytes_per_tiled_pixel: float = 0.0


@dataclass(frozen=True)
class RecordingWorkload:
    """Quantities that determine the cost of processing a recording; ``pixels`` is per image.

    ``channels``: Channels of the images, 1 for grey; each has ``sample_bytes`` per pixel.
    """

    pixels: float
    positions: int
    frames: int
    sample_bytes: int
    effort: MethodWorkload = MethodWorkload()
    channels: int = 1


@dataclass(frozen=True, kw_only=True)
class Workload(RecordingWorkload):
    """Quantities that determine the cost of rendering a scene.

    ``fine_pixels``: Pixels of one sharp image: more than `pixels` with a point-spread function.
    ``sharp_images``: Number of sharp images averaged to one image.
    ``strips``: Parts of an image with separate times: one, or the rows with a rolling shutter.
    ``leaf_faces``: Faces of leaves, whose meshing is more expensive.
    ``noise_texels_to_paint``, ``leaf_texels_to_paint``: Texels that are not cached.
    ``views``: Cameras with ground truth.
    ``complete``, ``narrow``: Whether the ground truth has all maps, and is stored in 32 bits.
    ``bands``: Bands that are rendered, 1 for grey.
    ``rays``: Whether images are rendered by ray casting; None: by the available backend.
    ``adaptive``: Whether pixels at edges have more samples.
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
    adaptive: bool = False
    bands: int = 1

    @property
    def images(self) -> int:
        """Number of images."""
        return self.positions * self.frames


def list_object_workloads(scene: Scene, folder: Path = Path()) -> tuple[list[ObjectWorkload], list[Problem]]:
    """Return all objects with their workloads, and the problems of their meshes, textures and materials."""
    parts: list[ObjectWorkload] = []
    problems: list[Problem] = []
    for path, item in scene.parts:
        found: list[Problem] = []
        with _problems_of(f"{path}.mesh", found):
            size = item.mesh.size(folder)
            sketch = item.mesh.sketch(folder, SKETCHED_FACES)
        if not found:
            with _problems_of(f"{path}.texture", found):
                texels, painted = _texture(scene, item, sketch, folder)
            with _problems_of(f"{path}.material", found):
                if sketch is not None:
                    find_materials(item, sketch)
        problems += found
        if found:
            continue
        parts.append(ObjectWorkload(path, item, size, sketch, texels, painted))
    return parts, add_missing_files(problems, scene, folder) if problems else []


@contextmanager
def _problems_of(where: str, found: list[Problem]) -> Iterator[None]:
    """Append the problems of a part of an object to a list."""
    try:
        yield
    except SceneError as error:
        found += [Problem(f"{where}.{each.path}", each.message, each.value) for each in error.problems]


def _texture(scene: Scene, item: SceneObject, sketch: TriangleMesh | None, folder: Path) -> tuple[int, bool]:
    """Return the number of texels of a texture, and whether it is cached."""
    if sketch is None:
        return 0, False
    rows, columns = item.texture.raster_shape(sketch, folder)
    key = item.texture.cache_key(sketch, generator_for(scene.seed, "texture", item.name))
    return rows * columns, key is not None and has_entry(key)


def sharp_images(scene: Scene) -> int:
    """Return the number of sharp images averaged to one image, by aperture and exposure."""
    shutter, defocus = scene.shutter, scene.optics.defocus
    moments = 1
    if shutter.exposure_time_s > 0:
        moments = _AUTOMATIC_MOMENTS if shutter.samples == "auto" else shutter.samples
    return max(moments, 1 if defocus is None else defocus.samples)


def limit_problems(scene: Scene, limits: Limits) -> list[Problem]:
    """Return the exceeded limits that follow from the numbers of a scene alone."""
    camera, stage = scene.camera, scene.stage
    images = stage.rows * stage.positions * scene.frames.count
    inner = -(-scene.render.samples // fine_parts(scene.optics.psf))
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
    """Return the limits exceeded by the meshes and textures of a scene."""
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
    """Compute the workload of a scene."""
    camera, psf, chain = scene.camera, scene.optics.psf, build_sensor_chain(scene.sensor)
    fine, margin = fine_parts(psf), margin_px(psf)
    to_paint = [part for part in parts if not part.painted]
    leaves = [part for part in parts if isinstance(part.item.mesh, LeafMesh)]
    return Workload(
        pixels=camera.width * camera.height,
        fine_pixels=(camera.width + 2 * margin) * (camera.height + 2 * margin) * fine**2,
        sample_bytes=chain.dtype.itemsize,
        save_radiance=save_radiance,
        positions=scene.stage.positions * scene.stage.rows,
        frames=scene.frames.count,
        sharp_images=sharp_images(scene),
        supersampling=-(-scene.render.samples // fine),
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
        adaptive=scene.render.edges == "adaptive",
        bands=max(len(camera.bands), 1),
        channels=max(len(chain.channels(camera.bands)), 1),
        rays=True if scene.needs_rays or scene.render.backend == "raycast" else _ALL_RUN[scene.render.backend],
    )
