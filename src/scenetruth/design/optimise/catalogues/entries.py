"""What entries of catalogues say: lenses, cameras and stages, each with its source, units in the names of fields."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from scenetruth.camera.sensor.presets import PresetName
from scenetruth.model import FrozenModel, Name, NonNegative, Positive

__all__ = ["CameraEntry", "Catalogue", "Entry", "LensEntry", "StageEntry"]


class Entry(FrozenModel):
    """What all entries have in common."""

    title: Name
    """What it is."""
    source: Annotated[str, Field(min_length=3, max_length=1000)]
    """Where its figures are from: data sheet and year; or "typical of its class"."""
    price_eur: NonNegative | None = None
    """Price in euros; null if not known."""


class LensEntry(Entry):
    """A lens of fixed focal length."""

    focal_length_mm: Positive
    """Focal length."""
    least_focus_mm: Positive
    """Least distance of what is in focus, from the entrance pupil."""
    f_number_least: Positive
    """Least f-number: the aperture is wide open."""
    f_number_most: Positive
    """Largest f-number."""
    blur_um: NonNegative = 0.0
    """Standard deviation on the sensor of a Gaussian that stands for the lens's own blur; diffraction comes on top."""
    image_circle_mm: Positive
    """Diameter of the image circle."""
    distortion_residual_um: NonNegative = 0.0
    """What calibration leaves of distortion, rms on the sensor."""

    @model_validator(mode="after")
    def _opens(self) -> Self:
        if self.f_number_least > self.f_number_most:
            msg = f"f_number_least = {self.f_number_least:g} is above f_number_most = {self.f_number_most:g}"
            raise ValueError(msg)
        return self


class CameraEntry(Entry):
    """A camera, by the figures of EMVA 1288: a sensor preset of scenetruth, or all of its figures."""

    width: Annotated[int, Field(ge=1, le=32768)]
    """Pixels along x."""
    height: Annotated[int, Field(ge=1, le=32768)]
    """Pixels along y."""
    pixel_pitch_um: Positive
    """Distance of two pixels."""
    preset: PresetName | None = None
    """The sensor by name, whose values stand for all that is not given."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] | None = None
    """Electrons per photon."""
    full_well_e: Positive | None = None
    """Electrons that a pixel can hold."""
    read_noise_e: NonNegative | None = None
    """Temporal dark noise in electrons."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] | None = None
    """Bits of a grey value."""
    dark_current_e_per_s: NonNegative | None = None
    """Electrons that a pixel collects in a second without light."""
    dsnu_e: NonNegative | None = None
    """Standard deviation of the pixels' dark offsets in electrons."""
    prnu: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Standard deviation of the pixels' sensitivities, relative to their mean."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        missing = [name for name in _NEEDED if getattr(self, name) is None]
        if self.preset is None and missing:
            msg = f"needs a preset, or {', '.join(missing)}"
            raise ValueError(msg)
        return self

    @property
    def diagonal_mm(self) -> float:
        """Diagonal of the sensor."""
        return float(1e-3 * self.pixel_pitch_um * (self.width**2 + self.height**2) ** 0.5)


_NEEDED = ("quantum_efficiency", "full_well_e", "read_noise_e", "bit_depth")


class StageEntry(Entry):
    """A linear stage."""

    travel_mm: Positive
    """Distance of its ends."""
    repeatability_um: NonNegative
    """Standard deviation along its axis, fresh at every visit."""
    backlash_um: NonNegative = 0.0
    """Distance between where a position is reached from below and from above."""
    straightness_um: NonNegative
    """Standard deviation across its axis, along Y and along Z."""
    pitch_urad: NonNegative
    """Standard deviation of the turn about X."""
    yaw_urad: NonNegative
    """Standard deviation of the turn about Y."""
    roll_urad: NonNegative
    """Standard deviation of the turn about Z."""
    speed_mm_per_s: Positive | None = None
    """Speed from position to position; null for one that takes no time."""
    settle_s: NonNegative = 0.0
    """Time that it needs to come to rest."""


class Catalogue(FrozenModel):
    """A file of a catalogue: entries by name."""

    lenses: dict[Name, LensEntry] = Field(default_factory=dict)
    """Lenses."""
    cameras: dict[Name, CameraEntry] = Field(default_factory=dict)
    """Cameras."""
    stages: dict[Name, StageEntry] = Field(default_factory=dict)
    """Stages."""
