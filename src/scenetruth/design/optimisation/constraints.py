"""Constraints on a rig: imaging geometry, acquisition and hardware."""

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
    "ConstraintSpec", "DataRateConstraint", "DefocusBlurConstraint", "DepthOfFieldConstraint", "DisparityConstraint",
    "ExposureConstraint", "FieldOfViewConstraint", "FlowConstraint", "FrameIntervalConstraint", "GreyLevelConstraint",
    "ImagesConstraint", "MotionBlurConstraint", "PriceConstraint", "RecordingTimeConstraint", "StageErrorConstraint",
    "StageTravelConstraint", "StereoAngleConstraint", "TextureWavelengthConstraint", "TimePerCaptureConstraint",
    "TotalDisparityConstraint", "WindowConstraint", "WorkingDistanceConstraint",
    "evaluate_bound",
]  # fmt: skip


_FAR = -10.0  # margin of an undefined value


class ConstraintSpec(FrozenModel):
    """Bounds on a property of a rig; a derived class has a ``kind``, a `title` and a `value`."""

    unit: ClassVar[str]
    """Unit of the value."""

    min: Finite | None = None
    """Lower bound."""
    max: Finite | None = None
    """Upper bound."""

    @model_validator(mode="after")
    def _some_bound(self) -> Self:
        if self.min is None and self.max is None:
            msg = "has no bound; specify min, max or both"
            raise ValueError(msg)
        if self.min is not None and self.max is not None and self.min > self.max:
            msg = f"cannot be satisfied: min = {self.min:g} is above max = {self.max:g}"
            raise ValueError(msg)
        return self

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        raise NotImplementedError

    def value(self, facts: RigContext) -> float:
        """Return the property of a rig, in `unit`."""
        raise NotImplementedError

    def checked(self, facts: RigContext) -> Iterator[ConstraintValue]:
        """Yield the evaluated bounds of a rig."""
        kind, value = str(getattr(self, "kind", "")), float(self.value(facts))
        for sense, limit in (("at least", self.min), ("at most", self.max)):
            if limit is not None:
                yield evaluate_bound(kind, self.title, value, sense, limit, self.unit)


def evaluate_bound(kind: str, title: str, value: float, sense: str, limit: float, unit: str) -> ConstraintValue:
    """Return an evaluated bound with its margin."""
    left = limit - value if sense == "at most" else value - limit
    margin = left / (abs(limit) or 1.0) if math.isfinite(left) else (_FAR if not left > 0 else -_FAR)
    holds = margin >= -1e-9  # tolerance for rounding errors
    return ConstraintValue(kind, title, value, limit, unit, holds, margin, sense)


class DefocusBlurConstraint(ConstraintSpec):
    """Largest diameter of the blur disc in a depth range: f A |1/Z - 1/Z_f|."""

    unit: ClassVar[str] = "px"

    kind: Literal["defocus_blur"] = "defocus_blur"

    depths_mm: tuple[Positive, Positive] | None = None
    """Nearest and farthest depth; default: the median depth of the first objective's region."""

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "defocus blur"

    def value(self, facts: RigContext) -> float:
        """Return the largest diameter of the blur disc."""
        defocus = facts.scene.optics.defocus
        if defocus is None:
            return 0.0
        depths = np.array(self.depths_mm or (facts.depth_mm,), dtype=np.float64)
        return float(defocus.blur_diameter_px(depths, facts.scene.camera.focal_px).max())


class DepthOfFieldConstraint(ConstraintSpec):
    """Depth range with a blur disc below a limit: f A |1/Z - 1/Z_f| < blur_px."""

    unit: ClassVar[str] = "mm"

    kind: Literal["depth_of_field"] = "depth_of_field"

    blur_px: Positive = 1.0
    """Largest acceptable diameter of the blur disc."""

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return f"depth of field, blur disc under {self.blur_px:g} px"

    def value(self, facts: RigContext) -> float:
        """Return the length of the depth range; infinite without an upper end or defocus."""
        defocus = facts.scene.optics.defocus
        if defocus is None:
            return math.inf
        reach = self.blur_px / (facts.scene.camera.focal_px * defocus.aperture_mm)
        middle = 1 / defocus.focus_distance_mm
        return math.inf if reach >= middle else 1 / (middle - reach) - 1 / (middle + reach)


