"""What an estimate would show if it had some slips and no errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.scoring.slips.material import Material
from scenetruth.scoring.slips.moves import Move, Places
from scenetruth.scoring.slips.scales import Scaled
from scenetruth.scoring.slips.slip import Slip
from scenetruth.scoring.slips.turns import Turn

__all__ = ["RIGHT", "Hypothesis"]

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Hypothesis:
    """Up to one slip of place, of meaning and of scale each.

    Parameters
    ----------
    move, turn, scaled
        The slips, or None.
    """

    move: Move | None = None
    turn: Turn | None = None
    scaled: Scaled | None = None

    @property
    def parts(self) -> int:
        """How many slips there are."""
        return sum(part is not None for part in (self.move, self.turn, self.scaled))

    @property
    def factor(self) -> float:
        """By how much values are too large."""
        return 1.0 if self.scaled is None else self.scaled.factor

    def predicted(self, material: Material, places: Places) -> Map:
        """Return what the estimate would show at some places, shape (component, n); NaN where that is not known."""
        source = places if self.move is None else self.move.source(places, material.grid)
        if source is None:
            return np.full((len(material.truth), len(places.y)), np.nan)
        values = material.truth_at(source)
        if self.turn is not None:
            values = self.turn.apply(values, material.rays[source.y, source.x], material.facts)
        return self.factor * values

    def slips(self, quantity: str, explained: float) -> list[Slip]:
        """Return what is told of a quantity."""
        told = []
        if self.turn is not None:
            told.append((self.turn.kind, self.turn.message))
        if self.scaled is not None:
            told.append((self.scaled.scale.kind, self.scaled.message(quantity)))
        if self.move is not None:
            told.append((self.move.kind, self.move.message.format(quantity=quantity)))
        return [Slip(kind, quantity, message, explained) for kind, message in told]


RIGHT = Hypothesis()
"""No slip."""
