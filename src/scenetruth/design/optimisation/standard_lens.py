"""The nearest lens of the catalogue and the nearest f-stop, for a rig with a free focal length or f-number."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from scenetruth.design.optimisation.catalogues import CameraEntry, LensEntry
from scenetruth.design.optimisation.design_records import Objective, RigDesign
from scenetruth.design.optimisation.rig_evaluation import EvaluationTask, build_rig, evaluate_rig
from scenetruth.number_format import format_length, format_number, format_percent
from scenetruth.scene import Scene

__all__ = ["F_STOPS", "StandardLens", "choose_f_stop", "choose_standard_lens", "describe_standard_lens"]

F_STOPS = (1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
"""Full stops that are engraved on lenses."""
_USUAL_F_NUMBER = 8.0  # for a scene without an aperture
_SAME = 0.005  # relative difference of focal lengths or f-numbers that is rounding


@dataclass(frozen=True)
class StandardLens:
    """A lens of the catalogue with an f-stop, and the predicted errors of the rig with it."""

    title: str
    focal_length_mm: float
    f_number: float
    wanted_focal_length_mm: float  # of the rig, as a lens focused at infinity
    wanted_f_number: float | None
    image_distance_mm: float  # `camera.focal_length_mm` of the scene, the lens being focused at the object
    focus_mm: float
    predicted: Mapping[str, float] = field(default_factory=dict)  # by title of the objective
    broken: tuple[str, ...] = ()  # constraints that the rig with it violates

    @property
    def is_that_of_the_rig(self) -> bool:
        """Whether the rig itself has this lens and f-stop."""
        same = _near(self.focal_length_mm, self.wanted_focal_length_mm)
        return same and (self.wanted_f_number is None or _near(self.f_number, self.wanted_f_number))


def _near(one: float, other: float) -> bool:
    return abs(math.log(one / other)) < _SAME


def choose_f_stop(f_number: float, lens: LensEntry) -> float:
    """Return the stop nearest to an f-number in light, among full stops of a lens and its ends."""
    stops = [one for one in F_STOPS if lens.f_number_least <= one <= lens.f_number_most]
    return min([*stops, lens.f_number_least, lens.f_number_most], key=lambda one: abs(math.log(one / f_number)))


def choose_standard_lens(task: EvaluationTask, values: Mapping[str, Any]) -> StandardLens | None:
    """Return the nearest lens of the catalogue with its f-stop; None if the scene does not define millimetres.

    ``values``: Values of the design variables of the rig.
    """
    built = build_rig(task.base, values)
    camera = Scene.from_dict(built.plain).camera
    if camera.pixel_pitch_um is None:
        return None
    focus = task.base.depth_mm
    if "working_distance_mm" in values:
        focus = float(values["working_distance_mm"])
    image = 1e-3 * camera.focal_px * camera.pixel_pitch_um
    wanted = built.lens.focal_length_mm if built.lens is not None else image * focus / (image + focus)
    if built.lens is not None:
        name = str(values["lens"])
    else:
        size = built.camera.diagonal_mm if isinstance(built.camera, CameraEntry) else None
        pitch = 1e-3 * camera.pixel_pitch_um
        diagonal = size or pitch * math.hypot(camera.width, camera.height)
        fitting = {
            name: one
            for name, one in task.base.entries.lenses.items()
            if one.image_circle_mm >= diagonal and one.focal_length_mm < focus >= one.least_focus_mm
        }
        if not fitting:
            return None
        name = min(fitting, key=lambda one: abs(math.log(fitting[one].focal_length_mm / wanted)))
    lens = task.base.entries.lenses[name]
    defocus = Scene.from_dict(built.plain).optics.defocus
    f_number = built.f_number
    if f_number is None and defocus is not None:
        f_number = wanted / defocus.aperture_mm
    stop = choose_f_stop(f_number if f_number is not None else _USUAL_F_NUMBER, lens)
    one = evaluate_rig(task, {**values, "lens": name, "f_number": stop})
    broken = tuple(each.title for each in one.constraints if not each.holds)
    at = lens.focal_length_mm * focus / (focus - lens.focal_length_mm)
    return StandardLens(
        lens.title, lens.focal_length_mm, stop, wanted, f_number, at, focus, dict(one.predicted), broken
    )


def describe_standard_lens(lens: StandardLens | None, objectives: Sequence[Objective], rig: RigDesign) -> Iterator[str]:
    """Yield sentences on the lens to buy for a recommended rig."""
    if lens is None:
        if "camera.focal_length_px" in rig.parameters:
            yield (
                "No lens is named: the focal length is free in pixels, whose size is unknown. "
                "Vary camera and lens, or state camera.focal_length_mm and pixel_pitch_um"
            )
        return
    stop = f"f/{format_length(lens.f_number, 2)}"
    if lens.wanted_f_number is None:
        stop += " (assumed: the scene states no aperture)"
    name = lens.title
    if lens.is_that_of_the_rig:
        yield f"Lens: {name} at {stop}"
    else:
        off = f"{format_length(lens.wanted_focal_length_mm)} mm"
        if lens.wanted_f_number is not None:
            off += f" at f/{format_length(lens.wanted_f_number, 2)}"
        if _near(lens.focal_length_mm, lens.wanted_focal_length_mm):
            at = format_length(lens.wanted_f_number or lens.f_number, 2)
            yield f"The rig has this lens, {name}, at f/{at}; the nearest full stop is {stop}"
        else:
            yield f"The rig has a lens of {off}. The nearest lens that can be bought is: {name} at {stop}"
        pairs = []
        for one in objectives:
            value = lens.predicted.get(one.title, math.inf)
            new = f"{format_number(value, 2)} {one.unit}" if math.isfinite(value) else "no prediction"
            before = format_number(rig.predicted[one.title], 2)
            pairs.append(f"{one.title[0].lower()}{one.title[1:]} {new} (rig as optimised: {before})")
        yield f"With it, predicted: {'; '.join(pairs)}"
        if lens.broken:
            yield f"With it, constraints are not satisfied: {', '.join(lens.broken)}"
        if lens.wanted_f_number is not None and lens.f_number < lens.wanted_f_number:
            light = (lens.wanted_f_number / lens.f_number) ** 2
            yield (
                f"Images are {format_percent(light - 1)} brighter with it: an exposure time shorter by "
                f"{format_percent(1 - 1 / light)} compensates for that"
            )
    focus, length = format_length(lens.focus_mm), format_length(lens.focal_length_mm)
    yield (
        f"Focused at {focus} mm, a lens of {length} mm forms its image {format_length(lens.image_distance_mm, 4)} mm "
        "behind it. This distance is camera.focal_length_mm of the scene file"
    )
