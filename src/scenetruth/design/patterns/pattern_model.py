"""Base model of patterns, drawings, validation, and the exception for patterns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, model_validator

from scenetruth.errors import Problem
from scenetruth.validated_model import FrozenModel
from scenetruth.validation_problems import list_problems

__all__ = [
    "Box",
    "GreyPicture",
    "InkAreas",
    "InkDots",
    "Marks",
    "PatternDrawing",
    "PatternModel",
    "validate_values",
]


Model = TypeVar("Model", bound=BaseModel)


def validate_values(
    model: type[Model], values: Mapping[str, Any], path: str = ""
) -> tuple[Model | None, list[Problem]]:
    """Return a validated model, or the problems of the values."""
    try:
        return model.model_validate(dict(values)), []
    except ValidationError as error:
        return None, list_problems(error, values, model=model, under=path)


Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left and upper border, width and height in mm; y points down, (0, 0) is the upper left corner of the pattern."""


@dataclass(frozen=True, eq=False)
class InkDots:
    """Discs of ink with a common diameter and centres of shape (n, 2)."""

    centres_mm: Array
    diameter_mm: float


@dataclass(frozen=True, eq=False)
class InkAreas:
    """Areas of ink: closed polygons, each of shape (n, 2); holes have the opposite orientation."""

    outlines_mm: list[Array]


@dataclass(frozen=True, eq=False)
class GreyPicture:
    """A picture in shades of grey: sRGB values, shape (rows, columns), uint8, and the box that it covers."""

    values: NDArray[np.uint8]
    box_mm: Box


Marks = InkDots | InkAreas | GreyPicture
"""Marks on paper."""


class PatternDrawing(ABC):
    """A drawn pattern."""

    @abstractmethod
    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the ink coverage of every texel."""

    @abstractmethod
    def marks(self, box_mm: Box) -> Marks:
        """Return the marks to print in a part of the pattern; they may extend beyond it."""


class PatternModel(FrozenModel, ABC):
    """Base class of the pattern types in the module `pattern_types`."""

    kind: str
    """Name of the pattern type."""
    radiances: tuple[Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]] = (0.05, 0.85)
    """Reflectance of ink and of paper; about 0.05 for toner and 0.85 for matt paper."""

    @model_validator(mode="after")
    def _seen(self) -> PatternModel:
        if self.radiances[0] >= self.radiances[1]:
            msg = f"ink must be darker than paper: radiances {self.radiances[0]:g}, {self.radiances[1]:g}"
            raise ValueError(msg)
        return self

    @abstractmethod
    def draw(self, size_mm: tuple[float, float], generator: np.random.Generator) -> PatternDrawing:
        """Draw the pattern."""

    @abstractmethod
    def description(self, mm_per_px: float) -> str:
        """Return a one-line description, with lengths in mm and in px of the rig."""

    @property
    @abstractmethod
    def finest_mm(self) -> float:
        """Diameter of dots, or shortest wavelength, in mm."""

    @property
    @abstractmethod
    def coarsest_mm(self) -> float:
        """Diameter of dots, or longest wavelength, in mm."""

    def size_problems(self, size_mm: tuple[float, float]) -> list[Problem]:
        """Return the problems that prevent drawing a pattern of this size."""
        return []

    def power(self, count: int, pitch_mm: float) -> Array | None:
        """Return the analytic power of the ink at `numpy.fft.fftfreq` frequencies, shape (count, count), or None."""
        return None
