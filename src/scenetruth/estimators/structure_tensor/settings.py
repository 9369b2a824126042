"""The settings of the structure tensor."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenetruth.estimators.protocol import MethodSettings
from scenetruth.model import NonNegative, Positive

__all__ = ["StructureTensorSettings"]

Sigma = Annotated[float, Field(ge=1e-3, le=1e6, allow_inf_nan=False)]
"""Standard deviation of a window: below, all weight is in its centre, above, it is flat."""
Shift = Annotated[int, Field(ge=-32768, le=32768)]
"""Shift of images in px, not larger than images can be."""


class StructureTensorSettings(MethodSettings):
    """How the 4D structure tensor is set up; filters and windows are the paper's (section 4) if not given."""

    window_sigma_px: Sigma = 6.0
    """Standard deviation of the Gaussian window B in x and y, in px."""
    window_taps_px: Annotated[int, Field(ge=3, le=1001)] = 25
    """Length of that window in x and y, odd."""
    window_sigma_frames: Sigma = 1.0
    """Standard deviation of the Gaussian window B in t, in frames."""
    window_taps_frames: Annotated[int, Field(ge=1, le=1001)] = 5
    """Length of that window in t, odd."""
    tau: NonNegative | Literal["auto"] = 0.0012
    """Threshold τ below which an eigenvalue of the structure tensor counts as zero, for grey values in [-1, 1];
    ``auto`` puts it just above what the images' noise makes. The paper's, 0.0012, leaves out dim textures, of which a
    warning tells; with ``auto``, ``model_violation`` marks slanted faces too."""
    noise_std: Positive | Literal["auto"] = "auto"
    """Standard deviation σ_n of the images' noise, for grey values in [-1, 1], from which error bars follow; ``auto``
    takes it from what the model leaves unexplained around each pixel."""
    divergence: Literal["consistent", "paper"] = "consistent"
    """How the divergence term x g_x + y g_y is made: ``paper`` multiplies filtered gradients by coordinates,
    ``consistent`` filters the products with each camera's own coordinates, which takes a bias from U_Z."""
    working_point_px: Shift | Literal["auto", "per_pixel"] = "per_pixel"
    """Integer disparity by which images are registered, px per step of s; ``auto`` finds the one that suits most of the
    image, ``per_pixel`` the one that suits each pixel, both from the images alone."""
    flow_working_point_px: tuple[Shift, Shift] | Literal["auto"] = "auto"
    """Integer flow (x, y) by which frames are registered, px per frame; ``auto`` finds from the images whether most of
    them moves by a pixel or more, and lets each pixel choose between that and rest."""
    pyramid_levels: Annotated[int, Field(ge=0, le=8)] = 0
    """How often to halve the images for a coarse estimate, whose working points the finer one tries beside its own,
    where they are not given; doubles the range of flows each time."""

    @field_validator("window_taps_px", "window_taps_frames")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = "must be odd, so that the window has a centre"
            raise ValueError(msg)
        return value
