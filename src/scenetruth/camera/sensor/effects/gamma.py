"""A response that is bent on purpose."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera.sensor.base import Effect, Exposure, Unit
from scenetruth.model import Positive

__all__ = ["Exponent", "Gamma"]

Exponent = Annotated[Positive, Field(le=100)]
"""Beyond, almost all of the response is one digital number."""


class Gamma(Effect):
    """Digital numbers are full scale (linear / full scale)^gamma."""

    takes: ClassVar[Unit] = "unrounded digital numbers"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["gamma"]
    """This effect."""
    gamma: Exponent
    """The exponent; 1 is linear."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Bend the response between 0 and full scale, where it ends."""
        return exposure.full_scale * np.clip(signal / exposure.full_scale, 0, 1) ** self.gamma

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the bent digital number."""
        return full_scale * float(min(max(signal / full_scale, 0.0), 1.0) ** self.gamma)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the linear digital number of a bent one."""
        return full_scale * float(min(largest_output / full_scale, 1.0) ** (1 / self.gamma))
