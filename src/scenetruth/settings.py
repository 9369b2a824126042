"""The settings of scores and of storage, shared by scene files and calls from Python."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenetruth.validated_model import FrozenModel, NonNegative, Positive

__all__ = ["ScoreSettings", "StorageSettings"]

Bounds = Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=50)]
"""Bounds between classes of pixels; each class is a region of the score."""
Window = Annotated[float, Field(ge=0.1, le=1000, allow_inf_nan=False)]
"""Standard deviation of a Gaussian window: its sums take time in proportion, and below, it has one pixel only."""


class StorageSettings(FrozenModel):
    """How results are stored."""

    form: Literal["folder", "zip"] = "folder"
    """Stores as folders, one file for each variable, or as one zip file each, for file systems that do not like many
    files."""
    truth: Literal["float64", "float32"] = "float64"
    """Type of the maps of the truth. ``float32`` halves the store; depth is then known to 6e-8 of itself."""


class ScoreSettings(FrozenModel):
    """How an estimate is scored."""

    interior_margin_px: NonNegative = 20.0
    """Least distance of the region ``interior`` from silhouettes and from sharp edges, in px."""
    slope_classes_deg: Bounds = (0.0, 20.0, 45.0, 70.0, 90.0)
    """Bounds of the regions ``slope_LOW_HIGH``: angles between surface normal and optical axis, in degrees."""
    boundary_classes_px: Bounds = (0.0, 5.0, 10.0, 20.0)
    """Bounds of the regions ``boundary_LOW_HIGH``: distances to the nearest mixed pixel, in px. One more class,
    ``boundary_LOW_inf``, begins at the last."""
    contrast_window_px: Window = 6.0
    """Standard deviation of the Gaussian window in which texture contrast is measured, in px."""
    contrast_classes: tuple[Positive, Positive] = (0.02, 0.05)
    """Bounds between ``contrast_low``, ``contrast_mid`` and ``contrast_high``: local standard deviation of the
    reference image, as a fraction of full scale."""
    growth_window_px: Window = 20.0
    """Standard deviation of the Gaussian window in which the growth rate is fitted, in px."""
    growth_min_coverage: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Least share of that window's weight that must lie on known pixels of the same surface."""
    growth_max_slope_deg: Annotated[float, Field(gt=0, lt=90)] = 80.0
    """Neighbouring pixels whose depths differ as on a surface steeper than this are on two surfaces, in degrees."""

    @field_validator("slope_classes_deg", "boundary_classes_px")
    @classmethod
    def _rising(cls, value: Bounds) -> Bounds:
        if any(high <= low for low, high in pairwise(value)):
            msg = "must rise from bound to bound"
            raise ValueError(msg)
        return value

    @field_validator("slope_classes_deg")
    @classmethod
    def _angles(cls, value: Bounds) -> Bounds:
        if len(value) < 2 or value[-1] > 90:
            msg = "must be two bounds or more between 0 and 90 degrees"
            raise ValueError(msg)
        return value

    @field_validator("contrast_classes")
    @classmethod
    def _two_rising(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[1] <= value[0]:
            msg = "must rise from bound to bound"
            raise ValueError(msg)
        return value
