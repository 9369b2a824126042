"""The waves of the paper's pattern."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from scenetruth.design.predict.textures.base import TextureSpectrum, Waves
from scenetruth.scene.texture.plaid import PlaidTexture

__all__ = ["PlaidSpectrum"]


class PlaidSpectrum(TextureSpectrum):
    """The product of two waves is the mean of two others: cos a cos b = (cos(a + b) + cos(a - b)) / 2."""

    kind: ClassVar[str] = "plaid"

    def waves(self, texture: PlaidTexture) -> Waves:
        """Return the waves; see `TextureSpectrum`."""
        across, down = 1.0 / texture.wavelength_mm[0], 1.0 / texture.wavelength_mm[1]
        return Waves(np.array([[across, down], [across, -down]]), np.full(2, texture.amplitude**2 / 8), texture.mean)
