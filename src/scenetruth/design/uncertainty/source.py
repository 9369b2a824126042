"""Sources of uncertainty: base class, uncertainty of the calibration, and scenes restricted to some sources."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, Literal

import xarray as xr
from pydantic import ValidationError

from scenetruth.camera import build_sensor_chain
from scenetruth.design.uncertainty.observation_model import Disturbance, ObservationModel
from scenetruth.design.uncertainty.propagation import Errors, Propagation
from scenetruth.discovery import classes_in
from scenetruth.errors import ArgumentError, Problem
from scenetruth.scene import Scene
from scenetruth.validated_model import FrozenModel, NonNegative
from scenetruth.validation_problems import list_problems

__all__ = [
    "Calibration",
    "CalibrationLike",
    "Mitigation",
    "UncertaintySource",
    "active_sources",
    "all_sources",
    "contrast_sources",
    "resolve_calibration",
    "restrict_sources",
]


class Calibration(FrozenModel):
    """Standard deviations of the calibration of a recording.

    The typical values are those of calibrations with about 20 images of a chessboard. Two examples published with the
    toolbox of J.-Y. Bouguet state 0.05 % of the focal length, and 0.5 and 2.8 px of the principal point (one third of
    the printed values of three standard deviations). A screw-driven stage with an accuracy of 10 µm over a travel of
    20 mm has 0.05 %.

    See Also
    --------
    scenetruth.design.uncertainty.budget : Propagates it to depth and motion.

    Examples
    --------
    >>> Calibration()
    Calibration(focal_length_percent=0.05, principal_point_px=1.0, baseline_percent=0.05)

    0.1 % of the focal length is 0.5 mm of depth for a wall at a distance of 500 mm:

    >>> from scenetruth.design.uncertainty import budget
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"frames": {"count": 3}, "render": {"backend": "raycast"}, "score": {"interior_margin_px": 0}}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2.2}, "sensor": {"noise_std": 0.002}}
    >>> known = Calibration(focal_length_percent=0.1, principal_point_px=0, baseline_percent=0.02)
    >>> found = budget(scene, method="structure_tensor", calibration=known, seeds=1, simulated_share=0)
    >>> for cause in ("focal_length", "baseline"):
    ...     part = found.contribution(cause, "depth")
    ...     print(f"{part.title}, {part.size}: {part.predicted:.2f} {part.unit}")
    focal length, 0.1 %: 0.50 mm
    baseline, 0.02 %: 0.10 mm
    """

    focal_length_percent: NonNegative = 0.05
    """Standard deviation of the focal length, %."""
    principal_point_px: NonNegative = 1.0
    """Standard deviation of the principal point along x and along y, px."""
    baseline_percent: NonNegative = 0.05
    """Standard deviation of the scale of the stage positions, %."""


CalibrationLike = Calibration | Mapping[str, float] | Literal["typical", "perfect"]
"""Accepted forms of a calibration."""

_PERFECT = Calibration(focal_length_percent=0, principal_point_px=0, baseline_percent=0)


def resolve_calibration(given: Any) -> Calibration:
    """Return a calibration; fields missing from a mapping have zero uncertainty."""
    if isinstance(given, Calibration):
        return given
    if given in ("typical", "perfect"):
        return Calibration() if given == "typical" else _PERFECT
    if not isinstance(given, Mapping):
        message = f"must be 'typical', 'perfect', or a mapping of {', '.join(Calibration.model_fields)}"
        raise ArgumentError([Problem("calibration", message, given)], source="an uncertainty budget")
    try:
        return Calibration.model_validate({**_PERFECT.model_dump(), **given})
    except ValidationError as error:
        problems = list_problems(error, given, model=Calibration, under="calibration")
        raise ArgumentError(problems, source="an uncertainty budget") from error


Group = Literal["images", "stage", "calibration", "surface"]


@dataclass(frozen=True)
class Mitigation:
    """A design change in words, with scene field and new value, and the remaining fractions of contributions."""

    words: str
    factors: Mapping[str, float] = field(default_factory=dict)


class UncertaintySource:
    """Base class of sources of uncertainty; subclasses in the package `sources` are discovered automatically.

    They set the class attributes, and implement `disturbances`, or `responses` for sources without effect on images.
    """

    kind: ClassVar[str]
    """Identifier: lower-case letters and underscores."""
    title: ClassVar[str]
    """Title in a few words, as in "largest contribution: stage yaw, 1.4 mm"."""
    group: ClassVar[Group]
    """Group of the source."""
    perfect: ClassVar[Mapping[str, Any]] = {}
    """Scene fields of the source, by path, and their values where it is switched off."""
    takes_contrast: ClassVar[bool] = False
    """Whether it changes the contrast of images, and therefore stays on while sensor sources are evaluated."""
    on_contrast: ClassVar[bool] = False
    """Whether it is evaluated while the sources that change the contrast are on; gloss, for example, requires lamps."""
    coarse: ClassVar[bool] = False
    """Whether it is always simulated, because its prediction is incomplete."""
    of_surface: ClassVar[bool] = False
    """Whether it is part of the errors with ideal images, and cannot be switched off."""

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether the source is present in a scene."""
        plain = scene.to_dict()
        return any(_get_field(plain, path) not in (value, None) for path, value in self.perfect.items())

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the magnitude of the source in a scene, with its unit."""
        return ""

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Switch the source off in a scene given as plain values with all fields, in place."""
        for path, value in self.perfect.items():
            *above, last = path.split(".")
            place: Any = plain
            for key in above:
                place = None if place is None else place.get(key)
            if place is not None:
                place[last] = value

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield independent image disturbances of one standard deviation, systematic disturbances included."""
        return ()

    def drawn(self, sight: ObservationModel, scene: Scene) -> Iterable[Disturbance] | None:
        """Return the disturbances for the seed of a scene; None if only their magnitude is available."""
        return None

    def responses(
        self, sight: ObservationModel, propagation: Propagation, calibration: Calibration
    ) -> Iterator[Errors]:
        """Yield independent errors of the estimate, of one standard deviation each."""
        for one in self.disturbances(sight):
            yield propagation.respond(one)

    def responses_drawn(
        self, sight: ObservationModel, propagation: Propagation, calibration: Calibration, scene: Scene, draw: int
    ) -> Iterator[Errors] | None:
        """Return the errors for the seed of a scene, to be summed; None if only their magnitude is available."""
        found = self.drawn(sight, scene)
        return None if found is None else (propagation.respond(one) for one in found)

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change the camera parameters of a recording in place, for draw 0, 1, ...; default: no change."""

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return the mitigation; None without any."""
        return None


def _get_field(plain: Mapping[str, Any], path: str) -> Any:
    place: Any = plain
    for key in path.split("."):
        place = None if place is None else place.get(key)
    return place


@cache
def all_sources() -> Mapping[str, UncertaintySource]:
    """Return all sources of uncertainty by identifier, in the order of modules and of classes in them."""
    found = classes_in(UncertaintySource, "scenetruth.design.uncertainty.sources")
    # Base classes of a group have no `kind`.
    return {cls.kind: cls() for cls in found if hasattr(cls, "kind")}


def active_sources(scene: Scene, calibration: Calibration) -> list[UncertaintySource]:
    """Return the sources present in a scene, except those of its surface."""
    return [one for one in all_sources().values() if not one.of_surface and one.is_on(scene, calibration)]


def contrast_sources(causes: Iterable[UncertaintySource]) -> frozenset[str]:
    """Return the identifiers of the sources that change the contrast of images."""
    return frozenset(one.kind for one in causes if one.takes_contrast)


def restrict_sources(scene: Scene, kinds: Collection[str], seed: int | None = None) -> Scene:
    """Return a scene with all other sources switched off."""
    plain: dict[str, Any] = scene.to_dict()
    if plain["sensor"] != "ideal":
        plain["sensor"] = build_sensor_chain(scene.sensor).model_dump(mode="json")
    for cause in all_sources().values():
        if cause.kind not in kinds:
            cause.switch_off(plain)
    if plain["render"]["backend"] == "auto":
        plain["render"]["backend"] = "raycast"
    if seed is not None:
        plain["seed"] = seed
    return Scene.from_dict(plain)
