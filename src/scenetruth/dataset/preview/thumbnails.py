"""Thumbnails of scenes that are not made yet: shapes, places and light as they will be, surfaces simplified."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.dataset.pages.contact_sheet import THUMBNAIL_PX
from scenetruth.errors import SceneError
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import Scene
from scenetruth.scene.item import SceneObject
from scenetruth.scene.leaf.texture import LeafTexture
from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.texture import TextureModel
from scenetruth.scene.texture.noise import NoiseTexture
from scenetruth.scene.texture.uniform import UniformTexture
from scenetruth.scene.world import build_world

__all__ = ["SIMPLIFIED", "simplified", "thumbnail_of"]

SIMPLIFIED = (
    "Not the images: reference camera at t = 0, linear, without lens and sensor. Shapes, places and light are those of "
    "the samples, on coarse meshes; noise is without its finest waves, leaves are without veins."
)
"""What thumbnails show."""
_WAVE_PX = 3.0
"""Finest wave of a thumbnail, in its pixels."""
_FACET_PX = 1.5
"""Finest facets of a thumbnail, in its pixels."""
_FACETS_OF_A_SIDE = 12
_PLAIN_TEXELS = 1_000_000
"""Rasters that are painted as they are."""


def thumbnail_of(scene: Scene) -> NDArray[np.float32]:
    """Return a small linear image of the reference camera at the reference frame.

    Parameters
    ----------
    scene
        The scene.

    Raises
    ------
    SceneError
        If the scene cannot be made.
    """
    small = simplified(scene)
    with warnings.catch_warnings():
        # They are told of when the sample is made.
        warnings.simplefilter("ignore")
        try:
            world = build_world(small)
        except SceneError:
            # What is coarse may be too coarse; what is wrong with the scene itself shows here again.
            small = _small(scene, scene.parts)
            world = build_world(small)
        with RaycastRenderer(world, small.camera, small.background, 1, small.lighting) as renderer:
            return renderer.render(0.0, Viewpoint.on_axis(0.0))


def simplified(scene: Scene) -> Scene:
    """Return a scene that looks alike from the reference camera in few pixels, and is quickly made.

    Parameters
    ----------
    scene
        The scene.
    """
    focal_px = scene.camera.shrunk_to(THUMBNAIL_PX).focal_px
    return _small(scene, [(path, _coarse(item, focal_px)) for path, item in scene.parts])


def _small(scene: Scene, parts: tuple[tuple[str, SceneObject], ...] | list[tuple[str, SceneObject]]) -> Scene:
    items = tuple(item for _, item in parts)
    small = scene.shrunk_to(THUMBNAIL_PX).model_copy(update={"objects": items, "plants": ()})
    # Copies share what the scene had found out about itself.
    small.__dict__.pop("parts", None)
    return small


def _coarse(item: SceneObject, focal_px: float) -> SceneObject:
    pixel_mm = max(item.pose.position_mm[2], 1.0) / focal_px
    mesh = _coarse_mesh(item.mesh, pixel_mm)
    return item.model_copy(update={"mesh": mesh, "texture": _coarse_texture(item, pixel_mm)})


def _coarse_mesh(mesh: MeshModel, pixel_mm: float) -> MeshModel:
    """Return a mesh with facets of about a pixel, but not so few that its form is lost."""
    given = getattr(mesh, "resolution_mm", None)
    if given is None:
        return mesh
    sizes = [getattr(mesh, name, None) for name in ("width_mm", "length_mm", "radius_mm")]
    own = [size / _FACETS_OF_A_SIDE for size in sizes if isinstance(size, float | int)]
    return mesh.model_copy(update={"resolution_mm": max(given, min([_FACET_PX * pixel_mm, *own]))})


def _coarse_texture(item: SceneObject, pixel_mm: float) -> TextureModel:
    texture = item.texture
    if isinstance(texture, LeafTexture):
        return UniformTexture(kind="uniform", radiance=texture.settings["mean"])
    if isinstance(texture, NoiseTexture):
        return _coarse_noise(texture, _WAVE_PX * pixel_mm)
    sketch = item.mesh.sketch(Path(), 100)
    try:
        texels = math.inf if sketch is None else math.prod(texture.raster_shape(sketch, Path()))
    except (SceneError, OSError):
        return texture
    return texture if texels <= _PLAIN_TEXELS else UniformTexture(kind="uniform")


def _coarse_noise(texture: NoiseTexture, finest_mm: float) -> TextureModel:
    """Return noise without the waves that are finer than some length; what it keeps has the power that it had."""
    low, high = texture.wavelength_mm
    if finest_mm <= low:
        return texture
    if finest_mm >= _ALMOST * high:
        return UniformTexture(kind="uniform", radiance=texture.mean)
    share = _power(finest_mm, high, texture.spectrum_exponent) / _power(low, high, texture.spectrum_exponent)
    contrast = texture.rms_contrast * math.sqrt(share)
    return texture.model_copy(update={"wavelength_mm": (finest_mm, high), "rms_contrast": contrast})


_ALMOST = 0.9


def _power(low: float, high: float, exponent: float) -> float:
    """Return the power of noise between two wavelengths, in any unit."""
    order = exponent + 2
    if abs(order) < _ALMOST_ZERO:
        return math.log(high / low)
    return float(((high / low) ** order - 1) / order * high**-order)


_ALMOST_ZERO = 1e-9
