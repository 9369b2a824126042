"""Rendering of scenes: linear float images from several backends with a common protocol."""

from scenetruth.render.backend_selection import BackendChoice, choose_renderer
from scenetruth.render.renderer import Renderer

__all__ = ["BackendChoice", "Renderer", "choose_renderer"]
