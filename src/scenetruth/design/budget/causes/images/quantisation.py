"""Rounding to digital numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.camera import chain_of
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.sensor_cause import SensorCause
from scenetruth.scene import Scene

_BITS = 16


class Quantisation(SensorCause):
    """Rounding to the bits of a digital number; off, these are 16."""

    kind = "quantisation"
    title = "rounding to digital numbers"

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether numbers have less than 16 bits."""
        return 0 < self._bits(scene) < _BITS

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Give digital numbers 16 bits, and the gain before them what that takes."""
        if not isinstance(plain["sensor"], dict):
            return
        effects = plain["sensor"]["effects"]
        more = sum(_BITS - one["bit_depth"] for one in effects if one["kind"] == "digitisation")
        for one in effects:
            if one["kind"] == "digitisation":
                one["bit_depth"] = _BITS
            if one["kind"] == "gain":
                one["gain_dn_per_e"] *= 2**more
                one["black_level_dn"] *= 2**more

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the bits, and the deviation that rounding makes."""
        bits = self._bits(scene)
        return f"{bits} bits, {100 / np.sqrt(12) / (2**bits - 1):.2g} % of full scale"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return four more bits, up to 16."""
        more = min(4, _BITS - self._bits(scene))
        return Remedy(f"{more} more bits (sensor.bit_depth: {self._bits(scene) + more})", {self.kind: 2.0**-more})

    def _bits(self, scene: Scene) -> int:
        bits = [getattr(one, "bit_depth", 0) for one in chain_of(scene.sensor).effects if one.kind == "digitisation"]
        return int(bits[0]) if bits else 0
