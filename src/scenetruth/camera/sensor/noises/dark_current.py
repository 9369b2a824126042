"""Electrons that pixels collect without light."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import NonNegative, Positive

__all__ = ["DarkCurrent", "checked_hot_pixel_current"]


def checked_hot_pixel_current(value: float, info: ValidationInfo) -> float:
    """Check, as a validator of pydantic, that hot pixels have more dark current than the others.

    Parameters
    ----------
    value
        Dark current of hot pixels, in electrons per second.
    info
        The fields before it: ``dark_current_e_per_s`` and ``hot_pixel_share``.

    Returns
    -------
    float
        The value.

    Raises
    ------
    ValueError
        If there are hot pixels, and their current is below that of the others.
    """
    current = info.data.get("dark_current_e_per_s")
    if info.data.get("hot_pixel_share") and current is not None and value < current:
        msg = f"must not be below dark_current_e_per_s, {current:g}, where there are hot pixels"
        raise ValueError(msg)
    return value


class DarkCurrent(Effect):
    """Heat frees electrons too: their mean number is added, in hot pixels more than in others.

    It comes before the shot noise in the chain, as dark electrons have shot noise too.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["dark_current"]
    """This effect."""
    exposure_time_s: Positive
    """Time over which a pixel collects electrons."""
    dark_current_e_per_s: NonNegative = 0.0
    """Electrons that a pixel collects in a second without light."""
    hot_pixel_share: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    """Share of pixels with ``hot_pixel_current_e_per_s``."""
    hot_pixel_current_e_per_s: Annotated[NonNegative, Field(validate_default=True)] = 0.0
    """Dark current of hot pixels."""

    _hot_pixel_current = field_validator("hot_pixel_current_e_per_s")(checked_hot_pixel_current)

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the mean number of electrons of each pixel."""
        hot = generator.random(shape) < self.hot_pixel_share
        current = np.where(hot, self.hot_pixel_current_e_per_s, self.dark_current_e_per_s)
        return np.asarray(current * self.exposure_time_s, dtype=np.float64)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add the electrons."""
        assert exposure.pattern is not None
        return signal + exposure.pattern

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the electrons of a pixel that is not hot."""
        return signal + self.dark_current_e_per_s * self.exposure_time_s

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return what is left for light."""
        return largest_output - self.dark_current_e_per_s * self.exposure_time_s
