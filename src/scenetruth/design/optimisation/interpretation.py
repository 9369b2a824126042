"""What the results of a search mean: limiting factors, rig records, rules of thumb, assumptions, infeasibility."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from scenetruth.design.optimisation.catalogues import CatalogueEntries
from scenetruth.design.optimisation.design_records import (
    ConstraintValue,
    DesignSpecError,
    Objective,
    RigDesign,
    RuleOfThumb,
    Sensitivity,
)
from scenetruth.design.optimisation.design_result import format_parameter
from scenetruth.design.optimisation.problem_setup import OptimisationProblem
from scenetruth.design.optimisation.rig_context import RigContext
from scenetruth.design.optimisation.rig_evaluation import (
    DesignSpace,
    Evaluation,
    EvaluationTask,
    build_rig,
    evaluate_rig,
    rank_evaluations,
)
from scenetruth.design.optimisation.specification import DesignSpec
from scenetruth.errors import Problem
from scenetruth.scene import Scene

__all__ = [
    "check_rules_of_thumb",
    "compute_local_sensitivities",
    "describe_limiting_factors",
    "list_assumptions",
    "refuse_infeasible",
    "rig_from_evaluation",
]


_NEAR = 0.03
"""Share of its limit that is left of a constraint that limits."""
_AT_END = 0.01
"""Share of its range that a parameter is from an end that limits."""
_CONTRIBUTION_TITLES = {
    "noise": "the noise of the images",
    "stage": "the stage's errors",
    "scan": "motion during a scan",
}


def describe_limiting_factors(one: Evaluation, space: DesignSpace, objectives: tuple[Objective, ...]) -> str:
    """Return what limits a rig."""
    parts = [*_errors(one, objectives)]
    used = [
        f"{each.title} ({each.value:.4g} of {each.limit:.4g}{'' if each.unit == '1' else f' {each.unit}'})"
        for each in find_active_constraints(one)
    ]
    if used:
        parts.append(f"used up: {', '.join(used)}")
    ends = list(_ends(one, space))
    if ends:
        parts.append(f"at the end of its range: {', '.join(ends)}")
    return "; ".join(parts)


def find_active_constraints(one: Evaluation) -> list[ConstraintValue]:
    """Return the constraints of a rig that leave nothing, the tightest first."""
    near = [each for each in one.constraints if each.margin < _NEAR]
    return sorted(near, key=lambda each: each.margin)


def _errors(one: Evaluation, objectives: tuple[Objective, ...]) -> Iterator[str]:
    for objective in objectives:
        parts = one.parts.get(objective.title, {})
        whole = sum(value * value for value in parts.values())
        if not whole:
            continue
        largest = max(parts, key=lambda name: parts[name])
        share = 100 * parts[largest] ** 2 / whole
        told = _CONTRIBUTION_TITLES[largest]
        yield f"{objective.title.lower()} is limited by {told} ({share:.0f} % of the predicted variance)"


def _ends(one: Evaluation, space: DesignSpace) -> Iterator[str]:
    for parameter in space.parameters:
        if parameter.choices:
            numbers = [v for v in parameter.choices if isinstance(v, int | float) and not isinstance(v, bool)]
            if len(numbers) == len(parameter.choices) and one.values[parameter.name] in (min(numbers), max(numbers)):
                yield f"{parameter.name} = {one.values[parameter.name]:g}"
            continue
        value = one.values[parameter.name]
        whole_ends = parameter.whole and value in (parameter.rounded(parameter.low), parameter.rounded(parameter.high))
        unit = parameter.unit(value)
        if whole_ends or (not parameter.whole and (unit < _AT_END or unit > 1 - _AT_END)):
            yield f"{parameter.name} = {value:g}"


_OTHER = "another length"


def rig_from_evaluation(number: int, one: Evaluation, prepared: OptimisationProblem) -> RigDesign:
    """Return the rig of an evaluation."""
    task = prepared.task
    built = build_rig(task.base, one.values)
    plain = Scene.from_dict(built.plain).to_dict()
    chosen = [entry for entry in (built.lens, built.camera, built.stage) if entry is not None]
    prices = [entry.price_eur for entry in chosen]
    price = sum(each for each in prices if each is not None) if prices and None not in prices else None
    limits = describe_limiting_factors(one, prepared.space, task.objectives)
    return RigDesign(number, dict(one.values), plain, dict(one.predicted), {}, one.constraints, price, limits)


def compute_local_sensitivities(
    one: Evaluation, prepared: OptimisationProblem, factor: float = 1.1
) -> dict[tuple[str, str], float]:
    """Return by what share objectives change for ten percent more of each parameter, by objective and parameter.

    Of whole numbers, at least one more or less is taken, and what ten percent would do follows on logarithmic scales.
    Of a lens, it is the focal length. What cannot be made, or has no size, is left out.
    """
    task, found = prepared.task, dict[tuple[str, str], float]()
    # Not the prediction that is kept: it may be of an earlier version.
    here = evaluate_rig(task, one.values)
    for parameter in prepared.space.parameters:
        value = one.values[parameter.name]
        changed = _changed(task, parameter.name, value, factor)
        if changed is None:
            continue
        other, new, changed_by = changed
        told = evaluate_rig(other, {**one.values, parameter.name: new})
        for objective in task.objectives:
            before, after = here.predicted[objective.title], told.predicted[objective.title]
            if 0 < before < math.inf and 0 < after < math.inf:
                power = math.log(factor) / math.log(changed_by)
                found[objective.title, parameter.name] = (after / before) ** power - 1
    return found


def _changed(task: EvaluationTask, name: str, value: Any, factor: float) -> tuple[EvaluationTask, Any, float] | None:
    """Return what evaluates a changed parameter, its new value, and by what it changed; None if it has no size."""
    if name == "lens":
        entry = task.base.entries.lenses[value]
        other = entry.model_copy(update={"focal_length_mm": factor * entry.focal_length_mm})
        entries = task.base.entries
        more = CatalogueEntries({**entries.lenses, _OTHER: other}, entries.cameras, entries.stages)
        return replace(task, base=replace(task.base, entries=more)), _OTHER, factor
    if isinstance(value, bool) or not isinstance(value, int | float) or value == 0:
        return None
    if isinstance(value, int):
        rounded = round(factor * value)
        new = max(rounded, value + 1) if factor > 1 else min(rounded, value - 1)
        return (task, new, new / value) if new > 0 and value > 0 else None
    return task, factor * value, factor


_GUIDE = "International Digital Image Correlation Society, A Good Practices Guide for Digital Image Correlation, 2018"
_VIC = "Correlated Solutions, manual of VIC-3D 8: speckles that are 3 to 5 pixels in size"
_PRACTICE = "common practice in image correlation"
_CUT = 2.0
"""The window is cut at so many standard deviations."""


def check_rules_of_thumb(facts: RigContext) -> tuple[RuleOfThumb, ...]:
    """Return the rules at a rig."""
    causes, camera = facts.causes, facts.scene.camera
    # Dots of a diameter D have most of their gradient in waves of about 2 D.
    speckle = causes.wavelength_px / 2
    angle = math.degrees(2 * math.atan2(facts.travel_mm / 2, facts.depth_mm))
    brightest = causes.brightest_level
    features = 2 * _CUT * causes.window_sigma_px / causes.wavelength_px
    overlap = 1 - camera.focal_px * facts.travel_mm / facts.depth_mm / camera.width
    blur = causes.blur_px
    return (
        RuleOfThumb(
            "size of speckles",
            f"{_VIC}; likewise {_GUIDE}",
            "3 to 5 px, lest they are folded by the pixels",
            f"{speckle:.1f} px (half the mean wavelength)",
            3 <= speckle <= 5,
        ),
        RuleOfThumb(
            "stereo angle",
            _GUIDE,
            "15 to 35° between two cameras; with many positions in small steps, matching needs no such compromise",
            f"{angle:.1f}° between the outermost positions",
            15 <= angle <= 35,
        ),
        RuleOfThumb(
            "motion blur",
            f"{_PRACTICE}: what moves by 0.1 px loses 0.1 % of the contrast of waves of 4 px",
            "less than 0.1 px while an image is exposed",
            f"{blur:.2g} px",
            blur < 0.1,
        ),
        RuleOfThumb(
            "saturation",
            _PRACTICE,
            "no grey value at full scale",
            f"brightest grey values at {100 * brightest:.0f} % of full scale",
            brightest < 1,
        ),
        RuleOfThumb(
            "features in a window",
            f"{_GUIDE}: a subset holds three features or more along each side",
            "three speckles or more along a side",
            f"{2 * features:.1f} along {2 * _CUT * causes.window_sigma_px:.0f} px",
            2 * features >= 3,
        ),
        RuleOfThumb(
            "overlap of the outermost views",
            _PRACTICE,
            "more than half of the image's width",
            f"{100 * max(overlap, 0.0):.0f} %",
            overlap > 0.5,
        ),
    )


def list_assumptions(
    spec: DesignSpec,
    facts: RigContext,
    changes: Sequence[str],
    left_out: tuple[float, float],
    effects: Sequence[Sensitivity],
) -> tuple[str, ...]:
    """Return what is taken for granted."""
    return tuple(_lines(spec, facts, changes, left_out, effects))


def _lines(
    spec: DesignSpec,
    facts: RigContext,
    changes: Sequence[str],
    left_out: tuple[float, float],
    effects: Sequence[Sensitivity],
) -> Iterator[str]:
    yield (
        "predictions are standard deviations of noise (Cramér-Rao bound of the method's window and motion, from "
        "geometry and the texture's spectrum), with the stage's errors and its time in closed form; the method's own "
        "bias, curved surfaces and edges are not in them, and show in the simulations"
    )
    yield from facts.prediction.notes
    if facts.lens is not None:
        yield (
            "the lens is a thin one, focused where the first objective's region is; its blur and diffraction are one "
            "Gaussian; it is calibrated"
        )
        residual_px = facts.lens.distortion_residual_um / (facts.scene.camera.pixel_pitch_um or 1.0)
        if residual_px > 0:
            off = facts.depth_mm * residual_px / max(abs(facts.causes.disparity_px), 1e-9)
            yield (
                f"what calibration leaves of distortion is not in any figure: {residual_px:.2g} px here, up to "
                f"{off:.2g} mm of depth from place to place"
            )
    if facts.camera is not None and spec.light is None:
        yield "there is as much light as the camera needs: a white surface fills 80 % of what the sensor can say"
    if spec.light is not None:
        yield f"a white surface has {spec.light.illuminance_lux:g} lux, all of it at {spec.light.wavelength_um:g} µm"
    chosen = {"lens": facts.lens, "camera": facts.camera, "stage": facts.stage}
    typical = [name for name, one in chosen.items() if one is not None and "typical" in one.source]
    if typical:
        yield f"figures of the chosen {', '.join(typical)} are at least in part typical of the class; see the catalogue"
    if "frames.frame_interval_s" in spec.variables and _has_rates(facts.scene.to_dict()):
        yield "motions that the scene gives per frame are the same per frame at any interval; give them per hour if not"
    yield from (f"in the simulations: {change}" for change in changes)
    for name, share in zip(("Morris", "Sobol'"), left_out, strict=True):
        if share > 0:
            yield f"sensitivity by {name} leaves out {100 * share:.0f} % of its samples, with rigs that cannot be made"
    by_name: dict[str, list[Sensitivity]] = {}
    for one in effects:
        by_name.setdefault(one.parameter, []).append(one)
    idle = [name for name, told in by_name.items() if all(one.morris_mu_star == 0.0 for one in told)]
    if idle:
        yield f"no effect on any objective: {', '.join(idle)}; constraints or chance choose their values"


def _has_rates(plain: Any) -> bool:
    """Whether something in a scene moves by so much per frame."""
    if isinstance(plain, Mapping):
        return any(
            ("per_frame" in str(key) and _is_nonzero(value)) or _has_rates(value) for key, value in plain.items()
        )
    return isinstance(plain, list | tuple) and any(map(_has_rates, plain))


def _is_nonzero(value: Any) -> bool:
    values = value if isinstance(value, list | tuple) else [value]
    return any(isinstance(one, int | float) and one != 0 for one in values)


def refuse_infeasible(spec: DesignSpec, found: Sequence[Evaluation]) -> None:
    """Refuse a design specification that no rig meets."""
    if any(one.holds for one in found):
        return
    made = [one for one in found if one.constraints]
    if not made:
        (problem, count), *_ = Counter(one.problem for one in found).most_common(1)
        raise DesignSpecError(
            [Problem("variables", f"none of {len(found):,} rigs can be made; {count:,} of them: {problem}")]
        )
    nearest = rank_evaluations(made)[0]
    problems = [_describe_exclusion(spec, one, made) for one in nearest.constraints if not one.holds]
    values = ", ".join(f"{name} = {format_parameter(value)}" for name, value in nearest.values.items())
    if not problems:
        problems.append(Problem("objectives", f"are told of none of {len(made):,} rigs"))
    problems.append(Problem("variables", f"the nearest of {len(found):,} rigs that were tried has {values}"))
    raise DesignSpecError(problems)


def _describe_exclusion(spec: DesignSpec, one: ConstraintValue, made: Sequence[Evaluation]) -> Problem:
    """Return how a constraint excludes the nearest rig, and whether it excludes all others too."""
    kinds = [str(getattr(limit, "kind", "")) for limit in spec.constraints]
    path = f"constraints.{kinds.index(one.kind)}" if one.kind in kinds else one.kind
    same = [
        each
        for rig in made
        for each in rig.constraints
        if (each.kind, each.title, each.sense) == (one.kind, one.title, one.sense)
    ]
    holding = sum(each.holds for each in same)
    unit = "" if one.unit == "1" else f" {one.unit}"
    here = f"{one.title} must be {one.sense} {one.limit:.4g}{unit}; the nearest rig has {one.value:.4g}"
    if holding:
        return Problem(path, f"{here}; {holding:,} of {len(same):,} rigs satisfy it, but none of them all the others")
    best = max(same, key=lambda each: each.margin)
    return Problem(path, f"{here}; it excludes all of {len(same):,} rigs, of which the best has {best.value:.4g}")
