"""Settings of the built-in methods."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

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
    """Settings of the plane sweep: disparity range and uniqueness threshold."""

    disparity_px: tuple[Disparity, Disparity] | Literal["auto"] = "auto"
    """Smallest and largest disparity in px per step of s; ``auto`` determines the occupied ranges from the images."""
    uniqueness_ratio: Annotated[float, Field(ge=1, le=100)] = 1.3
    """Smallest valid ratio of the cost of every other disparity to the lowest cost; a smaller ratio indicates missing
    texture, texture below the noise, or repetitive texture."""


LEAST_ACCELERATED = 3
"""Smallest number of frames from which an acceleration can be estimated."""


class CorrectionPriors(FrozenModel):
    """Prior standard deviations of the errors of the camera poses, from the data sheet of the stage.

    A position error δX along the stage shifts the image by f δX / Z px; a camera rotation shifts it by f times the
    angle. Errors of a position are the same at every visit of the stage.
    """

    x_px: NonNegative = 0.0
    """Image shift of a position along x: yaw, and position along the stage."""
    y_px: NonNegative = 0.0
    """Image shift of a position along y: pitch, and straightness."""
    roll_urad: NonNegative = 0.0
    """Rotation of a position about the optical axis."""
    scale_ppm: NonNegative = 0.0
    """Image scale of a position: focal length, and position along the optical axis."""
    repeatability_px: NonNegative = 0.0
    """Image shift along x and along y of each individual image: the part that differs between visits of a position."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not any(self.model_dump().values()):
            msg = f"corrects nothing: set at least one of {', '.join(type(self).model_fields)} above 0, or omit it"
            raise ValueError(msg)
        return self

    def in_columns(self, step_px: float) -> CorrectionPriors:
        """Return the priors in image columns instead of camera pixels."""
        lengths = {name: getattr(self, name) / step_px for name in ("x_px", "y_px", "repeatability_px")}
        return self.model_copy(update=lengths)


class PhotonTransferNoise(FrozenModel):
    """Noise model of a sensor of specified photon transfer (EMVA 1288): σ² = dark_noise² + gain (g - dark_level)."""

    dark_noise_dn: Positive
    """Standard deviation of dark images, in grey values."""
    gain_dn_per_e: NonNegative
    """Overall system gain K: grey values per electron."""
    dark_level_dn: float = 0.0
    """Mean grey value of dark images."""


def _none_as_text(value: Any) -> Any:
    """Return ``none`` for None, the value without corrections in scene files."""
    return "none" if value is None else value


class RefinedSettings(MethodSettings):
    """Settings of the least-squares fit: models of surface and motion, and the analysis window."""

    window_sigma_px: Annotated[float, Field(ge=1.0, le=100.0)] = 6.0
    """Standard deviation of the Gaussian window in x and y, in px; the window is truncated at twice that."""
    window_frames: Annotated[int, Field(ge=1, le=101)] = 9
    """Largest number of frames in a fit; the motion is assumed constant or uniformly accelerated over them."""
    frames: Literal["full", "all"] = "full"
    """Estimated frames: ``full``, those whose window lies inside the recording; ``all``, also the first and last
    frames, with the frames available on one side."""
    surface: Literal["auto", "constant", "plane", "curved"] = "auto"
    """Model of the disparity within a window: constant, linear in x and y (exact for planes), or of second order.
    ``auto`` selects the second order where it changes the disparity by more than its own noise, else the plane."""
    motion: Literal["auto", "translation", "rigid", "growing", "affine"] = "auto"
    """Model of the velocity within a window: constant; with rotation; with rotation and isotropic growth in the
    surface; or with an arbitrary gradient. ``auto`` selects the arbitrary gradient where it changes disparity,
    velocity or growth by more than the noise, else rotation and growth, whose standard deviations then include the bias
    by anisotropy that noise may hide. A single camera allows the arbitrary gradient only."""
    acceleration: Literal["auto"] | bool = "auto"
    """Whether the velocity changes uniformly over the frames, by the same amount in the whole window; requires three
    frames. ``auto`` enables it where it changes disparity or velocity by more than their noise, or uses fewer frames
    where these differ again; ``true`` enables it everywhere and outputs the acceleration. The velocity is that of the
    estimated frame."""
    photometric_model: Literal["per_image", "none"] = "per_image"
    """Whether every image has its own gain and offset in every window, which allows for changes of light and shadow."""
    spline: Literal["cubic", "quintic"] = "quintic"
    """Order of the splines that interpolate the images; the error of quintic splines is a tenth of that of cubic."""
    noise: PhotonTransferNoise | Literal["uniform", "estimated"] = "estimated"
    """Noise variance as a function of the grey value: ``estimated``, linear in the grey value, from the residuals; the
    photon transfer of a sensor; or ``uniform``, constant. Noisier pixels have a smaller weight."""
    initialisation: Literal["plane_sweep", "structure_tensor"] = "plane_sweep"
    """Initial estimate: exhaustive search over disparities and motions, which does not depend on an initial value; or
    the estimate of the structure tensor, which takes half the time and suits smooth, slowly moving scenes."""
    discontinuity_refit: bool = True
    """Whether windows that contain several surfaces are fitted again to the pixels of the central surface only."""
    pose_corrections: Annotated[CorrectionPriors | Literal["auto", "none"], BeforeValidator(_none_as_text)] = "auto"
    """Prior standard deviations of camera-pose errors, which are then estimated from all points together; ``auto``
    takes the stage tolerances of the recording, or, if it states none, adds the effect of pose errors that the images
    show to the standard deviations; ``none`` takes poses as exact."""
    fallback: Literal["fill", "plane_sweep", "none"] = "fill"
    """Fallback disparity and depth where the fit failed (``status`` 3): ``fill``, those of the plane sweep near texture
    and planes of neighbouring surfaces in holes, with standard deviations; ``plane_sweep``, those of the plane sweep
    near texture only, without standard deviations; or none."""
    max_motion_px: Annotated[float, Field(gt=0, le=16, allow_inf_nan=False)] | None = None
    """Largest image motion in px per frame, as a prior. The motion search is limited to it, and of several motions that
    fit the images equally well, as on repetitive textures, only those within it count. Default: none."""
    max_iterations: Annotated[int, Field(ge=2, le=50)] = 10
    """Largest number of iterations: the images are warped, and the fit is repeated."""
    tolerance_px: Annotated[float, Field(gt=0, le=1)] = 1e-3
    """Limit of convergence in px: iterations end when 90 % of the pixels change by less than this, in the image of
    largest change."""
    max_residual_ratio: Annotated[float, Field(gt=1, le=100)] = 1.5
    """Largest valid ratio of the residual to the image noise. The limit is at least the residual that a texture shift
    of 0.25 px would cause; above it, a single surface with a single motion does not explain the images."""

    @property
    def accelerated(self) -> bool:
        """Whether the velocity may change everywhere."""
        return self.acceleration is True

    @property
    def spline_order(self) -> int:
        """Order of the splines."""
        return 3 if self.spline == "cubic" else 5


