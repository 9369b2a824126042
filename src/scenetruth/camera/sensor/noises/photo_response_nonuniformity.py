"""The sensitivities of pixels, which are not quite the same (PRNU)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera.sensor.base import Effect, Exposure, Unit

__all__ = ["PhotoResponseNonuniformity"]


class PhotoResponseNonuniformity(Effect):
    """Every pixel has a sensitivity of its own, normally distributed about 1 and the same in all images."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["photo_response_nonuniformity"]
    """This effect."""
    prnu: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
    """PRNU_1288, standard deviation of the pixels' sensitivities, relative to their mean."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the sensitivities; none is below 0."""
        return np.maximum(1 + self.prnu * generator.standard_normal(shape), 0.0)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the sensitivities."""
        assert exposure.pattern is not None
        return signal * exposure.pattern
