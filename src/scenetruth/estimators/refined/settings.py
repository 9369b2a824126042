"""The settings of the refined estimator."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenetruth.estimators.protocol import MethodSettings

__all__ = ["RefinedSettings"]


class RefinedSettings(MethodSettings):
    """Which surface and motion are fitted in which window."""

    window_sigma_px: Annotated[float, Field(ge=1.0, le=100.0)] = 6.0
    """Standard deviation of the Gaussian window in x and y, in px; it is cut at twice that."""
    window_frames: Annotated[int, Field(ge=1, le=101)] = 9
    """How many frames are fitted together, at most; motion is taken to be steady over them."""
    frames: Literal["full", "all"] = "full"
    """Which frames are estimated: ``full``, those whose window lies inside the recording; ``all``, the first and last
    ones too, with the frames that there are on one side."""
    surface: Literal["auto", "constant", "plane", "curved"] = "auto"
    """What disparity is within a window: constant, linear in x and y (exact for planes), or of second order. ``auto``
    takes the second order where it changes disparity by more than its own noise, else the plane."""
    motion: Literal["translation", "rigid", "growing", "affine"] = "growing"
    """How velocity changes within a window: not at all; by a rotation; by a rotation and isotropic growth in the
    surface; by any gradient. One camera sees the last only."""
    brightness: Literal["per_image", "none"] = "per_image"
    """Whether every image has a gain and an offset of its own in every window: light may change and shadows move."""
    start: Literal["plane_sweep", "structure_tensor"] = "plane_sweep"
    """Where the fit starts: disparities and motions that are tried one by one, which need no luck; or the structure
    tensor's estimate, which takes half the time and holds for smooth scenes that move slowly."""
    outlines: bool = True
    """Whether windows that hold more than one surface are fitted anew to the pixels of the surface in their middle."""
    rounds: Annotated[int, Field(ge=2, le=50)] = 10
    """How often images are warped and the fit is repeated, at most."""
    tolerance_px: Annotated[float, Field(gt=0, le=1)] = 1e-3
    """The rounds end when nine of ten pixels move by less than this in the image where they move most."""
    acceptance: Annotated[float, Field(gt=1, le=100)] = 1.5
    """Estimates are given where the residual is at most this times the images' noise, or what a texture shifted by a
    quarter of a pixel would leave: beyond, one surface in one motion does not explain the images."""
