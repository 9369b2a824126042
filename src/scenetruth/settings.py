"""The settings of the estimators, shared by scene files and by calls of ``estimate``."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenetruth.model import FrozenModel, NonNegative, Positive

__all__ = ["EstimateSettings", "ScoreSettings"]

Bounds = Annotated[tuple[NonNegative, ...], Field(min_length=1)]
"""Bounds between classes of pixels."""


class EstimateSettings(FrozenModel):
    """How the 4D structure tensor is set up; filters and windows are the paper's (section 4) if not given."""

    window_sigma_px: Positive = 6.0
    """Standard deviation of the Gaussian window B in x and y, in px."""
    window_taps_px: Annotated[int, Field(ge=3)] = 25
    """Length of that window in x and y, odd."""
    window_sigma_frames: Positive = 1.0
    """Standard deviation of the Gaussian window B in t, in frames."""
    window_taps_frames: Annotated[int, Field(ge=1)] = 5
    """Length of that window in t, odd."""
    tau: NonNegative | Literal["auto"] = "auto"
    """Threshold τ below which an eigenvalue of the structure tensor counts as zero, for grey values in [-1, 1];
    ``auto`` puts it just above what the images' noise makes. The paper's is 0.0012, for strong textures."""
    noise_std: Positive | Literal["auto"] = "auto"
    """Standard deviation σ_n of the images' noise, for grey values in [-1, 1], from which error bars follow; ``auto``
    takes it from what the model leaves unexplained around each pixel."""
    divergence: Literal["consistent", "paper"] = "consistent"
    """How the divergence term x g_x + y g_y is made: ``paper`` multiplies filtered gradients by coordinates,
    ``consistent`` filters the products with each camera's own coordinates, which takes a bias from U_Z."""
    working_point_px: int | Literal["auto", "per_pixel"] = "per_pixel"
    """Integer disparity by which images are registered, px per step of s; ``auto`` finds the one that suits most of the
    image, ``per_pixel`` the one that suits each pixel, both from the images alone."""
    flow_working_point_px: tuple[int, int] | Literal["auto"] = "auto"
    """Integer flow (x, y) by which frames are registered, px per frame; ``auto`` finds from the images whether most of
    them moves by a pixel or more, and lets each pixel choose between that and rest."""
    pyramid_levels: Annotated[int, Field(ge=0, le=8)] = 0
    """How often to halve the images for a coarse estimate, from which the finer one takes the working points of every
    pixel that are not given; doubles the range of flows each time."""

    @field_validator("window_taps_px", "window_taps_frames")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = "must be odd, so that the window has a centre"
            raise ValueError(msg)
        return value


class ScoreSettings(FrozenModel):
    """How an estimate is scored."""

    interior_margin_px: NonNegative = 20.0
    """Least distance of the region ``interior`` from silhouettes and from sharp edges, in px."""
    slope_classes_deg: Bounds = (0.0, 20.0, 45.0, 70.0, 90.0)
    """Bounds of the regions ``slope_LOW_HIGH``: angles between surface normal and optical axis, in degrees."""
    edge_classes_px: Bounds = (0.0, 5.0, 10.0, 20.0)
    """Bounds of the regions ``edge_LOW_HIGH``: distances to the nearest mixed pixel, in px. One more class,
    ``edge_LOW_inf``, begins at the last."""
    contrast_window_px: Positive = 6.0
    """Standard deviation of the Gaussian window in which texture contrast is measured, in px."""
    contrast_classes: tuple[Positive, Positive] = (0.02, 0.05)
    """Bounds between ``contrast_low``, ``contrast_mid`` and ``contrast_high``: local standard deviation of the
    reference image, as a fraction of full scale."""
    growth_window_px: Positive = 20.0
    """Standard deviation of the Gaussian window in which the growth rate is fitted, in px."""
    growth_min_coverage: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Least share of that window's weight that must lie on known pixels of the same surface."""
    growth_max_slope_deg: Annotated[float, Field(gt=0, lt=90)] = 80.0
    """Neighbouring pixels whose depths differ as on a surface steeper than this are on two surfaces, in degrees."""

    @field_validator("slope_classes_deg", "edge_classes_px")
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
