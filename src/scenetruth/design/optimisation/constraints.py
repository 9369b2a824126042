"""Constraints on a rig, a class each: imaging geometry, acquisition, hardware."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from scenetruth.design.optimisation.design_records import ConstraintValue
from scenetruth.design.optimisation.rig_context import RigContext, compute_stage_shifts_px
from scenetruth.validated_model import Finite, FrozenModel, Positive

__all__ = [
    "ConstraintSpec",
    "DataRateConstraint",
    "DefocusBlurConstraint",
    "DepthOfFieldConstraint",
    "DisparityConstraint",
    "ExposureConstraint",
    "FieldOfViewConstraint",
    "FlowConstraint",
    "FrameIntervalConstraint",
    "GreyLevelConstraint",
    "ImagesConstraint",
    "MotionBlurConstraint",
    "PriceConstraint",
    "RecordingTimeConstraint",
    "StageErrorConstraint",
    "StageTravelConstraint",
    "StereoAngleConstraint",
    "TextureWavelengthConstraint",
    "TimePerCaptureConstraint",
    "TotalDisparityConstraint",
    "WorkingDistanceConstraint",
    "evaluate_bound",
]


_FAR = -10.0
"""Margin where there is no number at all."""


class ConstraintSpec(FrozenModel):
    """Bounds of what a rig has; derive from it in a module of its own, with a ``kind``, and write `value`."""

    unit: ClassVar[str]
    """Unit of the number."""

    min: Finite | None = None
    """It must not be less."""
    max: Finite | None = None
    """It must not be more."""

    @model_validator(mode="after")
    def _some_bound(self) -> Self:
        if self.min is None and self.max is None:
            msg = "bounds nothing: give min, max, or both"
            raise ValueError(msg)
        if self.min is not None and self.max is not None and self.min > self.max:
            msg = f"can never hold: min = {self.min:g} is more than max = {self.max:g}"
            raise ValueError(msg)
        return self

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        raise NotImplementedError

    def value(self, facts: RigContext) -> float:
        """Return what a rig has, in `unit`."""
        raise NotImplementedError

    def checked(self, facts: RigContext) -> Iterator[ConstraintValue]:
        """Give the bounds at a rig, each with what is left."""
        kind, value = str(getattr(self, "kind", "")), float(self.value(facts))
        for sense, limit in (("at least", self.min), ("at most", self.max)):
            if limit is not None:
                yield evaluate_bound(kind, self.title, value, sense, limit, self.unit)


def evaluate_bound(kind: str, title: str, value: float, sense: str, limit: float, unit: str) -> ConstraintValue:
    """Return a bound at a rig."""
    left = limit - value if sense == "at most" else value - limit
    margin = left / (abs(limit) or 1.0) if math.isfinite(left) else (_FAR if not left > 0 else -_FAR)
    # What differs by rounding alone is the same.
    holds = margin >= -1e-9
    return ConstraintValue(kind, title, value, limit, unit, holds, margin, sense)


class DefocusBlurConstraint(ConstraintSpec):
    """Largest diameter of the blur disc over some depths: f A |1/Z - 1/Z_f|."""

    unit: ClassVar[str] = "px"

    kind: Literal["defocus_blur"] = "defocus_blur"

    depths_mm: tuple[Positive, Positive] | None = None
    """Nearest and farthest depth; the median depth of the first objective's region if not given."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "blur out of focus"

    def value(self, facts: RigContext) -> float:
        """Return the largest diameter."""
        defocus = facts.scene.optics.defocus
        if defocus is None:
            return 0.0
        depths = np.array(self.depths_mm or (facts.depth_mm,), dtype=np.float64)
        return float(defocus.blur_diameter_px(depths, facts.scene.camera.focal_px).max())


class DepthOfFieldConstraint(ConstraintSpec):
    """Depths whose blur disc is smaller than some pixels: f A |1/Z - 1/Z_f| < blur_px."""

    unit: ClassVar[str] = "mm"

    kind: Literal["depth_of_field"] = "depth_of_field"

    blur_px: Positive = 1.0
    """Diameter of the blur disc that is sharp enough."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return f"depth of field, discs under {self.blur_px:g} px"

    def value(self, facts: RigContext) -> float:
        """Return the distance of the two depths; infinite if everything is sharp."""
        defocus = facts.scene.optics.defocus
        if defocus is None:
            return math.inf
        reach = self.blur_px / (facts.scene.camera.focal_px * defocus.aperture_mm)
        middle = 1 / defocus.focus_distance_mm
        return math.inf if reach >= middle else 1 / (middle - reach) - 1 / (middle + reach)


class DisparityConstraint(ConstraintSpec):
    """Disparity of a step at the median depth of the first objective's region: f B / Z."""

    unit: ClassVar[str] = "px"

    kind: Literal["disparity"] = "disparity"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "disparity per step"

    def value(self, facts: RigContext) -> float:
        """Return the disparity, without its sign."""
        return abs(facts.causes.disparity_px)


