"""Prediction beside simulation: by what factor they differ, and whether that is worth a word."""

from __future__ import annotations

import math

from scenetruth.design.optimise.parts import Discrepancy, Interval, Objective

__all__ = ["TYPICAL", "compared"]

TYPICAL = 1.4826
"""Standard deviation of a normal error over the median of its size."""
_KNOWN = 1.3
"""Envelopes are within 30 % of measured scatter in the median: by more than this factor, a difference is notable."""


def compared(rig: int, objective: Objective, predicted: float, typical: Interval) -> Discrepancy:
    """Return prediction and simulation of one objective at one rig.

    Parameters
    ----------
    rig
        Number of the rig.
    objective
        What is told.
    predicted
        Standard deviation that is predicted of what was simulated.
    typical
        What was simulated.
    """
    ratio = typical.number / predicted if predicted > 0 and math.isfinite(predicted) else math.nan
    if not math.isfinite(ratio):
        says = f"{objective.title}: nothing was estimated in the simulations, where {predicted:.3g} was predicted"
        return Discrepancy(rig, objective.title, predicted, typical, math.nan, True, says)
    inside = math.isnan(typical.low) or typical.low <= predicted <= typical.high
    notable = not 1 / _KNOWN <= ratio <= _KNOWN and not (inside and typical.seeds > 1)
    told = f"{objective.title}: simulated {typical.number:.3g}, predicted {predicted:.3g} {objective.unit}"
    if not notable:
        says = f"{told}: as far as {typical.seeds} seeds tell, they agree (factor {ratio:.2f})"
    elif ratio > 1:
        says = f"{told}: {ratio:.1f} times the prediction, which knows noise and the stage but no bias of the method"
    else:
        says = f"{told}: {ratio:.2f} of the prediction"
    return Discrepancy(rig, objective.title, predicted, typical, ratio, notable, says)
