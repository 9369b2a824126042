"""How fine the texture is in the image."""

from __future__ import annotations

from typing import ClassVar, Literal

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.constraints.facts import Facts

__all__ = ["TextureWavelength"]


class TextureWavelength(Limit):
    """Rms mean wavelength of the texture in the images; dots have about half of it."""

    unit: ClassVar[str] = "px"

    kind: Literal["texture_wavelength"] = "texture_wavelength"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "wavelength of the texture in the image"

    def value(self, facts: Facts) -> float:
        """Return the wavelength."""
        return facts.causes.wavelength_px
