"""Prediction beside simulation: by what factor they differ, and whether that is worth a word."""

from __future__ import annotations

import math

from scenetruth.design.optimise.parts import Discrepancy, Interval, Objective

__all__ = ["compared"]

_KNOWN = 1.3
"""Envelopes are within 30 % of measured scatter in the median: by more than this factor, a difference is notable."""


def compared(rig: int, objective: Objective, predicted: float, simulated: Interval) -> Discrepancy:
    """Return prediction and simulation of one objective at one rig.

    Parameters
    ----------
    rig
        Number of the rig.
    objective
        What is told.
    predicted
        What is predicted of the images that were simulated.
    simulated
        What simulations found: the same statistic.
    """
    ratio = simulated.number / predicted if predicted > 0 and math.isfinite(predicted) else math.nan
    if not math.isfinite(ratio):
        says = f"{objective.title}: nothing was estimated in the simulations, where {predicted:.3g} was predicted"
        return Discrepancy(rig, objective.title, predicted, simulated, math.nan, True, says)
    inside = math.isnan(simulated.low) or simulated.low <= predicted <= simulated.high
    notable = not 1 / _KNOWN <= ratio <= _KNOWN and not (inside and simulated.seeds > 1)
    told = f"{objective.title}: {objective.told_in} simulated {simulated.number:.3g}, "
    told += f"predicted of these images {predicted:.3g} {objective.unit}"
    if not notable:
        says = f"{told}: as far as {simulated.seeds} seeds tell, they agree (factor {ratio:.2f})"
    elif ratio > 1:
        says = f"{told}: {ratio:.1f} times the prediction, which knows noise and the stage but no bias of the method"
    else:
        says = f"{told}: {ratio:.2f} of the prediction"
    return Discrepancy(rig, objective.title, predicted, simulated, ratio, notable, says)
