"""Images of the world: one protocol, several backends that return linear float images."""

from scenetruth.render.protocol import Renderer
from scenetruth.render.select import Choice, choose_renderer

__all__ = ["Choice", "Renderer", "choose_renderer"]
