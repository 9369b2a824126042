"""Choosing the backend that a scene asks for and this machine can run."""

from __future__ import annotations

from dataclasses import dataclass

from scenetruth.errors import BackendUnavailableError
from scenetruth.render.protocol import Renderer
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import World

__all__ = ["Choice", "choose_renderer"]


@dataclass(frozen=True)
class Choice:
    """A renderer, and why it is not the first choice (empty if it is)."""

    renderer: Renderer
    fallback_reason: str = ""


def choose_renderer(scene: Scene, world: World) -> Choice:
    """Open the render backend of a scene.

    ``auto`` takes ``pyrender`` on OSMesa, then on EGL, then ``raycast``.

    Parameters
    ----------
    scene
        The scene; its ``render`` section says which backend and how many samples.
    world
        Its objects.

    Raises
    ------
    BackendUnavailableError
        If ``pyrender`` is asked for by name and does not run here.
    """
    settings = scene.render
    if settings.backend != "raycast":
        from scenetruth.render.pyrender_backend import PyrenderRenderer

        try:
            renderer: Renderer = PyrenderRenderer(
                world, scene.camera, scene.background, settings.supersampling, settings.platform
            )
        except BackendUnavailableError as error:
            if settings.backend == "pyrender":
                raise
            reason = f"{error}; rendered by ray casting instead"
        else:
            preferred = settings.platform in ("egl", "auto") and renderer.name != "pyrender (osmesa)"
            reason = (
                "OSMesa does not run here; rendered on EGL instead" if preferred and settings.platform == "auto" else ""
            )
            return Choice(renderer, reason)
    else:
        reason = ""
    from scenetruth.render.raycast_backend import RaycastRenderer

    return Choice(RaycastRenderer(world, scene.camera, scene.background, settings.supersampling), reason)
