"""Noise of a band of wavelengths, cut into ink and paper, which every printer can print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Limited
from pydantic import field_validator

from scenetruth.design.pattern.base import Areas, Array, Box, Drawing, PatternModel
from scenetruth.design.pattern.field import SAMPLES, Field, band_power, band_problems, field_of
from scenetruth.errors import Problem
from scenetruth.model import Positive

__all__ = ["NoisePattern", "clipped_covariance"]

_PEAK = 4.0
_ORDERS, _ANGLES = 24, 4097


class NoisePattern(PatternModel):
    """Gaussian noise of a band of wavelengths; ink lies where it is below a threshold."""

    kind: Literal["noise"]
    """``noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength in mm."""
    spectrum_exponent: Annotated[float, Limited(ge=-10, le=10, allow_inf_nan=False)] = 0.0
    """Before it is cut, its power density is proportional to (spatial frequency) ** spectrum_exponent; 0 is white."""
    coverage: Annotated[float, Limited(ge=0.05, le=0.95)] = 0.5
    """Share of the sheet under ink."""

    @field_validator("wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> Drawing:
        """Draw the pattern; see `PatternModel`."""
        field = field_of(self.wavelength_mm, size_mm, self.spectrum_exponent, _PEAK, generator)
        return _Cut(field, self._threshold(), self.wavelength_mm[0])

    def _threshold(self) -> float:
        from scipy.special import ndtri

        return float(ndtri(self.coverage))

    def told(self, mm_per_px: float) -> str:
        """Return what the pattern is, in a line; see `PatternModel`."""
        short, long = self.wavelength_mm
        lengths = f"{short:.3f} to {long:.3f} mm ({short / mm_per_px:.2f} to {long / mm_per_px:.2f} px)"
        return f"noise of wavelengths {lengths}, cut into ink and paper, {100 * self.coverage:g} % covered"

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
        before = band_power(self.wavelength_mm, self.spectrum_exponent, count, pitch_mm)
        correlation = np.clip(np.fft.ifft2(before).real * count**2, -1.0, 1.0)
        # In the angle, the covariance is smooth: 4097 values of it tell it to 1e-7.
        angles = np.linspace(-np.pi / 2, np.pi / 2, _ANGLES)
        known = clipped_covariance(np.sin(angles), self._threshold())
        covariance = np.interp(np.arcsin(correlation), angles, known)
        return np.asarray(np.maximum(np.fft.fft2(covariance).real / count**2, 0.0))


def clipped_covariance(correlation: Array, threshold: float) -> Array:
    """Return the covariance of where Gaussian noise is below a threshold.

    The derivative by the correlation ρ is the density of two values at the threshold, so that the covariance is the
    integral of exp(-h² / (1 + r)) / (2 π √(1 - r²)) over r from 0 to ρ. At h = 0 it is arcsin(ρ) / 2 π.

    Parameters
    ----------
    correlation
        ρ of two values, any shape.
    threshold
        h in standard deviations.

    Returns
    -------
    numpy.ndarray
        Of the same shape; p (1 - p) at ρ = 1.
    """
    # With r = sin a the root goes away.
    angle = np.arcsin(correlation)
    if threshold == 0:
        return np.asarray(angle / (2 * np.pi))
    nodes, weights = np.polynomial.legendre.leggauss(_ORDERS)
    total = np.zeros_like(angle)
    for node, weight in zip(nodes, weights, strict=True):
        total += weight * np.exp(-(threshold**2) / (1 + np.sin(angle * (node + 1) / 2)))
    return np.asarray(total * angle / 2 / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class _Cut(Drawing):
    """Noise, with ink where it is below a threshold."""

    field: Field
    threshold: float
    shortest_mm: float

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        below = self.threshold - self.field.texels(box_mm, shape)
        # A border crosses a texel over the width that its slope tells.
        along_y, along_x = np.gradient(below)
        slope = np.maximum(np.hypot(along_x, along_y), np.float32(1e-6))
        return np.asarray(np.clip(0.5 + below / slope, 0.0, 1.0), dtype=np.float32)

    def marks(self, box_mm: Box) -> Areas:
        from matplotlib.figure import Figure

        left, top, width, height = box_mm
        pitch = self.shortest_mm / SAMPLES
        x = left + np.linspace(0, width, int(np.ceil(width / pitch)) + 1)
        y = top + np.linspace(0, height, int(np.ceil(height / pitch)) + 1)
        values = self.field.at(x, y)
        lowest = min(float(values.min()), self.threshold) - 1.0
        # Outlines of holes run the other way round than those around them.
        (path,) = Figure().add_subplot().contourf(x, y, values, levels=[lowest, self.threshold]).get_paths()
        if not len(path.vertices):
            return Areas([])
        starts = np.flatnonzero(path.codes == path.MOVETO)
        pieces = np.split(np.asarray(path.vertices, dtype=np.float64), starts[1:])
        return Areas([piece[:-1] for piece in pieces])
