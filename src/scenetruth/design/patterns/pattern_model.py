"""What all patterns share: the base model, the drawing made from it, validation, and the error of a pattern."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, model_validator

from scenetruth.errors import ArgumentError, Problem
from scenetruth.validated_model import FrozenModel

__all__ = [
    "Box",
    "GreyPicture",
    "InkAreas",
    "InkDots",
    "Marks",
    "PatternDrawing",
    "PatternError",
    "PatternModel",
    "validate_values",
]


Model = TypeVar("Model", bound=BaseModel)


class PatternError(ArgumentError):
    """A pattern that cannot be made, printed or judged; lists every problem with its path."""

    _noun = "pattern"


def validate_values(
    model: type[Model], values: Mapping[str, Any], path: str = ""
) -> tuple[Model | None, list[Problem]]:
    """Return a model made of values, or what is wrong with them."""
    try:
        return model.model_validate(dict(values)), []
    except ValidationError as error:
        known = ", ".join(sorted(set(model.model_fields) - {"kind"}))
        return None, list_problems(error, path, known)


def list_problems(error: ValidationError, path: str, known: str) -> list[Problem]:
    """Return the problems that a validation has found."""
    found = []
    for entry in error.errors():
        where = ".".join([path, *map(str, entry["loc"])] if path else map(str, entry["loc"]))
        message = entry["msg"].removeprefix("Value error, ").replace("Input should", "should")
        if entry["type"] == "missing":
            found.append(Problem(where, "is missing"))
            continue
        if entry["type"] == "extra_forbidden":
            message = f"is no setting here; there are {known}"
        found.append(Problem(where, message, entry.get("input")))
    return found


Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left and upper border, width and height in mm; y runs down, (0, 0) is the pattern's upper left corner."""


@dataclass(frozen=True, eq=False)
class InkDots:
    """Discs of ink.

    ``centres_mm``: Shape (n, 2).
    ``diameter_mm``: Of all of them.
    """

    centres_mm: Array
    diameter_mm: float


@dataclass(frozen=True, eq=False)
class InkAreas:
    """Areas of ink.

    ``outlines_mm``: Closed polygons, each of shape (n, 2); holes run the other way round than what they are in.
    """

    outlines_mm: list[Array]


@dataclass(frozen=True, eq=False)
class GreyPicture:
    """A picture in shades of grey.

    ``values``: sRGB grey values, shape (rows, columns), uint8.
    ``box_mm``: What it covers.
    """

    values: NDArray[np.uint8]
    box_mm: Box


Marks = InkDots | InkAreas | GreyPicture
"""What a printer puts on paper."""


class PatternDrawing(ABC):
    """A pattern that has been drawn."""

    @abstractmethod
    def ink(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return how much of every texel ink covers."""

    @abstractmethod
    def marks(self, box_mm: Box) -> Marks:
        """Return what is to be printed in a part of the pattern; it may reach beyond."""


class PatternModel(FrozenModel, ABC):
    """What all patterns share. A pattern is a model derived from this one, in a module of `pattern.kinds`."""

    kind: str
    """Name of the pattern."""
    radiances: tuple[Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]] = (0.05, 0.85)
    """Reflectance of ink and of paper; matt paper and toner have about 0.85 and 0.05."""

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
    def told(self, mm_per_px: float) -> str:
        """Return what the pattern is, in a line: lengths in mm, and in px of the camera that it is made for."""

    @property
    @abstractmethod
    def finest_mm(self) -> float:
        """Diameter of dots, or shortest wavelength, in mm."""

    @property
    @abstractmethod
    def coarsest_mm(self) -> float:
        """Diameter of dots, or longest wavelength, in mm."""

    def size_problems(self, size_mm: tuple[float, float]) -> list[Problem]:
        """Return what keeps a pattern of that size from being drawn."""
        return []

    def power(self, count: int, pitch_mm: float) -> Array | None:
        """Return the spectrum of the ink from theory.

        Returns: Power at the frequencies of `numpy.fft.fftfreq` along y and x, shape (count, count), which sums to the
        variance of the ink; None if there is no closed form.
        """
        return None
