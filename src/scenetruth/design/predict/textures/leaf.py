"""The waves of leaves without their veins."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from scenetruth.design.predict.textures.base import TextureSpectrum, Waves, ring_waves
from scenetruth.scene.leaf.look import LeafLook

__all__ = ["LeafSpectrum"]

# Full width at half the height of a Gaussian, in its standard deviations.
_WIDTH = 2.354820045
# Beyond this many widths of its spectrum a dot has no waves.
_DOT_BAND = 3.0
_RADII, _ANGLES = 10, 8


class LeafSpectrum(TextureSpectrum):
    """Mottling, whose power density falls with the frequency to the power 2.5, and hairs at random places.

    Veins have no formula: what is told is the least that is seen, between them.
    """

    kind: ClassVar[str] = "leaf"
    exact: ClassVar[bool] = False

    def waves(self, texture: LeafLook) -> Waves:
        """Return the waves; see `TextureSpectrum`."""
        values = texture.settings
        mean, contrast = values["mean"], values["mottling_contrast"]
        mottling = ring_waves(texture.mottling_wavelength_mm, -2.5, (mean * contrast) ** 2, mean)
        sigma = texture.speckle_size_mm / _WIDTH
        # Campbell's theorem: dots exp(-r² / 2σ²) of random places have the variance density x ∫ dot².
        variance = texture.speckle_density_per_mm2 * np.pi * sigma**2 * (mean * values["speckle_contrast"]) ** 2
        if variance == 0:
            return mottling
        frequency = _DOT_BAND / (2 * np.pi * sigma) * (np.arange(_RADII) + 0.5) / _RADII
        shares = frequency * np.exp(-((2 * np.pi * sigma * frequency) ** 2))
        turn = np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
        grid = frequency[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        each = np.repeat(variance * shares / (shares.sum() * _ANGLES), _ANGLES)
        return mottling.joined(Waves(grid.reshape(-1, 2), each, mean))
