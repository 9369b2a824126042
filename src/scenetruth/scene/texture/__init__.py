"""Textures: radiance of surfaces."""

from scenetruth.scene.texture.procedural_textures import CheckerboardTexture, NoiseTexture, PlaidTexture, UniformTexture
from scenetruth.scene.texture.texture_model import Painted, SurfaceTexture, TextureModel

__all__ = [
    "CheckerboardTexture",
    "NoiseTexture",
    "Painted",
    "PlaidTexture",
    "SurfaceTexture",
    "TextureModel",
    "UniformTexture",
]
