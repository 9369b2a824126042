"""The waves of noise."""

from __future__ import annotations

from typing import ClassVar

from scenetruth.design.predict.textures.base import TextureSpectrum, Waves, ring_waves
from scenetruth.scene.texture.noise import NoiseTexture

__all__ = ["NoiseSpectrum"]


class NoiseSpectrum(TextureSpectrum):
    """Isotropic noise of a stated power density in a band."""

    kind: ClassVar[str] = "noise"

    def waves(self, texture: NoiseTexture) -> Waves:
        """Return the waves; see `TextureSpectrum`."""
        variance = (texture.mean * texture.rms_contrast) ** 2
        return ring_waves(texture.wavelength_mm, texture.spectrum_exponent, variance, texture.mean)
