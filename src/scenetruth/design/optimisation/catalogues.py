"""Catalogues of lenses, cameras and stages: entries, the bundled catalogue, and user-defined files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from scenetruth.camera.sensor.sensor_types import PresetName
from scenetruth.design.optimisation.design_records import DesignSpecError
from scenetruth.errors import Problem
from scenetruth.scene.yaml_reader import read_file
from scenetruth.validated_model import FrozenModel, Name, NonNegative, Positive
from scenetruth.validation_problems import list_problems

__all__ = [
    "CameraEntry",
    "Catalogue",
    "CatalogueEntries",
    "CatalogueEntry",
    "LensEntry",
    "StageEntry",
    "load_catalogues",
]


class CatalogueEntry(FrozenModel):
    """Fields that all entries share."""

    title: Name
    """Product name or description."""
    source: Annotated[str, Field(min_length=3, max_length=1000)]
    """Source of the values: data sheet and year, or "typical of its class"."""
    price_eur: NonNegative | None = None
    """Price in euros; null if unknown."""


class LensEntry(CatalogueEntry):
    """A lens of fixed focal length."""

    focal_length_mm: Positive
    """Focal length."""
    least_focus_mm: Positive
    """Minimum focus distance from the entrance pupil."""
    f_number_least: Positive
    """Smallest f-number (aperture fully open)."""
    f_number_most: Positive
    """Largest f-number."""
    blur_um: NonNegative = 0.0
    """Standard deviation on the sensor of the Gaussian blur by aberrations; diffraction is added."""
    image_circle_mm: Positive
    """Diameter of the image circle."""
    distortion_residual_um: NonNegative = 0.0
    """Distortion residual after calibration, RMS on the sensor."""

    @model_validator(mode="after")
    def _opens(self) -> Self:
        if self.f_number_least > self.f_number_most:
            msg = f"f_number_least = {self.f_number_least:g} is above f_number_most = {self.f_number_most:g}"
            raise ValueError(msg)
        return self


class CameraEntry(CatalogueEntry):
    """A camera with the parameters of EMVA 1288: a sensor preset of scenetruth, or all parameters."""

    width: Annotated[int, Field(ge=1, le=32768)]
    """Pixels along x."""
    height: Annotated[int, Field(ge=1, le=32768)]
    """Pixels along y."""
    pixel_pitch_um: Positive
    """Pixel pitch."""
    preset: PresetName | None = None
    """Name of a sensor preset, the default of all other sensor fields."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] | None = None
    """Quantum efficiency: electrons per photon."""
    full_well_e: Positive | None = None
    """Full-well capacity in electrons."""
    read_noise_e: NonNegative | None = None
    """Temporal dark noise in electrons."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] | None = None
    """Bit depth of the grey values."""
    dark_current_e_per_s: NonNegative | None = None
    """Dark current in electrons per pixel and second."""
    dsnu_e: NonNegative | None = None
    """Dark signal non-uniformity: standard deviation over the pixels in electrons."""
    prnu: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Photo response non-uniformity: relative standard deviation over the pixels."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        missing = [name for name in _REQUIRED if getattr(self, name) is None]
        if self.preset is None and missing:
            msg = f"requires a preset, or {', '.join(missing)}"
            raise ValueError(msg)
        return self

    @property
    def diagonal_mm(self) -> float:
        """Diagonal of the sensor."""
        return float(1e-3 * self.pixel_pitch_um * (self.width**2 + self.height**2) ** 0.5)


_REQUIRED = ("quantum_efficiency", "full_well_e", "read_noise_e", "bit_depth")


class StageEntry(CatalogueEntry):
    """A linear stage."""

    travel_mm: Positive
    """Travel."""
    repeatability_um: NonNegative
    """Standard deviation of the position along the axis, independent at every visit."""
    backlash_um: NonNegative = 0.0
    """Difference between approaches of a position from below and from above."""
    straightness_um: NonNegative
    """Standard deviation across the axis, along Y and along Z."""
    pitch_urad: NonNegative
    """Standard deviation of the rotation about X."""
    yaw_urad: NonNegative
    """Standard deviation of the rotation about Y."""
    roll_urad: NonNegative
    """Standard deviation of the rotation about Z."""
    speed_mm_per_s: Positive | None = None
    """Speed between positions; null for no travel time."""
    settle_s: NonNegative = 0.0
    """Settling time."""


class Catalogue(FrozenModel):
    """A catalogue file: entries by name."""

    lenses: dict[Name, LensEntry] = Field(default_factory=dict)
    """Lenses."""
    cameras: dict[Name, CameraEntry] = Field(default_factory=dict)
    """Cameras."""
    stages: dict[Name, StageEntry] = Field(default_factory=dict)
    """Stages."""


_BUNDLED = Path(__file__).with_name("bundled_catalogues.yaml")
_MODELS: Mapping[str, type[CatalogueEntry]] = {"lenses": LensEntry, "cameras": CameraEntry, "stages": StageEntry}


@dataclass(frozen=True)
class CatalogueEntries:
    """All available entries by name."""

    lenses: Mapping[str, LensEntry]
    cameras: Mapping[str, CameraEntry]
    stages: Mapping[str, StageEntry]

    def of(self, kind: str) -> Mapping[str, CatalogueEntry]:
        """Return the entries that a parameter ``lens``, ``camera`` or ``stage`` chooses from."""
        return {"lens": self.lenses, "camera": self.cameras, "stage": self.stages}[kind]


def load_catalogues(files: Sequence[str | Path] = ()) -> CatalogueEntries:
    """Return the bundled entries, extended and overridden by those of files."""
    found = [_bundled()]
    problems: list[Problem] = []
    for file in files:
        try:
            plain, _ = read_file(file, "a catalogue", DesignSpecError)
            found.append(_validate_catalogue(plain, str(file)))
        except DesignSpecError as error:
            here = [(f"{file}: {one.path or '(top level)'}", one) for one in error.problems]
            problems += [Problem(path, one.message, one.value) for path, one in here]
    if problems:
        raise DesignSpecError(problems)
    lenses: dict[str, LensEntry] = {}
    cameras: dict[str, CameraEntry] = {}
    stages: dict[str, StageEntry] = {}
    for one in found:
        lenses |= one.lenses
        cameras |= one.cameras
        stages |= one.stages
    return CatalogueEntries(lenses, cameras, stages)


@cache
def _bundled() -> Catalogue:
    plain, _ = read_file(_BUNDLED, "a catalogue", DesignSpecError)
    return _validate_catalogue(plain, str(_BUNDLED))


def _validate_catalogue(plain: Any, source: str) -> Catalogue:
    if not isinstance(plain, dict):
        raise DesignSpecError([Problem("", "must be a mapping of lenses, cameras and stages", plain)], source=source)
    try:
        return Catalogue.model_validate(plain)
    except ValidationError as error:
        raise DesignSpecError(list_problems(error, plain, model=Catalogue), source=source) from error