class FieldOfViewConstraint(ConstraintSpec):
    """Width, or height, of what images show at the median depth of the first objective's region: W Z / f."""

    unit: ClassVar[str] = "mm"

    kind: Literal["field_of_view"] = "field_of_view"

    axis: Literal["x", "y"] = "x"
    """Along the image's width, or its height."""
    seen_by: Literal["reference", "all"] = "reference"
    """Seen by the reference camera, or from all positions of the stage."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return f"field of view along {self.axis}" + (", seen from all positions" if self.seen_by == "all" else "")

    def value(self, facts: RigContext) -> float:
        """Return the width or height, less the stage's travel if all positions must see it."""
        camera = facts.scene.camera
        pixels = camera.width if self.axis == "x" else camera.height
        whole = pixels * facts.depth_mm / camera.focal_px
        return whole - facts.travel_mm if self.seen_by == "all" and self.axis == "x" else whole


class StereoAngleConstraint(ConstraintSpec):
    """Angle between the rays from the outermost positions at the median depth of the first objective's region."""

    unit: ClassVar[str] = "°"

    kind: Literal["stereo_angle"] = "stereo_angle"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "angle between the outermost views"

    def value(self, facts: RigContext) -> float:
        """Return the angle."""
        return math.degrees(2 * math.atan2(facts.travel_mm / 2, facts.depth_mm))


class TextureWavelengthConstraint(ConstraintSpec):
    """Rms mean wavelength of the texture in the images; dots have about half of it."""

    unit: ClassVar[str] = "px"

    kind: Literal["texture_wavelength"] = "texture_wavelength"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "wavelength of the texture in the image"

    def value(self, facts: RigContext) -> float:
        """Return the wavelength."""
        return facts.causes.wavelength_px


class TotalDisparityConstraint(ConstraintSpec):
    """Disparity between the outermost positions, as a share of the image's width; beyond 1, none sees the other's."""

    unit: ClassVar[str] = "1"

    kind: Literal["total_disparity"] = "total_disparity"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "disparity between the outermost positions over the image's width"

    def value(self, facts: RigContext) -> float:
        """Return the share."""
        camera = facts.scene.camera
        return camera.focal_px * facts.travel_mm / facts.depth_mm / camera.width


_HALF_WIDTH = 2.3548
"""Width at half maximum of a Gaussian, in standard deviations."""

__all__ = ["WindowConstraint"]


class WindowConstraint(ConstraintSpec):
    """Width at half maximum of the estimator's window on the surface, 2.355 σ Z / f; smaller details are lost."""

    unit: ClassVar[str] = "mm"

    kind: Literal["window"] = "window"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "window on the surface"

    def value(self, facts: RigContext) -> float:
        """Return the width."""
        return _HALF_WIDTH * facts.causes.window_sigma_px * facts.depth_mm / facts.scene.camera.focal_px


class WorkingDistanceConstraint(ConstraintSpec):
    """Median depth of the first objective's region."""

    unit: ClassVar[str] = "mm"

    kind: Literal["working_distance"] = "working_distance"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "working distance"

    def value(self, facts: RigContext) -> float:
        """Return the median depth."""
        return facts.depth_mm


class DataRateConstraint(ConstraintSpec):
    """Bytes of all images of a frame over the time from frame to frame, 1e6 bytes a megabyte."""

    unit: ClassVar[str] = "MB/s"

    kind: Literal["data_rate"] = "data_rate"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "data rate"

    def value(self, facts: RigContext) -> float:
        """Return the rate."""
        camera, bits = facts.scene.camera, getattr(facts.scene.sensor, "bit_depth", None) or 16
        size = camera.width * camera.height * math.ceil(bits / 8)
        return facts.images_per_frame * size / facts.scene.frames.frame_interval_s / 1e6


