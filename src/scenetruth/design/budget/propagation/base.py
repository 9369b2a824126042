"""How disturbances of images become errors of an estimate: what every model of a method offers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.budget.sight import Disturbance

__all__ = ["Errors", "Propagation", "along_and_down"]

Map = NDArray[np.float64]
Errors = Mapping[str, Map]
"""Errors by quantity: ``disparity``, ``depth``, ``velocity_x``, ``velocity_y``, ``velocity_z`` and perhaps
``growth_rate`` (per frame), each of shape (y, x); NaN where nothing is known."""


class Propagation(Protocol):
    """A method of estimation, linear in what little is wrong with the images."""

    name: str
    """The method."""

    def respond(self, disturbance: Disturbance) -> Errors:
        """Return the errors that a disturbance causes."""
        ...

    def own(self) -> dict[str, Errors]:
        """Return the errors that ideal images leave, by the part of the surface that causes them, as far as known."""
        ...


def along_and_down(image: Map, weights_x: Map, weights_y: Map) -> Map:
    """Return the sums of a map over windows, with weights along x and along y."""
    from scipy.ndimage import correlate1d

    return np.asarray(
        correlate1d(correlate1d(image, weights_x, axis=1, mode="constant"), weights_y, axis=0, mode="constant")
    )
