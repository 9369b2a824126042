"""What is told of one slip."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Slip"]


@dataclass(frozen=True)
class Slip:
    """A likely slip of convention in an estimate.

    Parameters
    ----------
    kind
        Short and stable name, such as ``"sign"`` or ``"metres"``.
    quantity
        The variable of the estimate, such as ``"disparity"``.
    message
        One sentence: what is likely wrong, and the remedy.
    explained
        The share of the misfit that undoing the slip takes away, 0 to 1: of the median error, weighted by the change
        that the slip makes; of shifts by pixels, of its square away from edges. Of slips that are there together, each
        has the share of all of them.
    """

    kind: str
    quantity: str
    message: str
    explained: float
