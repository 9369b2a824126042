"""What a cause of errors is: what in a scene switches it, what it does to the images, and what helps against it."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any, ClassVar, Literal

import xarray as xr

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.propagation.base import Errors, Propagation
from scenetruth.design.budget.sight import Disturbance, Sight
from scenetruth.scene import Scene

__all__ = ["Cause", "Group", "Remedy", "all_causes", "contrast_causes", "present"]

Group = Literal["images", "stage", "calibration", "surface"]


@dataclass(frozen=True)
class Remedy:
    """What helps against a cause.

    Parameters
    ----------
    words
        What to do, with the field of the scene and its new value.
    factors
        What is left of the parts of causes, by their kinds.
    """

    words: str
    factors: Mapping[str, float] = field(default_factory=dict)


class Cause:
    """A cause of errors; one module in a room of `causes` each, which is found by itself.

    Derive from it, set what is below, and write what it does: `disturbances`, or `responses` where it does nothing to
    images.
    """

    kind: ClassVar[str]
    """Its name: lower-case letters and underscores."""
    title: ClassVar[str]
    """What it is, in a few words, as in "stage yaw makes 1.4 of 1.5 mm"."""
    group: ClassVar[Group]
    """What it belongs to."""
    perfect: ClassVar[Mapping[str, Any]] = {}
    """Its fields in the scene, by path, and their values where it is off."""
    takes_contrast: ClassVar[bool] = False
    """Whether it changes what images look like, so that it stays on while causes in the sensor are looked at."""
    coarse: ClassVar[bool] = False
    """Whether it is always simulated, because its prediction leaves out what may matter."""
    of_surface: ClassVar[bool] = False
    """Whether it is a part of what is left with ideal images, and cannot be switched off."""

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether a scene has it."""
        plain = scene.to_plain()
        return any(_at(plain, path) not in (value, None) for path, value in self.perfect.items())

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return how large the cause is in a scene, with its unit."""
        return ""

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Change a scene in place, given as plain values with all fields, so that the cause does nothing."""
        for path, value in self.perfect.items():
            *above, last = path.split(".")
            place: Any = plain
            for key in above:
                place = None if place is None else place.get(key)
            if place is not None:
                place[last] = value

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give what it does to the images: disturbances that are independent of each other, of one standard deviation.

        What it does in all draws alike is one of them.
        """
        return ()

    def drawn(self, sight: Sight, scene: Scene) -> Iterable[Disturbance] | None:
        """Return what it does to the images of this very scene and seed; None if only its size is known."""
        return None

    def responses(self, sight: Sight, propagation: Propagation, calibration: Calibration) -> Iterator[Errors]:
        """Give the errors that follow, independent of each other, of one standard deviation each."""
        for one in self.disturbances(sight):
            yield propagation.respond(one)

    def responses_drawn(
        self, sight: Sight, propagation: Propagation, calibration: Calibration, scene: Scene, draw: int
    ) -> Iterator[Errors] | None:
        """Return the errors that follow in this very scene and draw, which add up; None if only their size is known."""
        found = self.drawn(sight, scene)
        return None if found is None else (propagation.respond(one) for one in found)

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change in place what a recording tells of its camera in a draw, from 0 on; most causes do not."""

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy | None:
        """Return what helps; None if nothing does."""
        return None


def _at(plain: Mapping[str, Any], path: str) -> Any:
    place: Any = plain
    for key in path.split("."):
        place = None if place is None else place.get(key)
    return place


@cache
def all_causes() -> Mapping[str, Cause]:
    """Return all causes by kind, in the order of rooms and modules."""
    from scenetruth.design.budget import causes

    return {cause.kind: cause for cause in _found_in(causes)}


def _found_in(package: Any) -> Iterator[Cause]:
    for entry in pkgutil.iter_modules(package.__path__):
        module = import_module(f"{package.__name__}.{entry.name}")
        if entry.ispkg:
            yield from _found_in(module)
        for one in vars(module).values():
            if isinstance(one, type) and issubclass(one, Cause) and one.__module__ == module.__name__:
                yield one()


def present(scene: Scene, calibration: Calibration) -> list[Cause]:
    """Return the causes that a scene has, those of its surface aside."""
    return [one for one in all_causes().values() if not one.of_surface and one.is_on(scene, calibration)]


def contrast_causes(causes: Iterable[Cause]) -> frozenset[str]:
    """Return the kinds of those causes that change what images look like."""
    return frozenset(one.kind for one in causes if one.takes_contrast)
