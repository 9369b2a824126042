"""The settings of the built-in methods."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from scenetruth.estimators.protocol import MethodSettings
from scenetruth.validated_model import FrozenModel, NonNegative, Positive

__all__ = [
    "LEAST_ACCELERATED",
    "CorrectionPriors",
    "PhotonTransferNoise",
    "PlaneSweepSettings",
    "RefinedSettings",
    "StructureTensorSettings",
]


Disparity = Annotated[float, Field(ge=-32768, le=32768, allow_inf_nan=False)]


class PlaneSweepSettings(MethodSettings):
    """Which disparities are tried, and when one is believed."""

    disparity_px: tuple[Disparity, Disparity] | Literal["auto"] = "auto"
    """Least and largest disparity in px per step of s; ``auto`` finds the ranges in which there is anything."""
    uniqueness_ratio: Annotated[float, Field(ge=1, le=100)] = 1.3
    """An estimate is given where any other disparity costs this many times as much as the best: less, and texture is
    missing, drowned in noise, or repeats itself."""


LEAST_ACCELERATED = 3
"""Frames that tell an acceleration."""


class CorrectionPriors(FrozenModel):
    """How far images may be from where they should be: standard deviations, as the stage's data sheet has them.

    A position that is off by δX along the stage moves its image by f δX / Z px, a camera turned by an angle by f times
    that. Errors of a position are the same at every visit of the stage.
    """

    x_px: NonNegative = 0.0
    """Of a position's image along x: yaw, and position along the stage."""
    y_px: NonNegative = 0.0
    """Of a position's image along y: pitch, and straightness."""
    roll_urad: NonNegative = 0.0
    """Of a position's rotation about the optical axis."""
    scale_ppm: NonNegative = 0.0
    """Of the scale of a position's image: focal length, and position along the optical axis."""
    repeatability_px: NonNegative = 0.0
    """Along x and along y, of every single image: what is new at each visit of a position."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not any(self.model_dump().values()):
            msg = (
                f"corrects nothing: make at least one of {', '.join(type(self).model_fields)} positive, or leave it out"
            )
            raise ValueError(msg)
        return self

    def in_columns(self, step_px: float) -> CorrectionPriors:
        """Return the same in columns of the images."""
        lengths = {name: getattr(self, name) / step_px for name in ("x_px", "y_px", "repeatability_px")}
        return self.model_copy(update=lengths)


class PhotonTransferNoise(FrozenModel):
    """Noise of a sensor whose photon transfer is known (EMVA 1288): σ² = dark_noise² + gain (g - dark_level)."""

    dark_noise_dn: Positive
    """Standard deviation of dark images, in grey values."""
    gain_dn_per_e: NonNegative
    """Overall system gain K: grey values per electron."""
    dark_level_dn: float = 0.0
    """Mean grey value of dark images."""


class RefinedSettings(MethodSettings):
    """Which surface and motion are fitted in which window."""

    window_sigma_px: Annotated[float, Field(ge=1.0, le=100.0)] = 6.0
    """Standard deviation of the Gaussian window in x and y, in px; it is cut at twice that."""
    window_frames: Annotated[int, Field(ge=1, le=101)] = 9
    """How many frames are fitted together, at most; motion is taken to be steady over them, or steadily accelerated."""
    frames: Literal["full", "all"] = "full"
    """Which frames are estimated: ``full``, those whose window lies inside the recording; ``all``, the first and last
    ones too, with the frames that there are on one side."""
    surface: Literal["auto", "constant", "plane", "curved"] = "auto"
    """What disparity is within a window: constant, linear in x and y (exact for planes), or of second order. ``auto``
    takes the second order where it changes disparity by more than its own noise, else the plane."""
    motion: Literal["auto", "translation", "rigid", "growing", "affine"] = "auto"
    """How velocity changes within a window: not at all; by a rotation; by a rotation and isotropic growth in the
    surface; by any gradient. ``auto`` takes any gradient where that changes disparity or velocity by more than noise,
    else rotation and growth. One camera sees any gradient only."""
    acceleration: Literal["auto"] | bool = "auto"
    """Whether velocity may change evenly over the frames, by the same in a whole window; it takes three frames.
    ``auto`` lets it where that changes disparity or velocity by more than their own noise, over fewer frames where
    these differ again; ``true``, everywhere, and tells the acceleration. Velocity is that of the estimated frame."""
    photometric_model: Literal["per_image", "none"] = "per_image"
    """Whether every image has a gain and an offset of its own in every window: light may change and shadows move."""
    spline: Literal["cubic", "quintic"] = "quintic"
    """Splines through the images, by which they are fetched between pixels; quintic ones err by a tenth as much."""
    noise: PhotonTransferNoise | Literal["uniform", "estimated"] = "uniform"
    """How the noise's variance depends on the grey value: ``uniform``, not at all; the photon transfer of a sensor; or
    ``estimated``, linear in the grey value, as the images' residuals tell. Noisy pixels then count less in the fit."""
    initialisation: Literal["plane_sweep", "structure_tensor"] = "plane_sweep"
    """Where the fit starts: disparities and motions that are tried one by one, which need no luck; or the structure
    tensor's estimate, which takes half the time and holds for smooth scenes that move slowly."""
    discontinuity_refit: bool = True
    """Whether windows that hold more than one surface are fitted anew to the pixels of the surface in their middle."""
    pose_corrections: CorrectionPriors | None = None
    """How far images may be from where they should be; how far they are is then estimated from all points together."""
    fallback: Literal["plane_sweep", "none"] = "plane_sweep"
    """What is told where no fit is: the disparity of the plane sweep that the fit started from, to a fraction of a
    pixel, without motion and standard deviations (``status`` is 3 there); or nothing."""
    max_iterations: Annotated[int, Field(ge=2, le=50)] = 10
    """How often images are warped and the fit is repeated, at most."""
    tolerance_px: Annotated[float, Field(gt=0, le=1)] = 1e-3
    """The rounds end when nine of ten pixels move by less than this in the image where they move most."""
    max_residual_ratio: Annotated[float, Field(gt=1, le=100)] = 1.5
    """Estimates are given where the residual is at most this times the images' noise, or what a texture shifted by a
    quarter of a pixel would leave: beyond, one surface in one motion does not explain the images."""

    @property
    def accelerated(self) -> bool:
        """Whether velocity may change everywhere."""
        return self.acceleration is True

    @property
    def spline_order(self) -> int:
        """Order of the splines."""
        return 3 if self.spline == "cubic" else 5


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
    warning tells; with ``auto``, ``invalid_reason`` states a model violation of slanted faces too."""
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
