"""The interface of the effects that model a sensor: each turns one signal into the next."""

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
    """The image that an effect works on, and what it may use for it.

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
    """One step of a sensor's chain: it takes a signal, and gives the next one."""

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
        """Return the key of its random numbers for one image.

        Parameters
        ----------
        s_y, s, t
            Row, camera position and frame, 0 the reference.

        Returns
        -------
        tuple
            The effect's key and the image.
        """
        return (self.key, s_y, s, t)

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64] | None:
        """Return the fixed pattern: how pixels differ from each other in all images of a recording.

        Parameters
        ----------
        shape
            Rows and columns.
        generator
            The effect's own source of random numbers for the pattern.

        Returns
        -------
        numpy.ndarray or None
            One value for each pixel, shape (y, x), in the unit that the effect needs; None if all pixels are alike.
        """
        return None

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return the next signal.

        Parameters
        ----------
        signal
            In the unit that it takes, shape (y, x); not to be changed in place.
        exposure
            The image, its random numbers, the fixed pattern and the image before.

        Returns
        -------
        numpy.ndarray
            In the unit that the effect gives, shape (y, x), float64.
        """
        raise NotImplementedError

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the mean response, over pixels and images, to a uniform signal.

        Parameters
        ----------
        signal
            In the unit that the effect takes.
        full_scale
            Largest digital number of the chain; 1 if it does not digitise.

        Returns
        -------
        float
            In the unit that the effect gives.
        """
        return signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest signal that does not saturate the effect, or those behind it.

        Parameters
        ----------
        largest_output
            Largest signal that does not saturate the effects behind it, in the unit that the effect gives.
        full_scale
            Largest digital number of the chain; 1 if it does not digitise.

        Returns
        -------
        float
            In the unit that the effect takes; infinite without a limit.
        """
        return largest_output
