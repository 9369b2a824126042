"""Which rigs are on the front, and which are alternatives behind it."""

from __future__ import annotations

from collections.abc import Sequence

from scenetruth.design.optimise.result import Objective, Rig

__all__ = ["leading"]


def leading(rigs: Sequence[Rig], objectives: Sequence[Objective]) -> list[Rig]:
    """Return the rigs than which no other is predicted to be better in one objective and as good in all.

    Parameters
    ----------
    rigs
        Rigs.
    objectives
        What is to be small.
    """
    figures = [[rig.predicted[one.title] for one in objectives] for rig in rigs]
    return [
        rig
        for rig, own in zip(rigs, figures, strict=True)
        if not any(other != own and all(a <= b for a, b in zip(other, own, strict=True)) for other in figures)
    ]
