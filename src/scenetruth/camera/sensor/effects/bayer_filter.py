"""Colour filters before the pixels."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import Positive

__all__ = ["BayerFilter", "BayerOrder"]

BayerOrder = Literal["rggb", "grbg", "gbrg", "bggr"]

# Places of the colours in `BayerFilter.response`.
_COLOURS = "rgb"


class BayerFilter(Effect):
    """Colour filters on 2 x 2 pixels let through a part of the photons of a grey scene."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["bayer_filter"]
    """This effect."""
    order: BayerOrder
    """Colours of the 2 x 2 pixels, row by row from the upper left."""
    response: tuple[Positive, Positive, Positive] = (0.7, 1.0, 0.6)
    """What red, green and blue filters let through of a grey scene."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return what each pixel's filter lets through."""
        block = np.array([self.response[_COLOURS.index(colour)] for colour in self.order]).reshape(2, 2)
        repeats = (-(-shape[0] // 2), -(-shape[1] // 2))
        return np.asarray(np.tile(block, repeats)[: shape[0], : shape[1]])

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Let a part of the photons through."""
        assert exposure.pattern is not None
        return signal * exposure.pattern

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the photons behind the brightest filter."""
        return signal * max(self.response)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons before the brightest filter, whose pixels saturate first."""
        return largest_output / max(self.response)
