"""Further effects that are put into the chain of a sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from scenetruth.camera.sensor.base import Effect
from scenetruth.camera.sensor.chain import AnyEffect, SensorChain
from scenetruth.model import FrozenModel

__all__ = ["Insertion", "inserted", "misplaced"]


class Insertion(FrozenModel):
    """A further effect, and its place in the chain."""

    after: str
    """Name of the effect that it comes behind; its kind if it has no name."""
    effect: AnyEffect
    """The effect."""


def inserted(effects: Sequence[Effect], insertions: Sequence[Insertion]) -> tuple[Effect, ...]:
    """Put further effects into a chain, one after the other.

    Parameters
    ----------
    effects
        The chain.
    insertions
        The further effects; one may come behind another.

    Returns
    -------
    tuple of Effect
        The longer chain.

    Raises
    ------
    ValueError
        If the chain has no effect of the name that one should come behind.
    """
    chain = list(effects)
    for insertion in insertions:
        keys = [effect.key for effect in chain]
        if insertion.after not in keys:
            msg = f"there is no effect '{insertion.after}' to come behind; there are {', '.join(keys)}"
            raise ValueError(msg)
        chain.insert(keys.index(insertion.after) + 1, insertion.effect)
    return tuple(chain)


def misplaced(effects: Sequence[Effect], insertions: Sequence[Insertion], field: str) -> list[InitErrorDetails]:
    """Return all problems of insertions, each with its path.

    Parameters
    ----------
    effects
        The chain.
    insertions
        The further effects.
    field
        Name of the field that holds them.

    Returns
    -------
    list of pydantic_core.InitErrorDetails
        One for each insertion that does not fit; empty if all do.
    """
    fitting: list[Insertion] = []
    problems = []
    for index, insertion in enumerate(insertions):
        try:
            SensorChain(effects=inserted(effects, [*fitting, insertion]))
        except ValidationError as error:
            # What follows an effect that does not fit may not fit either: the first problem is the cause.
            cause = error.errors()[0]["msg"]
            problems.append(_problem((field, index, "effect"), cause, insertion.effect.kind))
        except ValueError as error:
            problems.append(_problem((field, index, "after"), str(error), insertion.after))
        else:
            fitting.append(insertion)
    return problems


def _problem(place: tuple[str | int, ...], message: str, given: Any) -> InitErrorDetails:
    return InitErrorDetails(
        type=PydanticCustomError("sensor_insertion", "{message}", {"message": message}), loc=place, input=given
    )
