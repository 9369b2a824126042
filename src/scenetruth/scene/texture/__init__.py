"""Textures: radiance of surfaces."""

from scenetruth.scene.texture.band_limited_noise import (
    compute_noise_shape,
    contains_wavelength,
    make_band_limited_noise,
)
from scenetruth.scene.texture.image_textures import MAX_PIXELS, EmbeddedTexture, Picture, compute_luminance
from scenetruth.scene.texture.procedural_textures import CheckerboardTexture, NoiseTexture, PlaidTexture, UniformTexture
from scenetruth.scene.texture.texture_model import (
    Painted,
    SurfaceTexture,
    TextureModel,
    TintedTexture,
    tint_texture,
)

__all__ = [
    "MAX_PIXELS", "CheckerboardTexture", "EmbeddedTexture", "NoiseTexture", "Painted", "Picture", "PlaidTexture",
    "SurfaceTexture", "TextureModel", "TintedTexture", "UniformTexture", "compute_luminance", "compute_noise_shape",
    "contains_wavelength", "make_band_limited_noise", "tint_texture",
]  # fmt: skip