class ExposureConstraint(ConstraintSpec):
    """Exposure time of the shutter; of the sensor if the shutter has none."""

    unit: ClassVar[str] = "s"

    kind: Literal["exposure"] = "exposure"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "exposure time"

    def value(self, facts: RigContext) -> float:
        """Return the time."""
        return facts.scene.shutter.exposure_time_s or float(getattr(facts.scene.sensor, "exposure_time_s", 0.0))


class FlowConstraint(ConstraintSpec):
    """Optical flow, median length over the first objective's region."""

    unit: ClassVar[str] = "px/frame"

    kind: Literal["flow"] = "flow"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "motion in the image from frame to frame"

    def value(self, facts: RigContext) -> float:
        """Return the length."""
        return facts.causes.flow_px


class FrameIntervalConstraint(ConstraintSpec):
    """Time from frame to frame."""

    unit: ClassVar[str] = "s"

    kind: Literal["frame_interval"] = "frame_interval"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "time from frame to frame"

    def value(self, facts: RigContext) -> float:
        """Return the time."""
        return facts.scene.frames.frame_interval_s


class GreyLevelConstraint(ConstraintSpec):
    """Brightest grey values of the texture, as a share of full scale: over 1 is saturated.

    The mean and three standard deviations, and no more than white has; medians over the first objective's region.
    """

    unit: ClassVar[str] = "1"

    kind: Literal["grey_level"] = "grey_level"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "brightest grey values, share of full scale"

    def value(self, facts: RigContext) -> float:
        """Return the share."""
        return facts.causes.brightest_level


class ImagesConstraint(ConstraintSpec):
    """Images of all positions and frames."""

    unit: ClassVar[str] = "images"

    kind: Literal["images"] = "images"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "images"

    def value(self, facts: RigContext) -> float:
        """Return the number."""
        return float(facts.images_per_frame * facts.scene.frames.count)


class MotionBlurConstraint(ConstraintSpec):
    """Motion in the image during the exposure, of object and stage.

    Of the points of the first objective's region that move at all, 95 % move less.
    """

    unit: ClassVar[str] = "px"

    kind: Literal["motion_blur"] = "motion_blur"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "motion blur"

    def value(self, facts: RigContext) -> float:
        """Return the length."""
        return facts.causes.blur_px


class RecordingTimeConstraint(ConstraintSpec):
    """Time from the first frame to the last; of the frames that are estimated together, if wanted."""

    unit: ClassVar[str] = "s"

    kind: Literal["recording_time"] = "recording_time"

    of: Literal["recording", "window"] = "recording"
    """Of all frames, or of those that are estimated together."""

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "time from the first frame to the last" + (" of a window" if self.of == "window" else "")

    def value(self, facts: RigContext) -> float:
        """Return the time."""
        frames = facts.causes.frames if self.of == "window" else facts.scene.frames.count
        return (frames - 1) * facts.scene.frames.frame_interval_s


class TimePerCaptureConstraint(ConstraintSpec):
    """Time from the first image of a frame to the end of the last: positions times travel, settling and exposure."""

    unit: ClassVar[str] = "s"

    kind: Literal["time_per_capture"] = "time_per_capture"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "time per capture"

    def value(self, facts: RigContext) -> float:
        """Return the time."""
        each = max(facts.scene.stage.time_per_position_s, facts.scene.shutter.exposure_time_s)
        return facts.images_per_frame * each


class PriceConstraint(ConstraintSpec):
    """Sum of the prices of what is from catalogues, in euros; entries without a price are not allowed."""

    unit: ClassVar[str] = "EUR"

    kind: Literal["price"] = "price"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "price"

    def value(self, facts: RigContext) -> float:
        """Return the sum; NaN if a price is not known."""
        return math.nan if facts.price is None else facts.price


class StageErrorConstraint(ConstraintSpec):
    """Shift of an image along x by the errors of its position, one standard deviation: yaw f psi, position f dX / Z."""

    unit: ClassVar[str] = "px"

    kind: Literal["stage_error"] = "stage_error"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "shift of images by stage errors"

    def value(self, facts: RigContext) -> float:
        """Return the shift."""
        return compute_stage_shifts_px(facts.scene, facts.depth_mm).along


class StageTravelConstraint(ConstraintSpec):
    """Distance of the outermost positions."""

    unit: ClassVar[str] = "mm"

    kind: Literal["stage_travel"] = "stage_travel"

    @property
    def title(self) -> str:
        """What is bounded, in words."""
        return "stage travel"

    def value(self, facts: RigContext) -> float:
        """Return the distance."""
        return facts.travel_mm
