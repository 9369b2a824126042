"""The settings of the plane sweep."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenetruth.estimators.protocol import MethodSettings

__all__ = ["PlaneSweepSettings"]

Disparity = Annotated[float, Field(ge=-32768, le=32768, allow_inf_nan=False)]


class PlaneSweepSettings(MethodSettings):
    """Which disparities are tried, and when one is believed."""

    disparity_px: tuple[Disparity, Disparity] | Literal["auto"] = "auto"
    """Least and largest disparity in px per step of s; ``auto`` finds the ranges in which there is anything."""
    distinctness: Annotated[float, Field(ge=1, le=100)] = 1.3
    """An estimate is given where any other disparity costs this many times as much as the best: less, and texture is
    missing, drowned in noise, or repeats itself."""
