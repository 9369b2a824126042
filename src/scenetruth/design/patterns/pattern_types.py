"""Pattern types: grey noise, binary noise, speckle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator
from pydantic import Field as Limited

from scenetruth.design.patterns.pattern_model import (
    Array,
    Box,
    GreyPicture,
    InkAreas,
    InkDots,
    PatternDrawing,
    PatternModel,
)
from scenetruth.errors import ArgumentError, Problem
from scenetruth.scene.texture.band_limited_noise import contains_wavelength, make_band_limited_noise
from scenetruth.validated_model import Positive

__all__ = [
    "GreyNoisePattern",
    "NoiseField",
    "NoisePattern",
    "SpecklePattern",
    "compute_boolean_covariance",
    "compute_clipped_covariance",
]


MOST_TEXELS = 40_000_000
"""Largest number of noise samples on a printed sheet; larger files cannot be printed."""

SAMPLES = 8
"""Samples per shortest wavelength on a printed sheet."""

_PART = 2_000_000  # points evaluated per batch


@dataclass(frozen=True, eq=False)
class NoiseField:
    """Periodic noise with zero mean and unit variance: coefficients of a cubic spline, and size of the period."""

    coefficients: NDArray[np.float32]
    period_mm: tuple[float, float]

    def at(self, x_mm: Array, y_mm: Array) -> NDArray[np.float32]:
        """Return the noise on a grid of columns and rows, shape (y, x)."""
        from scenetruth.scene.texture.texture_kernels import spline_lookup

        out = np.empty((y_mm.size, x_mm.size), dtype=np.float32)
        rows = max(_PART // x_mm.size, 1)
        for first in range(0, y_mm.size, rows):
            part = y_mm[first : first + rows]
            uv = np.empty((part.size, x_mm.size, 2))
            uv[..., 0], uv[..., 1] = x_mm / self.period_mm[0], part[:, None] / self.period_mm[1]
            out[first : first + rows] = spline_lookup(self.coefficients, uv.reshape(-1, 2)).reshape(part.size, -1)
        return out

    def texels(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the noise at the centres of the texels of a box."""
        left, top, width, height = box_mm
        x = left + (np.arange(shape[1]) + 0.5) * width / shape[1]
        y = top + (np.arange(shape[0]) + 0.5) * height / shape[0]
        return self.at(x, y)


def generate_noise_field(
    wavelength_mm: tuple[float, float],
    size_mm: tuple[float, float],
    exponent: float,
    peak: float,
    generator: np.random.Generator,
) -> NoiseField:
    """Generate the noise of a sheet."""
    noise = make_band_limited_noise(wavelength_mm, size_mm, generator, exponent=exponent, peak=peak)
    return NoiseField(noise.coefficients, noise.period)


def list_band_problems(wavelength_mm: tuple[float, float], size_mm: tuple[float, float]) -> list[Problem]:
    """Return the problems of band-limited noise on a sheet."""
    problems = []
    if not contains_wavelength(wavelength_mm, size_mm):
        message = "contains no wavelength that fits on the sheet; widen the band"
        problems.append(Problem("wavelength_mm", message, wavelength_mm))
    texels = SAMPLES**2 * size_mm[0] * size_mm[1] / wavelength_mm[0] ** 2
    if texels > MOST_TEXELS:
        message = f"is too short for a sheet of this size: {texels:,.0f} points, more than {MOST_TEXELS:,}"
        problems.append(Problem("wavelength_mm", f"{message}; print a smaller sheet", wavelength_mm))
    return problems


def compute_band_power(wavelength_mm: tuple[float, float], exponent: float, count: int, pitch_mm: float) -> Array:
    """Return the spectrum of noise of unit variance at the frequencies of `numpy.fft.fftfreq`, shape (count, count)."""
    at = np.fft.fftfreq(count, pitch_mm)
    frequency = np.hypot(at[:, None], at)
    band = (frequency >= 1 / wavelength_mm[1]) & (frequency <= 1 / wavelength_mm[0])
    power = np.zeros_like(frequency)
    power[band] = frequency[band] ** exponent
    return np.asarray(power / power.sum())


