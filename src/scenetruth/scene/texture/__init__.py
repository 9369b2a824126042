"""Textures: every kind is a module that holds its model and how it is painted."""

from scenetruth.scene.texture.base import Painted, SurfaceTexture, TextureModel

__all__ = ["Painted", "SurfaceTexture", "TextureModel"]