class DisparityConstraint(ConstraintSpec):
    """Disparity per step at the median depth of the first objective's region: f B / Z."""

    unit: ClassVar[str] = "px"

    kind: Literal["disparity"] = "disparity"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "disparity per step"

    def value(self, facts: RigContext) -> float:
        """Return the absolute value of the disparity."""
        return abs(facts.causes.disparity_px)


class FieldOfViewConstraint(ConstraintSpec):
    """Field of view at the median depth of the first objective's region: W Z / f."""

    unit: ClassVar[str] = "mm"

    kind: Literal["field_of_view"] = "field_of_view"

    axis: Literal["x", "y"] = "x"
    """Image axis: width or height."""
    seen_by: Literal["reference", "all"] = "reference"
    """Field of view of the reference camera, or the one common to all stage positions."""

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return f"field of view along {self.axis}" + (", common to all positions" if self.seen_by == "all" else "")

    def value(self, facts: RigContext) -> float:
        """Return the width or height; the width common to all positions is smaller by the stage travel."""
        camera = facts.scene.camera
        pixels = camera.width if self.axis == "x" else camera.height
        whole = pixels * facts.depth_mm / camera.focal_px
        return whole - facts.travel_mm if self.seen_by == "all" and self.axis == "x" else whole


class StereoAngleConstraint(ConstraintSpec):
    """Stereo angle of the outermost positions at the median depth of the first objective's region."""

    unit: ClassVar[str] = "°"

    kind: Literal["stereo_angle"] = "stereo_angle"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "stereo angle of the outermost positions"

    def value(self, facts: RigContext) -> float:
        """Return the angle."""
        return math.degrees(2 * math.atan2(facts.travel_mm / 2, facts.depth_mm))


class TextureWavelengthConstraint(ConstraintSpec):
    """RMS mean wavelength of the texture in the images; the size of speckles is about half of it."""

    unit: ClassVar[str] = "px"

    kind: Literal["texture_wavelength"] = "texture_wavelength"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "texture wavelength in the image"

    def value(self, facts: RigContext) -> float:
        """Return the wavelength."""
        return facts.causes.wavelength_px


class TotalDisparityConstraint(ConstraintSpec):
    """Disparity between the outermost positions, as a fraction of the image width; no overlap above 1."""

    unit: ClassVar[str] = "1"

    kind: Literal["total_disparity"] = "total_disparity"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "disparity between the outermost positions relative to the image width"

    def value(self, facts: RigContext) -> float:
        """Return the fraction."""
        camera = facts.scene.camera
        return camera.focal_px * facts.travel_mm / facts.depth_mm / camera.width


_HALF_WIDTH = 2.3548  # width at half maximum of a Gaussian, in standard deviations


class WindowConstraint(ConstraintSpec):
    """Full width at half maximum of the analysis window on the surface: 2.355 σ Z / f."""

    unit: ClassVar[str] = "mm"

    kind: Literal["window"] = "window"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "analysis window on the surface"

    def value(self, facts: RigContext) -> float:
        """Return the width."""
        return _HALF_WIDTH * facts.causes.window_sigma_px * facts.depth_mm / facts.scene.camera.focal_px


class WorkingDistanceConstraint(ConstraintSpec):
    """Median depth of the first objective's region."""

    unit: ClassVar[str] = "mm"

    kind: Literal["working_distance"] = "working_distance"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "working distance"

    def value(self, facts: RigContext) -> float:
        """Return the median depth."""
        return facts.depth_mm


class DataRateConstraint(ConstraintSpec):
    """Bytes of all images of a frame per frame interval (1 MB = 1e6 bytes)."""

    unit: ClassVar[str] = "MB/s"

    kind: Literal["data_rate"] = "data_rate"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "data rate"

    def value(self, facts: RigContext) -> float:
        """Return the data rate."""
        camera, bits = facts.scene.camera, getattr(facts.scene.sensor, "bit_depth", None) or 16
        size = camera.width * camera.height * math.ceil(bits / 8)
        return facts.images_per_frame * size / facts.scene.frames.frame_interval_s / 1e6


class ExposureConstraint(ConstraintSpec):
    """Exposure time of the shutter, or of the sensor if that of the shutter is zero."""

    unit: ClassVar[str] = "s"

    kind: Literal["exposure"] = "exposure"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "exposure time"

    def value(self, facts: RigContext) -> float:
        """Return the exposure time."""
        return facts.scene.shutter.exposure_time_s or float(getattr(facts.scene.sensor, "exposure_time_s", 0.0))


