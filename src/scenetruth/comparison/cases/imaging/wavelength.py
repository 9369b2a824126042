"""Errors over the wavelength of the texture: how fine or coarse it may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class Wavelength(Case):
    """A sheet with waves of nearly one length, in all directions."""

    kind = "wavelength"
    title = "Wavelength"
    question = "Which texture suits it?"
    varied = "wavelength of the texture, px"
    core = (3.0, 24.0)
    full = (2.2, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 40.0)
    logarithmic = True
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet with waves of this length, to a fifth."""
        return sheet({"objects.0.texture.wavelength_mm": [value / 1.1, value * 1.1]})
