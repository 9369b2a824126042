"""Noise of a band of wavelengths in shades of grey, for photographic prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Limited
from pydantic import field_validator

from scenetruth.design.pattern.base import Array, Box, Drawing, Grey, PatternModel
from scenetruth.design.pattern.field import SAMPLES, Field, band_power, band_problems, field_of
from scenetruth.errors import Problem
from scenetruth.model import Positive

__all__ = ["GreyNoisePattern"]


class GreyNoisePattern(PatternModel):
    """Gaussian noise of a band of wavelengths, limited to what lies between ink and paper."""

    kind: Literal["grey_noise"]
    """``grey_noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength in mm."""
    spectrum_exponent: Annotated[float, Limited(ge=-10, le=10, allow_inf_nan=False)] = 0.0
    """Power density is proportional to (spatial frequency) ** spectrum_exponent; 0 is white."""
    contrast: Annotated[float, Limited(gt=0, le=0.25)] = 0.2
    """Standard deviation, as a share of the range from ink to paper; extremes are kept within it inside the band."""

    @field_validator("wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> Drawing:
        """Draw the pattern; see `PatternModel`."""
        peak = min(4.0, 0.5 / self.contrast)
        field = field_of(self.wavelength_mm, size_mm, self.spectrum_exponent, peak, generator)
        return _Shades(field, self.contrast, self.radiances, self.wavelength_mm[0])

    def told(self, mm_per_px: float) -> str:
        """Return what the pattern is, in a line; see `PatternModel`."""
        short, long = self.wavelength_mm
        lengths = f"{short:.3f} to {long:.3f} mm ({short / mm_per_px:.2f} to {long / mm_per_px:.2f} px)"
        return f"noise of wavelengths {lengths} in shades of grey, contrast {self.contrast:g} of the range"

    @property
    def finest_mm(self) -> float:
        """Shortest wavelength in mm."""
        return self.wavelength_mm[0]

    @property
    def coarsest_mm(self) -> float:
        """Longest wavelength in mm."""
        return self.wavelength_mm[1]

    def size_problems(self, size_mm: tuple[float, float]) -> list[Problem]:
        """Return what keeps a pattern of that size from being drawn; see `PatternModel`."""
        return band_problems(self.wavelength_mm, size_mm)

    def power(self, count: int, pitch_mm: float) -> Array:
        """Return the spectrum of the ink; see `PatternModel`."""
        return self.contrast**2 * band_power(self.wavelength_mm, self.spectrum_exponent, count, pitch_mm)


@dataclass(frozen=True, eq=False)
class _Shades(Drawing):
    """Noise, as the share of ink."""

    field: Field
    contrast: float
    radiances: tuple[float, float]
    shortest_mm: float

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        values = 0.5 - np.float32(self.contrast) * self.field.texels(box_mm, shape)
        return np.asarray(np.clip(values, 0.0, 1.0), dtype=np.float32)

    def marks(self, box_mm: Box) -> Grey:
        width, height = box_mm[2:]
        pitch = self.shortest_mm / SAMPLES
        shape = (max(round(height / pitch), 1), max(round(width / pitch), 1))
        ink, paper = self.radiances
        # Printers take grey values as those of a screen: full ink is black, bare paper white.
        share = 1.0 - self.ink(box_mm, shape)
        reflectance = share + (1.0 - share) * ink / paper
        srgb = np.where(reflectance <= 0.0031308, 12.92 * reflectance, 1.055 * reflectance ** (1 / 2.4) - 0.055)
        return Grey(np.round(255 * srgb).astype(np.uint8), box_mm)
