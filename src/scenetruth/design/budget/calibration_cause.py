"""What causes in the calibration have in common: images stay as they are, and estimates are told wrong numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.propagation.base import Errors, Propagation
from scenetruth.design.budget.sight import Sight
from scenetruth.scene import Scene

__all__ = ["CalibrationCause"]

_QUANTITIES = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z")


class CalibrationCause(Cause):
    """A number of the calibration with a standard deviation."""

    group = "calibration"
    field: ClassVar[str]
    """Its field in `Calibration`."""
    unit: ClassVar[str]
    """Unit of its standard deviation."""
    signs: ClassVar[tuple[str, ...]] = ("+",)
    """Of each of its numbers, the signs of its errors from draw to draw."""

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether it is not known exactly."""
        return bool(getattr(calibration, self.field) > 0)

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return its standard deviation."""
        return f"{getattr(calibration, self.field):g} {self.unit}"

    def drawn_values(self, draw: int) -> list[float]:
        """Return the errors of a draw, in standard deviations.

        All are plus or minus one, by a plan in which the products of different numbers add up to nothing over four
        draws: a few draws then have the mean square of very many, without products between causes.
        """
        return [1.0 if signs[draw % len(signs)] == "+" else -1.0 for signs in self.signs]

    def responses_of(self, sight: Sight, *off: float) -> Iterator[Errors]:
        """Give the errors that follow from errors of its numbers, of the quantities that depend on them."""
        raise NotImplementedError

    def responses(self, sight: Sight, propagation: Propagation, calibration: Calibration) -> Iterator[Errors]:
        """Give the errors of one standard deviation each; see `Cause`."""
        return self._completed(sight, [float(getattr(calibration, self.field))] * len(self.signs))

    def responses_drawn(
        self, sight: Sight, propagation: Propagation, calibration: Calibration, scene: Scene, draw: int
    ) -> Iterator[Errors]:
        """Return the errors of a draw; see `Cause`."""
        size = float(getattr(calibration, self.field))
        return self._completed(sight, [size * one for one in self.drawn_values(draw)])

    def _completed(self, sight: Sight, off: list[float]) -> Iterator[Errors]:
        """Give the errors of all quantities: none where the formula has not the number."""
        none = dict.fromkeys(_QUANTITIES, np.zeros_like(sight.depth))
        return ({**none, **errors} for errors in self.responses_of(sight, *off))

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return a better calibration."""
        size = getattr(calibration, self.field) / 4
        return Remedy(
            f"a {self.title} known four times as well (calibration.{self.field}: {size:g})", {self.kind: 0.25}
        )
