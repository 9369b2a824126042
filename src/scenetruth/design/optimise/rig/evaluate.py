"""One rig evaluated: its scene, what is predicted of it, and whether it satisfies the constraints."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from scenetruth.design.optimise.constraints.base import Limit, bounded
from scenetruth.design.optimise.constraints.facts import Facts
from scenetruth.design.optimise.parts import Constraint, Objective
from scenetruth.design.optimise.rig.build import Base, Built, build
from scenetruth.design.optimise.rig.systematic import added
from scenetruth.design.optimise.statistics import STATISTICS, predicted_of
from scenetruth.design.predict import Prediction, predict
from scenetruth.errors import SceneError, SceneWarning
from scenetruth.scene import Scene, scene_from_plain
from scenetruth.scoring import QUANTITIES

__all__ = ["Evaluation", "Task", "evaluate", "facts_of", "parts_of", "predicted", "sorted_by_worth"]

_NO_SCENE = 100.0
"""Excess of what makes no scene, or shows nothing: far more than any constraint's."""
_MOST_EXCESS = 10.0
_S_PER_H = 3600.0


@dataclass(frozen=True)
class Task:
    """All that is needed to evaluate any rig.

    Parameters
    ----------
    base
        What all rigs have in common.
    limits
        The constraints of the goal.
    objectives
        What is to be known.
    method
        Name of the method; its settings are the scene's.
    """

    base: Base
    limits: tuple[Limit, ...]
    objectives: tuple[Objective, ...]
    method: str


@dataclass(frozen=True)
class Evaluation:
    """What a rig is worth.

    Parameters
    ----------
    values
        Of what is free, by name.
    predicted
        Of each objective its statistic, by title; infinite where nothing is told.
    parts
        What they are made of, by title: ``noise``, ``stage``, ``scan``.
    constraints
        All constraints; empty if there is no scene.
    problem
        Why there is no scene; empty if there is.
    """

    values: Mapping[str, Any]
    predicted: Mapping[str, float]
    parts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    constraints: tuple[Constraint, ...] = ()
    problem: str = ""

    @property
    def holds(self) -> bool:
        """Whether there is such a rig, and it satisfies all constraints."""
        told = all(math.isfinite(value) for value in self.predicted.values())
        return not self.problem and told and all(one.holds for one in self.constraints)

    @property
    def excess(self) -> float:
        """By how much constraints are exceeded, as a sum of shares of their limits; 0 if it holds."""
        if self.problem:
            return _NO_SCENE
        over = sum(min(-one.margin, _MOST_EXCESS) for one in self.constraints if not one.holds)
        return over + _MOST_EXCESS * sum(not math.isfinite(value) for value in self.predicted.values())


def evaluate(task: Task, values: Mapping[str, Any]) -> Evaluation:
    """Evaluate one rig.

    Parameters
    ----------
    task
        What is designed.
    values
        Of what is free, by name.
    """
    nothing = {one.title: math.inf for one in task.objectives}
    try:
        built = build(task.base, values)
        scene = scene_from_plain(built.plain)
        prediction = predicted(scene, task.method)
    except SceneError as error:
        first = error.problems[0]
        return Evaluation(values, nothing, problem=f"{first.path}: {first.message}" if first.path else first.message)
    facts = facts_of(task, built, scene, prediction, values)
    if facts is None:
        region = task.objectives[0].region
        return Evaluation(values, nothing, problem=f"{region}: nothing of it is seen")
    parts = {one.title: parts_of(one, scene, prediction) for one in task.objectives}
    total = {title: _root_sum(each.values()) if each else math.inf for title, each in parts.items()}
    constraints = tuple(one for limit in task.limits for one in limit.checked(facts))
    return Evaluation(values, total, parts, (*constraints, *_of_hardware(facts)))


def predicted(scene: Scene, method: str) -> Prediction:
    """Return what theory says of a scene, without warnings: of thousands nobody reads them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        return predict(scene, method=method)


def facts_of(task: Task, built: Built, scene: Scene, prediction: Prediction, values: Mapping[str, Any]) -> Facts | None:
    """Return a rig as constraints see it; None if the first objective's region is not seen."""
    region = task.objectives[0].region
    if region not in prediction.by_region:
        return None
    return Facts(scene, prediction, region, values, built.lens, built.camera, built.stage, built.f_number)


def parts_of(objective: Objective, scene: Scene, prediction: Prediction) -> dict[str, float]:
    """Return what an objective's statistic is made of, by its causes alone; empty if nothing is told."""
    quantity, region = objective.quantity, objective.region
    figures = prediction.figures.get(region, {})
    if quantity not in figures:
        return {}
    figure = figures[quantity]
    signals = {name: one.signal for name, one in figures.items()}
    hour = 100.0 * _S_PER_H / scene.frames.frame_interval_s if QUANTITIES[quantity].units == "%/h" else 1.0
    more = added(scene, prediction.by_region[region], signals)
    factor = hour * STATISTICS[objective.statistic].of_normal
    found = {"noise": predicted_of(figure, objective.statistic)}
    return found | {what: factor * told[quantity] for what, told in more.items() if quantity in told}


def _root_sum(values: Any) -> float:
    total = math.sqrt(math.fsum(value * value for value in values))
    return total if total > 0 else math.inf


def _of_hardware(facts: Facts) -> Iterator[Constraint]:
    """Give what the chosen lens and stage allow."""
    lens, stage = facts.lens, facts.stage
    if lens is not None:
        focus = facts.scene.optics.defocus
        at = facts.depth_mm if focus is None else focus.focus_distance_mm
        yield bounded("least_focus", "focus distance of the lens", at, "at least", lens.least_focus_mm, "mm")
        yield from _of_aperture(facts.f_number or lens.f_number_least, lens.f_number_least, lens.f_number_most)
        camera = facts.scene.camera
        diagonal = 1e-3 * (camera.pixel_pitch_um or 0.0) * math.hypot(camera.width, camera.height)
        yield bounded("image_circle", "diagonal of the sensor", diagonal, "at most", lens.image_circle_mm, "mm")
    if stage is not None:
        yield bounded("travel", "travel of the chosen stage", facts.travel_mm, "at most", stage.travel_mm, "mm")


def _of_aperture(f_number: float, least: float, most: float) -> Iterator[Constraint]:
    yield bounded("f_number", "f-number of the lens", f_number, "at least", least, "1")
    yield bounded("f_number", "f-number of the lens", f_number, "at most", most, "1")


def sorted_by_worth(found: Sequence[Evaluation]) -> list[Evaluation]:
    """Return evaluations, those that hold first, by the product of their objectives; then by their excess."""

    def worth(one: Evaluation) -> tuple[float, float]:
        logs = [math.log(value) for value in one.predicted.values() if math.isfinite(value)]
        return one.excess, sum(logs) if logs else math.inf

    return sorted(found, key=worth)
