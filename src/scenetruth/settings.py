"""Settings of scoring and storage, shared by scene files and Python calls."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenetruth.validated_model import FrozenModel, NonNegative, Positive

__all__ = ["ScoreSettings", "StorageSettings"]

Bounds = Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=50)]
"""Limits between classes of pixels; each class is a region of the score."""
Window = Annotated[float, Field(ge=0.1, le=1000, allow_inf_nan=False)]
"""Standard deviation of a Gaussian window: computation time is proportional; smaller windows contain one pixel."""


class StorageSettings(FrozenModel):
    """Storage of results."""

    form: Literal["folder", "zip"] = "folder"
    """Stores as directories, one file per variable, or as one zip file each, for file systems with a limited number of
    files."""
    truth: Literal["float64", "float32"] = "float64"
    """Type of the maps of the truth. ``float32`` halves the store, with a relative precision of depth of 6e-8."""


class ScoreSettings(FrozenModel):
    """Settings of the scoring of an estimate."""

    interior_margin_px: NonNegative = 20.0
    """Minimum distance of the region ``interior`` from silhouettes and creases, px."""
    include_fallback: bool = False
    """Whether fallback values (``status`` 3) of disparity and depth count as valid in statistics and figures."""
    slope_classes_deg: Bounds = (0.0, 20.0, 45.0, 70.0, 90.0)
    """Limits of the regions ``slope_LOW_HIGH``: angle between surface normal and optical axis, degrees."""
    boundary_classes_px: Bounds = (0.0, 5.0, 10.0, 20.0)
    """Limits of the regions ``boundary_LOW_HIGH``: distance to the nearest mixed pixel, px. The last class,
    ``boundary_LOW_inf``, has no upper limit."""
    specular_share: Annotated[float, Field(gt=0, le=1)] = 0.1
    """Minimum share of specular light in the radiance of the region ``specular``."""
    shadow_width_px: NonNegative = 6.0
    """Maximum distance of the region ``shadow_boundary`` from a border of a shadow, px."""
    contrast_window_px: Window = 6.0
    """Standard deviation of the Gaussian window for texture contrast, px."""
    contrast_classes: tuple[Positive, Positive] = (0.02, 0.05)
    """Limits between ``contrast_low``, ``contrast_mid`` and ``contrast_high``: local standard deviation of the
    reference image, as a fraction of full scale."""
    growth_window_px: Window = 20.0
    """Standard deviation of the Gaussian window for the growth rate, px."""
    growth_min_coverage: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Minimum weight fraction of that window on valid pixels of the same surface."""
    growth_max_slope_deg: Annotated[float, Field(gt=0, lt=90)] = 80.0
    """Maximum slope of a continuous surface, degrees; larger depth steps separate two surfaces."""

    @field_validator("slope_classes_deg", "boundary_classes_px")
    @classmethod
    def _rising(cls, value: Bounds) -> Bounds:
        if any(high <= low for low, high in pairwise(value)):
            msg = "must be in ascending order"
            raise ValueError(msg)
        return value

    @field_validator("slope_classes_deg")
    @classmethod
    def _angles(cls, value: Bounds) -> Bounds:
        if len(value) < 2 or value[-1] > 90:
            msg = "must be two or more limits between 0 and 90 degrees"
            raise ValueError(msg)
        return value

    @field_validator("contrast_classes")
    @classmethod
    def _two_rising(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[1] <= value[0]:
            msg = "must be in ascending order"
            raise ValueError(msg)
        return value
