"""The waves of one radiance everywhere: none."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from scenetruth.design.predict.textures.base import TextureSpectrum, Waves
from scenetruth.scene.texture.uniform import UniformTexture

__all__ = ["UniformSpectrum"]


class UniformSpectrum(TextureSpectrum):
    """No waves: nothing can be seen to move."""

    kind: ClassVar[str] = "uniform"

    def waves(self, texture: UniformTexture) -> Waves:
        """Return the waves; see `TextureSpectrum`."""
        return Waves(np.zeros((0, 2)), np.zeros(0), texture.radiance)