class FlowConstraint(ConstraintSpec):
    """Median length of the optical flow in the first objective's region."""

    unit: ClassVar[str] = "px/frame"

    kind: Literal["flow"] = "flow"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "optical flow"

    def value(self, facts: RigContext) -> float:
        """Return the length in the image."""
        return facts.causes.flow_px


class FrameIntervalConstraint(ConstraintSpec):
    """Frame interval."""

    unit: ClassVar[str] = "s"

    kind: Literal["frame_interval"] = "frame_interval"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "frame interval"

    def value(self, facts: RigContext) -> float:
        """Return the frame interval."""
        return facts.scene.frames.frame_interval_s


class GreyLevelConstraint(ConstraintSpec):
    """Brightest grey values of the texture, as a fraction of full scale; saturated above 1.

    Mean plus three standard deviations, limited by the grey value of white; medians over the first objective's region.
    """

    unit: ClassVar[str] = "1"

    kind: Literal["grey_level"] = "grey_level"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "brightest grey values, fraction of full scale"

    def value(self, facts: RigContext) -> float:
        """Return the fraction."""
        return facts.causes.brightest_level


class ImagesConstraint(ConstraintSpec):
    """Number of images of all positions and frames."""

    unit: ClassVar[str] = "images"

    kind: Literal["images"] = "images"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "images"

    def value(self, facts: RigContext) -> float:
        """Return the number of images."""
        return float(facts.images_per_frame * facts.scene.frames.count)


class MotionBlurConstraint(ConstraintSpec):
    """Motion blur by object and stage: 95th percentile of the image motion during the exposure.

    Taken over the moving points of the first objective's region.
    """

    unit: ClassVar[str] = "px"

    kind: Literal["motion_blur"] = "motion_blur"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "motion blur"

    def value(self, facts: RigContext) -> float:
        """Return the length in the image."""
        return facts.causes.blur_px


class RecordingTimeConstraint(ConstraintSpec):
    """Time from the first to the last frame of the recording or of the temporal window."""

    unit: ClassVar[str] = "s"

    kind: Literal["recording_time"] = "recording_time"

    of: Literal["recording", "window"] = "recording"
    """All frames, or the frames of the temporal window of the method."""

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "time from the first to the last frame" + (" of a window" if self.of == "window" else "")

    def value(self, facts: RigContext) -> float:
        """Return the duration."""
        frames = facts.causes.frames if self.of == "window" else facts.scene.frames.count
        return (frames - 1) * facts.scene.frames.frame_interval_s


class TimePerCaptureConstraint(ConstraintSpec):
    """Duration of a capture of all positions: number of positions times travel, settling and exposure time."""

    unit: ClassVar[str] = "s"

    kind: Literal["time_per_capture"] = "time_per_capture"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "time per capture"

    def value(self, facts: RigContext) -> float:
        """Return the duration."""
        each = max(facts.scene.stage.time_per_position_s, facts.scene.shutter.exposure_time_s)
        return facts.images_per_frame * each


class PriceConstraint(ConstraintSpec):
    """Sum of the prices of the catalogue entries, in euros; entries without a price violate the constraint."""

    unit: ClassVar[str] = "EUR"

    kind: Literal["price"] = "price"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "price"

    def value(self, facts: RigContext) -> float:
        """Return the sum; NaN if a price is missing."""
        return math.nan if facts.price is None else facts.price


class StageErrorConstraint(ConstraintSpec):
    """Standard deviation of the image shift along x due to stage errors: yaw f psi, position f dX / Z."""

    unit: ClassVar[str] = "px"

    kind: Literal["stage_error"] = "stage_error"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "image shift due to stage errors"

    def value(self, facts: RigContext) -> float:
        """Return the standard deviation of the shift."""
        return compute_stage_shifts_px(facts.scene, facts.depth_mm).along


class StageTravelConstraint(ConstraintSpec):
    """Distance between the outermost positions."""

    unit: ClassVar[str] = "mm"

    kind: Literal["stage_travel"] = "stage_travel"

    @property
    def title(self) -> str:
        """Name of the bounded property."""
        return "stage travel"

    def value(self, facts: RigContext) -> float:
        """Return the distance."""
        return facts.travel_mm
