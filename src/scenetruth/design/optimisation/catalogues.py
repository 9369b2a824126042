"""Catalogues of lenses, cameras and stages: their entries, the bundled catalogue, and files of the user."""

from __future__ import annotations

import difflib
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
    """What all entries have in common."""

    title: Name
    """What it is."""
    source: Annotated[str, Field(min_length=3, max_length=1000)]
    """Where its figures are from: data sheet and year; or "typical of its class"."""
    price_eur: NonNegative | None = None
    """Price in euros; null if not known."""


class LensEntry(CatalogueEntry):
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


class CameraEntry(CatalogueEntry):
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
        missing = [name for name in _REQUIRED if getattr(self, name) is None]
        if self.preset is None and missing:
            msg = f"needs a preset, or {', '.join(missing)}"
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


_BUNDLED = Path(__file__).with_name("bundled_catalogues.yaml")
_MODELS: Mapping[str, type[CatalogueEntry]] = {"lenses": LensEntry, "cameras": CameraEntry, "stages": StageEntry}


@dataclass(frozen=True)
class CatalogueEntries:
    """All entries that there are, by name.

    ``lenses``, ``cameras``, ``stages``: Of each kind.
    """

    lenses: Mapping[str, LensEntry]
    cameras: Mapping[str, CameraEntry]
    stages: Mapping[str, StageEntry]

    def of(self, kind: str) -> Mapping[str, CatalogueEntry]:
        """Return the entries that a parameter ``lens``, ``camera`` or ``stage`` chooses from."""
        return {"lens": self.lenses, "camera": self.cameras, "stage": self.stages}[kind]


def load_catalogues(files: Sequence[str | Path] = ()) -> CatalogueEntries:
    """Return the entries that ship, and those of files."""
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
        raise DesignSpecError(list_catalogue_problems(error), source=source) from error


def list_catalogue_problems(error: ValidationError) -> list[Problem]:
    """Return what is wrong with a catalogue; of a field without its unit, which one is meant."""
    found = []
    for entry in error.errors(include_url=False):
        where = [str(key) for key in entry["loc"]]
        message = str(entry["msg"]).removeprefix("Value error, ")
        if entry["type"] == "extra_forbidden":
            model = _MODELS.get(where[0]) if len(where) > 2 else None
            message = _unknown(where[-1], list(model.model_fields) if model else list(Catalogue.model_fields))
        elif entry["type"] == "missing":
            message = "is missing"
        value = None if entry["type"] == "missing" or len(where) < 3 else entry.get("input")
        found.append(Problem(".".join(where), message[:1].lower() + message[1:], value))
    return found


def _unknown(key: str, known: Sequence[str]) -> str:
    with_unit = [name for name in known if name.startswith(f"{key}_")]
    if with_unit:
        return f"has no unit in its name: write {' or '.join(with_unit)}"
    near = difflib.get_close_matches(key, known, n=1)
    return f"unknown key; did you mean '{near[0]}'?" if near else f"unknown key; known here: {', '.join(known)}"
