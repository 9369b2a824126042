"""Textures: radiance of surfaces."""

from scenetruth.scene.texture.texture_model import Painted, SurfaceTexture, TextureModel

__all__ = ["Painted", "SurfaceTexture", "TextureModel"]
