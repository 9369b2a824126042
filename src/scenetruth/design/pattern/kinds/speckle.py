"""Speckle: equal dots at random places."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.design.pattern.base import Array, Box, Dots, Drawing, PatternModel
from scenetruth.design.pattern.errors import PatternError
from scenetruth.errors import Problem
from scenetruth.model import Positive

__all__ = ["SpecklePattern", "boolean_covariance"]

# Texels per diameter on which the covered share is counted, and at most how many there are of them.
_TEXELS, _MOST_TEXELS = 16, 40_000_000
MOST_DOTS = 3_000_000
"""Dots of a pattern: more of them make files that nothing prints."""
# Random sequential addition of discs that must not overlap ends at a coverage of 0.547 (Feder 1980), and is slow there.
_JAMMED = 0.5
# Candidates offered, per dot that would fit if they lay side by side, before it is given up.
_PATIENCE = 400


class SpecklePattern(PatternModel):
    """Random dots, printed as discs."""

    kind: Literal["speckle"]
    """``speckle``."""
    dot_mm: Positive
    """Diameter of the dots in mm."""
    coverage: Annotated[float, Field(gt=0, le=0.9)] = 0.5
    """Share of the sheet that they cover."""
    spacing: Annotated[float, Field(ge=0, le=3)] = 1.0
    """Least distance of two centres in diameters: from 1 on, dots do not overlap; 0 lets them lie anywhere."""

    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> Drawing:
        """Draw the pattern; see `PatternModel`."""
        return _Speckle(_places(self, size_mm, generator), self.dot_mm)

    def told(self, mm_per_px: float) -> str:
        """Return what the pattern is, in a line; see `PatternModel`."""
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
        """Return what keeps a pattern of that size from being drawn; see `PatternModel`."""
        problems = []
        most = self._most_coverage()
        if self.coverage > most:
            message = f"is more than dots reach whose centres keep {self.spacing:g} diameters apart, {most:.2f}"
            problems.append(Problem("coverage", f"{message}; lower it, or spacing", self.coverage))
        count = -math.log1p(-self.coverage) * 4 / math.pi * (size_mm[0] / self.dot_mm) * (size_mm[1] / self.dot_mm)
        if count > MOST_DOTS:
            message = f"needs {count:,.0f} dots on a sheet of this size, more than {MOST_DOTS:,}; print a smaller sheet"
            problems.append(Problem("dot_mm", message, self.dot_mm))
        return problems

    def _most_coverage(self) -> float:
        """Return a coverage that random places surely reach: as if they were independent, or without overlap."""
        if self.spacing == 0:
            return 0.9
        share = _JAMMED / self.spacing**2
        return min(max(-math.expm1(-share), min(share, _JAMMED)), 0.9)

    def power(self, count: int, pitch_mm: float) -> Array | None:
        """Return the spectrum of the ink where dots may lie anywhere: a Boolean model; see `PatternModel`."""
        if self.spacing > 0:
            return None
        at = np.fft.fftfreq(count, 1 / (count * pitch_mm))
        covariance = boolean_covariance(np.hypot(at[:, None], at), self.dot_mm, self.coverage)
        return np.asarray(np.maximum(np.fft.fft2(covariance).real / count**2, 0.0))


def boolean_covariance(distance_mm: Array, dot_mm: float, coverage: float) -> Array:
    """Return the covariance of the ink of discs whose centres are a Poisson process (Matheron's Boolean model).

    With the share p covered by n discs per area, and A(r) what two discs at a distance r share, two points are both
    bare with the probability exp(-n (π D² / 2 - A)): the covariance is (1 - p)² (exp(n A) - 1).

    Parameters
    ----------
    distance_mm
        Distances of two points, any shape.
    dot_mm
        Diameter D of the discs.
    coverage
        p = 1 - exp(-n π D² / 4).

    Returns
    -------
    numpy.ndarray
        p (1 - p) at 0, and 0 from D on.
    """
    share = np.minimum(np.asarray(distance_mm) / dot_mm, 1.0)
    # As a share of one disc's area.
    common = 2 / np.pi * (np.arccos(share) - share * np.sqrt(1 - share**2))
    return np.asarray((1 - coverage) ** 2 * np.expm1(-math.log1p(-coverage) * common))


@dataclass(frozen=True, eq=False)
class _Speckle(Drawing):
    """Dots that have been placed."""

    centres_mm: Array
    dot_mm: float

    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        from scenetruth.design.pattern.dot_kernels import draw_discs

        left, top, width, height = box_mm
        pitch = width / shape[1]
        # Texels are square but for what rounding their number does.
        scale = np.array([shape[1] / width, shape[0] / height])
        raster = np.zeros(shape, dtype=np.float32)
        centres = (self.marks(box_mm).centres_mm - (left, top)) * scale - 0.5
        draw_discs(raster, np.ascontiguousarray(centres), self.dot_mm / 2 / pitch)
        return raster

    def marks(self, box_mm: Box) -> Dots:
        left, top, width, height = box_mm
        low, reach = np.array([left, top]), self.dot_mm
        near = (self.centres_mm > low - reach) & (self.centres_mm < low + (width, height) + reach)
        return Dots(self.centres_mm[near.all(axis=1)], self.dot_mm)


def _places(model: SpecklePattern, size_mm: tuple[float, float], generator: np.random.Generator) -> Array:
    """Return centres of dots that cover the sheet as much as is wanted; some are just outside."""
    from scenetruth.design.pattern.dot_kernels import place_dots

    (width, height), radius = size_mm, model.dot_mm / 2
    least = model.spacing * model.dot_mm
    area = (width + 2 * radius) * (height + 2 * radius)
    texel = max(model.dot_mm / _TEXELS, math.sqrt(width * height / _MOST_TEXELS))
    covered = np.zeros((max(round(height / texel), 1), max(round(width / texel), 1)), dtype=np.bool_)
    wanted = round(model.coverage * covered.size)
    # More dots than a coverage of 0.999 takes, and than fit if they keep apart.
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
            message = f"is not reached: random places end at {reached:.2f}; lower it, or spacing"
            raise PatternError([Problem("coverage", message, model.coverage)])
        candidates = generator.random((batch, 2)) * (width + 2 * radius, height + 2 * radius) - radius
        count, so_far = place_dots(candidates, placed, count, cells, least, covered, texel, radius, wanted, so_far)
        offered += batch
    return np.ascontiguousarray(placed[:count])