class GreyNoisePattern(PatternModel):
    """Band-limited Gaussian noise, clipped to the range between ink and paper."""

    kind: Literal["grey_noise"]
    """Pattern type: ``grey_noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength in mm."""
    spectrum_exponent: Annotated[float, Limited(ge=-10, le=10, allow_inf_nan=False)] = 0.0
    """Exponent e of the power density, proportional to (spatial frequency) ** e; 0 is white noise."""
    contrast: Annotated[float, Limited(gt=0, le=0.25)] = 0.2
    """Standard deviation relative to the range from ink to paper; extremes are limited to this range."""

    @field_validator("wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> PatternDrawing:
        """Draw the pattern; see `PatternModel`."""
        peak = min(4.0, 0.5 / self.contrast)
        field = generate_noise_field(self.wavelength_mm, size_mm, self.spectrum_exponent, peak, generator)
        return _GreyInk(field, self.contrast, self.radiances, self.wavelength_mm[0])

    def description(self, mm_per_px: float) -> str:
        """Return a one-line description; see `PatternModel`."""
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
        """Return the problems that prevent drawing a pattern of this size; see `PatternModel`."""
        return list_band_problems(self.wavelength_mm, size_mm)

    def power(self, count: int, pitch_mm: float) -> Array:
        """Return the spectrum of the ink coverage; see `PatternModel`."""
        return self.contrast**2 * compute_band_power(self.wavelength_mm, self.spectrum_exponent, count, pitch_mm)


@dataclass(frozen=True, eq=False)
class _GreyInk(PatternDrawing):
    """Ink coverage from noise."""

    field: NoiseField
    contrast: float
    radiances: tuple[float, float]
    shortest_mm: float

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        values = 0.5 - np.float32(self.contrast) * self.field.texels(box_mm, shape)
        return np.asarray(np.clip(values, 0.0, 1.0), dtype=np.float32)

    def marks(self, box_mm: Box) -> GreyPicture:
        width, height = box_mm[2:]
        pitch = self.shortest_mm / SAMPLES
        shape = (max(round(height / pitch), 1), max(round(width / pitch), 1))
        ink, paper = self.radiances
        # Printers interpret grey values as sRGB: full ink is black, bare paper white.
        share = 1.0 - self.ink(box_mm, shape)
        reflectance = share + (1.0 - share) * ink / paper
        srgb = np.where(reflectance <= 0.0031308, 12.92 * reflectance, 1.055 * reflectance ** (1 / 2.4) - 0.055)
        return GreyPicture(np.round(255 * srgb).astype(np.uint8), box_mm)


_PEAK = 4.0
_ORDERS, _ANGLES = 24, 4097


class NoisePattern(PatternModel):
    """Band-limited Gaussian noise, with ink where it is below a threshold."""

    kind: Literal["noise"]
    """Pattern type: ``noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength in mm."""
    spectrum_exponent: Annotated[float, Limited(ge=-10, le=10, allow_inf_nan=False)] = 0.0
    """Exponent e of the power density before thresholding, proportional to (spatial frequency) ** e; 0 is white."""
    coverage: Annotated[float, Limited(ge=0.05, le=0.95)] = 0.5
    """Fraction of the sheet covered by ink."""

    @field_validator("wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> PatternDrawing:
        """Draw the pattern; see `PatternModel`."""
        field = generate_noise_field(self.wavelength_mm, size_mm, self.spectrum_exponent, _PEAK, generator)
        return _BinaryInk(field, self._threshold(), self.wavelength_mm[0])

    def _threshold(self) -> float:
        from scipy.special import ndtri

        return float(ndtri(self.coverage))

    def description(self, mm_per_px: float) -> str:
        """Return a one-line description; see `PatternModel`."""
        short, long = self.wavelength_mm
        lengths = f"{short:.3f} to {long:.3f} mm ({short / mm_per_px:.2f} to {long / mm_per_px:.2f} px)"
        return f"noise of wavelengths {lengths}, thresholded to ink and paper, {100 * self.coverage:g} % covered"

    @property
    def finest_mm(self) -> float:
        """Shortest wavelength in mm."""
        return self.wavelength_mm[0]

    @property
    def coarsest_mm(self) -> float:
        """Longest wavelength in mm."""
        return self.wavelength_mm[1]

    def size_problems(self, size_mm: tuple[float, float]) -> list[Problem]:
        """Return the problems that prevent drawing a pattern of this size; see `PatternModel`."""
        return list_band_problems(self.wavelength_mm, size_mm)

    def power(self, count: int, pitch_mm: float) -> Array:
        """Return the spectrum of the ink coverage; see `PatternModel`."""
        before = compute_band_power(self.wavelength_mm, self.spectrum_exponent, count, pitch_mm)
        correlation = np.clip(np.fft.ifft2(before).real * count**2, -1.0, 1.0)
        # The covariance is a smooth function of the angle: 4097 samples give an accuracy of 1e-7.
        angles = np.linspace(-np.pi / 2, np.pi / 2, _ANGLES)
        known = compute_clipped_covariance(np.sin(angles), self._threshold())
        covariance = np.interp(np.arcsin(correlation), angles, known)
        return np.asarray(np.maximum(np.fft.fft2(covariance).real / count**2, 0.0))


def compute_clipped_covariance(correlation: Array, threshold: float) -> Array:
    """Return the covariance of the indicator of Gaussian noise below a threshold; p (1 - p) at ρ = 1.

    Its derivative by the correlation ρ (``correlation``) is the density of two values at the threshold, so it is the
    integral of exp(-h² / (1 + r)) / (2 π √(1 - r²)) over r from 0 to ρ. At h = 0 it is arcsin(ρ) / 2 π.
    """
    angle = np.arcsin(correlation)  # the substitution r = sin a removes the root
    if threshold == 0:
        return np.asarray(angle / (2 * np.pi))
    nodes, weights = np.polynomial.legendre.leggauss(_ORDERS)
    total = np.zeros_like(angle)
    for node, weight in zip(nodes, weights, strict=True):
        total += weight * np.exp(-(threshold**2) / (1 + np.sin(angle * (node + 1) / 2)))
    return np.asarray(total * angle / 2 / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class _BinaryInk(PatternDrawing):
    """Ink where noise is below a threshold."""

    field: NoiseField
    threshold: float
    shortest_mm: float

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        below = self.threshold - self.field.texels(box_mm, shape)
        # The coverage of a texel at a border follows from the local slope.
        along_y, along_x = np.gradient(below)
        slope = np.maximum(np.hypot(along_x, along_y), np.float32(1e-6))
        return np.asarray(np.clip(0.5 + below / slope, 0.0, 1.0), dtype=np.float32)

    def marks(self, box_mm: Box) -> InkAreas:
        from matplotlib.figure import Figure

        left, top, width, height = box_mm
        pitch = self.shortest_mm / SAMPLES
        x = left + np.linspace(0, width, int(np.ceil(width / pitch)) + 1)
        y = top + np.linspace(0, height, int(np.ceil(height / pitch)) + 1)
        values = self.field.at(x, y)
        lowest = min(float(values.min()), self.threshold) - 1.0
        # Outlines of holes have the opposite orientation.
        (path,) = Figure().add_subplot().contourf(x, y, values, levels=[lowest, self.threshold]).get_paths()
        if not len(path.vertices):
            return InkAreas([])
        starts = np.flatnonzero(path.codes == path.MOVETO)
        pieces = np.split(np.asarray(path.vertices, dtype=np.float64), starts[1:])
        return InkAreas([piece[:-1] for piece in pieces])


_TEXELS, _MOST_TEXELS = 16, 40_000_000  # texels per diameter for measuring the coverage, and their largest number
MOST_DOTS = 3_000_000
"""Largest number of dots of a pattern; larger files cannot be printed."""
# Random sequential addition of non-overlapping discs saturates at a coverage of 0.547 (Feder 1980), and is slow there.
_JAMMED = 0.5
_PATIENCE = 400  # largest number of candidates per dot of a dense packing


class SpecklePattern(PatternModel):
    """Random dots, printed as discs."""

    kind: Literal["speckle"]
    """Pattern type: ``speckle``."""
    dot_mm: Positive
    """Diameter of the dots in mm."""
    coverage: Annotated[float, Field(gt=0, le=0.9)] = 0.5
    """Fraction of the sheet covered by dots."""
    spacing: Annotated[float, Field(ge=0, le=3)] = 1.0
    """Least distance of two centres in diameters: from 1, dots do not overlap; 0 allows any position."""

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> PatternDrawing:
        """Draw the pattern; see `PatternModel`."""
        return _Speckle(_place_centres(self, size_mm, generator), self.dot_mm)

    def description(self, mm_per_px: float) -> str:
        """Return a one-line description; see `PatternModel`."""
        apart = "anywhere" if self.spacing == 0 else f"centres at least {self.spacing:g} diameters apart"
        px = self.dot_mm / mm_per_px
        return f"dots of {self.dot_mm:.3f} mm ({px:.2f} px), {100 * self.coverage:g} % covered, {apart}"

    @property
    def finest_mm(self) -> float:
        """Diameter of the dots in mm."""
        return self.dot_mm

    @property
    def coarsest_mm(self) -> float:
        """Diameter of the dots in mm."""
        return self.dot_mm

    def size_problems(self, size_mm: tuple[float, float]) -> list[Problem]:
        """Return the problems that prevent drawing a pattern of this size; see `PatternModel`."""
        problems = []
        most = self._most_coverage()
        if self.coverage > most:
            message = f"exceeds the maximum for centres at least {self.spacing:g} diameters apart, {most:.2f}"
            problems.append(Problem("coverage", f"{message}; reduce coverage or spacing", self.coverage))
        count = -math.log1p(-self.coverage) * 4 / math.pi * (size_mm[0] / self.dot_mm) * (size_mm[1] / self.dot_mm)
        if count > MOST_DOTS:
            message = f"requires {count:,.0f} dots on a sheet of this size, more than {MOST_DOTS:,}; use a smaller one"
            problems.append(Problem("dot_mm", message, self.dot_mm))
        return problems

    def _most_coverage(self) -> float:
        """Return a coverage that random placement reaches: as for independent dots, or without overlap."""
        if self.spacing == 0:
            return 0.9
        share = _JAMMED / self.spacing**2
        return min(max(-math.expm1(-share), min(share, _JAMMED)), 0.9)

    def power(self, count: int, pitch_mm: float) -> Array | None:
        """Return the spectrum of the ink coverage for a Boolean model (zero spacing); see `PatternModel`."""
        if self.spacing > 0:
            return None
        at = np.fft.fftfreq(count, 1 / (count * pitch_mm))
        covariance = compute_boolean_covariance(np.hypot(at[:, None], at), self.dot_mm, self.coverage)
        return np.asarray(np.maximum(np.fft.fft2(covariance).real / count**2, 0.0))


def compute_boolean_covariance(distance_mm: Array, dot_mm: float, coverage: float) -> Array:
    """Return the covariance of the ink coverage of discs with Poisson centres (Matheron's Boolean model).

    With coverage p by n discs per area, and the common area A(r) of two discs at distance r (``distance_mm``), two
    points are both bare with probability exp(-n (π D² / 2 - A)): the covariance is (1 - p)² (exp(n A) - 1).
    """
    share = np.minimum(np.asarray(distance_mm) / dot_mm, 1.0)
    common = 2 / np.pi * (np.arccos(share) - share * np.sqrt(1 - share**2))  # relative to the area of a disc
    return np.asarray((1 - coverage) ** 2 * np.expm1(-math.log1p(-coverage) * common))


@dataclass(frozen=True, eq=False)
class _Speckle(PatternDrawing):
    """Placed dots."""

    centres_mm: Array
    dot_mm: float

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        from scenetruth.design.patterns.dot_kernels import draw_discs

        left, top, width, height = box_mm
        pitch = width / shape[1]
        # Texels are square up to the rounding of their number.
        scale = np.array([shape[1] / width, shape[0] / height])
        raster = np.zeros(shape, dtype=np.float32)
        centres = (self.marks(box_mm).centres_mm - (left, top)) * scale - 0.5
        draw_discs(raster, np.ascontiguousarray(centres), self.dot_mm / 2 / pitch)
        return raster

    def marks(self, box_mm: Box) -> InkDots:
        left, top, width, height = box_mm
        low, reach = np.array([left, top]), self.dot_mm
        near = (self.centres_mm > low - reach) & (self.centres_mm < low + (width, height) + reach)
        return InkDots(self.centres_mm[near.all(axis=1)], self.dot_mm)


def _place_centres(model: SpecklePattern, size_mm: tuple[float, float], generator: np.random.Generator) -> Array:
    """Return centres of dots with the required coverage; some are just outside the sheet."""
    from scenetruth.design.patterns.dot_kernels import place_dots

    (width, height), radius = size_mm, model.dot_mm / 2
    least = model.spacing * model.dot_mm
    area = (width + 2 * radius) * (height + 2 * radius)
    texel = max(model.dot_mm / _TEXELS, math.sqrt(width * height / _MOST_TEXELS))
    covered = np.zeros((max(round(height / texel), 1), max(round(width / texel), 1)), dtype=np.bool_)
    wanted = round(model.coverage * covered.size)
    # More dots than a coverage of 0.999 requires, and than fit with the least distance.
    expected = area / (math.pi * radius**2)
    placed = np.empty((int(8 * expected) + 64, 2))
    side = least / math.sqrt(2)
    rows, columns = (int((extent + 2 * radius) / side) + 1 if least > 0 else 1 for extent in (height, width))
    cells = np.full((rows, columns), -1, dtype=np.int32)
    count, so_far, offered = 0, 0, 0
    batch = max(int(expected), 1024)
    while so_far < wanted:
        if offered > _PATIENCE * max(expected, 1.0) + 64 * batch:
            reached = so_far / covered.size
            message = f"is not reached: random placement ends at {reached:.2f}; reduce coverage or spacing"
            raise ArgumentError([Problem("coverage", message, model.coverage)], source="a pattern")
        candidates = generator.random((batch, 2)) * (width + 2 * radius, height + 2 * radius) - radius
        count, so_far = place_dots(candidates, placed, count, cells, least, covered, texel, radius, wanted, so_far)
        offered += batch
    return np.ascontiguousarray(placed[:count])
