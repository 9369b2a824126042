"""The waves of checkerboards."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from scenetruth.design.predict.textures.base import TextureSpectrum, Waves
from scenetruth.scene.texture.checkerboard import CheckerboardTexture

__all__ = ["CheckerboardSpectrum"]

# Of the overtones of a square wave, those that pixels can still show of the largest squares.
_HIGHEST = 31


class CheckerboardSpectrum(TextureSpectrum):
    """The product of two square waves, each 4/π Σ sin(k x) / k over odd k."""

    kind: ClassVar[str] = "checkerboard"

    def waves(self, texture: CheckerboardTexture) -> Waves:
        """Return the waves; see `TextureSpectrum`."""
        one, other = texture.radiances
        odd = np.arange(1, _HIGHEST + 1, 2)
        k, m = (each.ravel() for each in np.meshgrid(odd, odd))
        frequency = np.stack([k, m], axis=-1) / (2 * texture.square_mm)
        # sin a sin b is half the difference of two waves.
        variance = 0.5 * (8 * 0.5 * (one - other) / (np.pi**2 * k * m)) ** 2
        return Waves(
            np.concatenate([frequency, frequency * [1, -1]]), np.concatenate([variance] * 2), 0.5 * (one + other)
        )