Sigma = Annotated[float, Field(ge=1e-3, le=1e6, allow_inf_nan=False)]
"""Standard deviation of a window; the limits are a single sample and a flat window."""
Shift = Annotated[int, Field(ge=-32768, le=32768)]
"""Image shift in px, limited to the largest image size."""


class StructureTensorSettings(MethodSettings):
    """Settings of the 4D structure tensor; the defaults of filters and windows are those of the paper (section 4)."""

    window_sigma_px: Sigma = 6.0
    """Standard deviation of the Gaussian window B in x and y, in px."""
    window_taps_px: Annotated[int, Field(ge=3, le=1001)] = 25
    """Length of the Gaussian window in x and y, odd."""
    window_sigma_frames: Sigma = 1.0
    """Standard deviation of the Gaussian window B in t, in frames."""
    window_taps_frames: Annotated[int, Field(ge=1, le=1001)] = 5
    """Length of the Gaussian window in t, odd."""
    tau: NonNegative | Literal["auto"] = 0.0012
    """Threshold τ below which an eigenvalue of the structure tensor counts as zero, for grey values in [-1, 1];
    ``auto`` sets it just above the eigenvalues of the image noise. The default of the paper, 0.0012, makes low-contrast
    textures invalid, with a warning; with ``auto``, slanted faces may be reported as model violations."""
    noise_std: Positive | Literal["auto"] = "auto"
    """Standard deviation σ_n of the image noise, for grey values in [-1, 1], which determines the standard deviations;
    ``auto`` estimates it from the residual of the model around each pixel."""
    divergence: Literal["consistent", "paper"] = "consistent"
    """Discretisation of the divergence term x g_x + y g_y: ``paper`` multiplies the filtered gradients by coordinates;
    ``consistent`` filters the products with the coordinates of each camera, which removes a bias of U_Z."""
    working_point_px: Shift | Literal["auto", "per_pixel"] = "per_pixel"
    """Integer disparity by which the images are registered, px per step of s; ``auto`` estimates one value for the
    image, ``per_pixel`` one for each pixel, both from the images alone."""
    flow_working_point_px: tuple[Shift, Shift] | Literal["auto"] = "auto"
    """Integer flow (x, y) by which the frames are registered, px per frame; ``auto`` estimates from the images whether
    most pixels move by 1 px or more, and selects that flow or zero at each pixel."""
    pyramid_levels: Annotated[int, Field(ge=0, le=8)] = 0
    """Number of image halvings for a coarse estimate; its registration shifts are additional candidates on the finer
    level unless specified. Each level doubles the range of flows."""

    @field_validator("window_taps_px", "window_taps_frames")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = "must be odd, so that the window has a centre"
            raise ValueError(msg)
        return value
