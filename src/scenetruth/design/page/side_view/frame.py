"""A piece of the side view on paper: which millimetres it shows, at which scale, and which way round."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Frame", "Place", "round_length_mm"]

Place = tuple[float, float]
"""A place on paper: to the right, and down."""


@dataclass(frozen=True)
class Frame:
    """A window into the side view, at the same scale both ways.

    Parameters
    ----------
    name
        Its name within the page.
    z_mm, x_mm
        What it shows.
    scale
        Units of the drawing per mm.
    left, right, top, bottom
        Space around it for dimensions, in units of the drawing.
    upright
        Whether Z goes up and X to the right; else Z goes to the right and X down. Both are what one sees looking along
        Y.
    """

    name: str
    z_mm: tuple[float, float]
    x_mm: tuple[float, float]
    scale: float
    left: float
    right: float
    top: float
    bottom: float
    upright: bool = False

    @property
    def sides(self) -> tuple[float, float, float, float]:
        """Left, right, upper and lower end of the window on paper."""
        z, x = ((each[1] - each[0]) * self.scale for each in (self.z_mm, self.x_mm))
        wide, high = (x, z) if self.upright else (z, x)
        return self.left, self.left + wide, self.top, self.top + high

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the drawing with what is around."""
        _, right, _, bottom = self.sides
        return right + self.right, bottom + self.bottom

    def at(self, z_mm: float, x_mm: float, *, ahead: float = 0.0, aside: float = 0.0) -> Place:
        """Return where a point is drawn.

        Parameters
        ----------
        z_mm, x_mm
            The point.
        ahead, aside
            Units of the drawing to go on from there along Z and along X.
        """
        z = (z_mm - self.z_mm[0]) * self.scale + ahead
        x = (x_mm - self.x_mm[0]) * self.scale + aside
        return (self.left + x, self.sides[3] - z) if self.upright else (self.left + z, self.top + x)

    def along(self, z_mm: float) -> float:
        """Return where a depth is drawn, along the direction of Z."""
        return self.at(z_mm, self.x_mm[0])[1 if self.upright else 0]

    def beside(self, x_mm: float) -> float:
        """Return where an X is drawn, along the direction of X."""
        return self.at(self.z_mm[0], x_mm)[0 if self.upright else 1]

    def placed(self, points: Iterable[tuple[float, float]]) -> list[Place]:
        """Return where points (Z, X) are drawn."""
        return [self.at(z, x) for z, x in points]

    def inside(self, z_mm: float) -> bool:
        """Whether a depth is shown."""
        return self.z_mm[0] <= z_mm <= self.z_mm[1]


def round_length_mm(most_mm: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50 ... mm (also 0.5, 0.2, 0.1 ...) that is not longer than a length.

    Examples
    --------
    >>> round_length_mm(137.0), round_length_mm(0.3), round_length_mm(5.0)
    (100.0, 0.2, 5.0)
    """
    power = 10.0 ** math.floor(math.log10(most_mm))
    # Of 0.05 and the like, rounding decides on which side of a power of ten they are.
    return next(factor * power for factor in (5.0, 2.0, 1.0, 0.5) if factor * power <= most_mm * (1 + 1e-9))
