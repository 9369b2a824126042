"""What every effect of a sensor is: a step from one signal to the next, with a random stream of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.model import FrozenModel

__all__ = ["Effect", "Exposure", "LinearImage", "Unit"]

Unit = Literal[
    "radiance", "share of full scale", "photons", "electrons", "unrounded digital numbers", "digital numbers"
]
"""What the values of a signal are: all are per pixel and exposure, radiance in units of the scene."""


@dataclass(frozen=True, eq=False)
class LinearImage:
    """A linear image, and which one of the recording it is.

    Parameters
    ----------
    radiance
        What the sensor is given, shape (y, x).
    s_y, s, t
        Row, camera position and frame, 0 the reference.
    """

    radiance: NDArray[np.float32]
    s_y: int = 0
    s: int = 0
    t: int = 0


@dataclass(frozen=True, eq=False)
class Exposure:
    """What an effect may know of the image that it works on.

    Parameters
    ----------
    s_y, s, t
        Row, camera position and frame, 0 the reference.
    full_scale
        Largest digital number of the chain; 1 if it does not digitise.
    generator
        Makes the effect's own source of random numbers for this image.
    pattern
        What `Effect.draw_pattern` returned for the recording.
    previous
        The signal, shape (y, x), that entered the effect when the sensor took the image before; None if the effect does
        not remember, and for the first image.
    """

    s_y: int
    s: int
    t: int
    full_scale: float
    generator: Callable[[], np.random.Generator]
    pattern: NDArray[np.float64] | None = None
    previous: NDArray[np.float64] | None = None


class Effect(FrozenModel):
    """A step of the chain that a sensor is: takes a signal, and gives the next one."""

    takes: ClassVar[Unit]
    """Unit of the signal that it needs."""
    gives: ClassVar[Unit]
    """Unit of the signal that it makes."""
    remembers: ClassVar[bool] = False
    """Whether it needs the signal of the image before."""

    kind: str
    """Which effect."""
    name: Annotated[str, Field(pattern=r"^([a-z][a-z0-9_]*)?$")] = ""
    """Keys its random numbers, in small letters, digits and underscores; the kind if empty. Effects of one kind in one
    sensor need different names."""

    @property
    def key(self) -> str:
        """What keys its random numbers."""
        return self.name or self.kind

    def stream(self, s_y: int, s: int, t: int) -> tuple[str | int, ...]:
        """Return the key of its random numbers for one image."""
        return (self.key, s_y, s, t)

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64] | None:
        """Return what distinguishes the pixels from each other in all images of a recording; None if nothing does.

        Parameters
        ----------
        shape
            Rows and columns.
        generator
            Source of the pattern: the effect's own, the same for all images.
        """
        return None

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return the next signal.

        Parameters
        ----------
        signal
            In the unit that it takes, shape (y, x); not to be changed in place.
        exposure
            What it may know of the image.
        """
        raise NotImplementedError

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return what becomes of a uniform signal in the mean over pixels and images."""
        return signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest mean signal that it still tells from larger ones, if what follows tells so much."""
        return largest_output
