"""Selection of the rendering backend: as specified by the scene, or the best available."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from scenetruth.camera import Camera
from scenetruth.errors import BackendUnavailableError
from scenetruth.render import opengl
from scenetruth.render.lens_and_shutter import open_behind_lens
from scenetruth.render.renderer import Renderer
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.scene_models import Scene

__all__ = ["BackendChoice", "choose_renderer"]


@dataclass(frozen=True)
class BackendChoice:
    """Renderer with the reason why it replaces the first choice (empty if it does not).

    ``another``: Function that opens a further renderer of the same images, for another thread; None if all images must
      be rendered in one thread.
    """

    renderer: Renderer
    fallback_reason: str = ""
    another: Callable[[], Renderer] | None = None


Wrap = Callable[[Renderer, Camera], Renderer]
"""Function that changes the sharp images of a renderer for a camera."""


def choose_renderer(scene: Scene, world: BuiltScene, wrap: Wrap | None = None) -> BackendChoice:
    """Open the rendering backend of a scene, including lens and shutter.

    ``wrap``: Applied to the renderer of sharp images, before lens and shutter.

    Order of ``auto``: ``pyrender`` on OSMesa, on EGL, ``raycast``, which lens distortion and rolling shutter require.
    Without the packages of the extra `opengl`, ray casting is no fallback, and has no reason.
    """
    settings = scene.render
    reason = ""
    if settings.backend != "raycast":
        curved = scene.needs_rays
        if curved and settings.backend == "auto":
            return _raycast(scene, world, wrap, f"OpenGL cannot render {curved}; rendered by ray casting instead")
        if settings.backend == "auto" and not opengl.is_installed():
            return _raycast(scene, world, wrap, "")
        try:
            return _pyrender(scene, world, wrap)
        except BackendUnavailableError as error:
            if settings.backend == "pyrender":
                raise
            reason = f"{error}; rendered by ray casting instead"
    return _raycast(scene, world, wrap, reason)


def _pyrender(scene: Scene, world: BuiltScene, wrap: Wrap | None) -> BackendChoice:
    from scenetruth.render.pyrender_backend import PyrenderRenderer

    settings = scene.render

    def open_renderer(camera: Camera, supersampling: int) -> Renderer:
        background, platform = scene.background, settings.platform
        return PyrenderRenderer(world, camera, background, supersampling, platform, scene.lighting)

    renderer = _behind_lens(scene, world, open_renderer, wrap)
    on_egl = settings.platform == "auto" and renderer.name != "pyrender (osmesa)"
    return BackendChoice(renderer, "OSMesa is not available; rendered on EGL instead" if on_egl else "")


def _raycast(scene: Scene, world: BuiltScene, wrap: Wrap | None, reason: str) -> BackendChoice:
    from scenetruth.raycast import scene_topology
    from scenetruth.render.adaptive_raycast import AdaptiveRenderer
    from scenetruth.render.raycast_backend import BandRenderer, RaycastRenderer, SharedSurfaces

    topology = scene_topology(world)
    surfaces = SharedSurfaces(world, topology)

    settings = scene.render
    exact = settings.supersampling == "auto" and settings.edges == "sampled"

    def open_band(camera: Camera, supersampling: int, grey: Scene, painted: BuiltScene) -> RaycastRenderer:
        background, lighting = grey.background, grey.lighting
        if exact:
            error = settings.image_error
            return AdaptiveRenderer(
                painted, camera, background, lighting, topology, image_error=error, surfaces=surfaces
            )
        adaptive = settings.edges == "adaptive"
        return RaycastRenderer(
            painted, camera, background, supersampling, lighting, topology, adaptive=adaptive, surfaces=surfaces
        )

    bands = list(zip(scene.band_scenes(), world.bands or (world,), strict=True))

    def open_renderer(camera: Camera, supersampling: int) -> Renderer:
        opened = [open_band(camera, supersampling, *band) for band in bands]
        return BandRenderer(opened) if scene.camera.bands else opened[0]

    def another() -> Renderer:
        return _behind_lens(scene, world, open_renderer, wrap)

    # A wrapper may depend on the order of the images.
    return BackendChoice(another(), reason, another if wrap is None else None)


def _behind_lens(
    scene: Scene, world: BuiltScene, open_renderer: Callable[[Camera, int], Renderer], wrap: Wrap | None
) -> Renderer:
    def open_wrapped(camera: Camera, samples: int) -> Renderer:
        renderer = open_renderer(camera, samples)
        return renderer if wrap is None else wrap(renderer, camera)

    interval, samples = scene.frames.frame_interval_s, scene.render.samples
    return open_behind_lens(scene.camera, scene.optics, scene.shutter, world, interval, samples, open_wrapped)
