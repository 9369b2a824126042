"""The base of every validated model of a scene file: frozen, and closed to unknown keys."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

__all__ = ["Direction", "Finite", "FrozenModel", "NonNegative", "Positive", "Vector3"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]


def _nonzero(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if value == (0, 0, 0):
        msg = "must not be the zero vector"
        raise ValueError(msg)
    return value


Direction = Annotated[Vector3, AfterValidator(_nonzero)]
"""A vector of any length but zero."""


class FrozenModel(BaseModel):
    """A pydantic model whose instances cannot change and whose keys are all known."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)
