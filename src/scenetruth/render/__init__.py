"""Images of a scene: one protocol, several backends that return linear float images."""

from scenetruth.render.backend_selection import BackendChoice, choose_renderer
from scenetruth.render.renderer import Renderer

__all__ = ["BackendChoice", "Renderer", "choose_renderer"]
