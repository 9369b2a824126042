"""Interpretation of a search: limiting factors, rig records, rules of thumb, assumptions and infeasibility."""

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
from scenetruth.design.parameter_words import describe_parameter, title_parameter
from scenetruth.design.prediction.analytic_prediction import NO_STAGE_ERRORS
from scenetruth.errors import Problem
from scenetruth.number_format import format_number, format_value
from scenetruth.scene import Scene

__all__ = [
    "LIGHT",
    "TEXTURE",
    "check_rules_of_thumb",
    "compute_local_sensitivities",
    "describe_limiting_factors",
    "list_assumptions",
    "refuse_infeasible",
    "rig_from_evaluation",
]


_NEAR = 0.03  # margin below which a constraint counts as active
_AT_END = 0.01  # distance of a parameter from an end of its range that counts as limiting, as a fraction of the range
_CONTRIBUTION_TITLES = {
    "noise": "image noise",
    "anisotropy": "the bias of isotropic growth",
    "stage": "stage errors",
    "scan": "motion during a scan",
}


def describe_limiting_factors(one: Evaluation, space: DesignSpace, objectives: tuple[Objective, ...]) -> str:
    """Return a description of the limiting factors of a rig."""
    parts = [*_errors(one, objectives)]
    used = [f"{each.title} ({_describe_use(each)})" for each in find_active_constraints(one)]
    if used:
        parts.append(f"active constraints: {', '.join(used)}")
    ends = list(_ends(one, space))
    if ends:
        parts.append(f"at the end of its range: {', '.join(ends)}")
    return "; ".join(parts)


def _describe_use(one: ConstraintValue) -> str:
    """Return the value of a property and its limit, with the digits of the margin that makes a constraint active."""
    least = _NEAR * abs(one.limit)
    digits = max(0, math.ceil(-math.log10(least))) if least > 0 else 2
    unit = "" if one.unit == "1" else f" {one.unit}"
    return f"{round(one.value, digits):g} of {one.limit:g}{unit}"


def find_active_constraints(one: Evaluation) -> list[ConstraintValue]:
    """Return the active constraints of a rig, the smallest margin first."""
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
        stated = _CONTRIBUTION_TITLES[largest]
        title = f"{objective.title[0].lower()}{objective.title[1:]}"
        yield f"{title} is limited by {stated} ({share:.0f} % of the predicted variance)"


def _ends(one: Evaluation, space: DesignSpace) -> Iterator[str]:
    for parameter in space.parameters:
        if parameter.choices:
            numbers = [v for v in parameter.choices if isinstance(v, int | float) and not isinstance(v, bool)]
            if len(numbers) == len(parameter.choices) and one.values[parameter.name] in (min(numbers), max(numbers)):
                yield describe_parameter(parameter.name, one.values[parameter.name])
            continue
        value = one.values[parameter.name]
        whole_ends = parameter.whole and value in (parameter.rounded(parameter.low), parameter.rounded(parameter.high))
        unit = parameter.unit(value)
        if whole_ends or (not parameter.whole and (unit < _AT_END or unit > 1 - _AT_END)):
            yield describe_parameter(parameter.name, value)


_OTHER = "another length"


def rig_from_evaluation(number: int, one: Evaluation, prepared: OptimisationProblem) -> RigDesign:
    """Return the record of an evaluated rig."""
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
    """Return the relative change of each objective for a change of each parameter by ``factor``.

    An integer is changed by at least 1, and the result is rescaled logarithmically. For a lens, the focal length is
    changed. Invalid rigs and non-numeric parameters are omitted.
    """
    task, found = prepared.task, dict[tuple[str, str], float]()
    here = evaluate_rig(task, one.values)  # not the stored prediction, which may be of an earlier version
    for parameter in prepared.space.parameters:
        value = one.values[parameter.name]
        changed = _changed(task, parameter.name, value, factor)
        if changed is None:
            continue
        other, new, changed_by = changed
        stated = evaluate_rig(other, {**one.values, parameter.name: new})
        for objective in task.objectives:
            before, after = here.predicted[objective.title], stated.predicted[objective.title]
            if 0 < before < math.inf and 0 < after < math.inf:
                power = math.log(factor) / math.log(changed_by)
                found[objective.title, parameter.name] = (after / before) ** power - 1
    return found


def _changed(task: EvaluationTask, name: str, value: Any, factor: float) -> tuple[EvaluationTask, Any, float] | None:
    """Return the task, the new value and its actual factor for a changed parameter; None if it is not numeric."""
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
_VIC = "Correlated Solutions, manual of VIC-3D 8: speckles of 3 to 5 pixels"
_PRACTICE = "common practice in image correlation"
_CUT = 2.0  # half width of the window, in standard deviations


def check_rules_of_thumb(facts: RigContext) -> tuple[RuleOfThumb, ...]:
    """Return the rules of thumb, evaluated for a rig."""
    causes, camera = facts.causes, facts.scene.camera
    # Speckles of diameter D have most of their gradient at wavelengths of about 2 D.
    speckle = causes.wavelength_px / 2
    angle = math.degrees(2 * math.atan2(facts.travel_mm / 2, facts.depth_mm))
    brightest = causes.brightest_level
    features = 2 * _CUT * causes.window_sigma_px / causes.wavelength_px
    overlap = 1 - camera.focal_px * facts.travel_mm / facts.depth_mm / camera.width
    blur = causes.blur_px
    return (
        RuleOfThumb(
            "speckle size",
            f"{_VIC}; also {_GUIDE}",
            "3 to 5 px, to avoid aliasing",
            f"{speckle:.1f} px (half the mean wavelength)",
            3 <= speckle <= 5,
        ),
        RuleOfThumb(
            "stereo angle",
            _GUIDE,
            "15 to 35° between two cameras; not required for many positions in small steps",
            f"{angle:.1f}° between the outermost positions",
            15 <= angle <= 35,
        ),
        RuleOfThumb(
            "motion blur",
            f"{_PRACTICE}: a motion of 0.1 px reduces the contrast at a wavelength of 4 px by 0.1 %",
            "less than 0.1 px during the exposure",
            f"{format_number(blur, 2)} px",
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
            "speckles per window",
            f"{_GUIDE}: a subset has at least three features along each side",
            "at least three speckles along each side",
            f"{2 * features:.1f} along {2 * _CUT * causes.window_sigma_px:.0f} px",
            2 * features >= 3,
        ),
        RuleOfThumb(
            "overlap of the outermost views",
            _PRACTICE,
            "more than half of the image width",
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
    *,
    confirmed: bool,
) -> tuple[str, ...]:
    """Return the assumptions as sentences. ``confirmed``: Whether descents from other rigs ended at no better rig."""
    return tuple(_lines(spec, facts, changes, left_out, effects, confirmed=confirmed))


_CONFIRMED = (
    "the search starts anew from random rigs with the same choices, and from rigs with one position more and one less; "
    "none of these searches has ended at a better predicted rig"
)
_UNCONFIRMED = (
    "a better rig than the recommended may exist: the search, of {} predictions, has ended before starts from other "
    "rigs had led to the same rig. The stated precision does not depend on this. To search longer, set "
    "search.predictions to {}"
)


def _lines(
    spec: DesignSpec,
    facts: RigContext,
    changes: Sequence[str],
    left_out: tuple[float, float],
    effects: Sequence[Sensitivity],
    *,
    confirmed: bool,
) -> Iterator[str]:
    count = spec.search.predictions
    yield _CONFIRMED if confirmed else _UNCONFIRMED.format(f"{count:,}", 2 * count)
    yield (
        "predictions are standard deviations due to noise (Cramér-Rao bound for the window and motion model of the "
        "method, from geometry and texture spectrum), with closed-form contributions of stage errors and scan time; "
        "method bias, curved surfaces and edges are included in the simulations only"
    )
    # Stage errors are added to the prediction, as the line above says.
    yield from (note for note in facts.prediction.notes if note != NO_STAGE_ERRORS)
    if facts.lens is not None:
        yield (
            "the lens is a calibrated thin lens, focused on the first objective's region; its aberrations and "
            "diffraction are a Gaussian point spread function"
        )
        residual_px = facts.lens.distortion_residual_um / (facts.scene.camera.pixel_pitch_um or 1.0)
        if residual_px > 0:
            off = facts.depth_mm * residual_px / max(abs(facts.causes.disparity_px), 1e-9)
            yield (
                "the distortion residual after calibration is not included: "
                f"{format_number(residual_px, 2)} px, or up to {format_number(off, 2)} mm of depth, "
                "varying over the image"
            )
    yield describe_texture(facts)
    yield describe_light(facts)
    if facts.camera is not None and spec.light is None:
        yield "the illumination is adapted to the camera: a white surface gives 80 % of full scale"
    if spec.light is not None:
        yield f"the illuminance is {spec.light.illuminance_lux:g} lux, the wavelength {spec.light.wavelength_um:g} µm"
    chosen = {"lens": facts.lens, "camera": facts.camera, "stage": facts.stage}
    typical = [name for name, one in chosen.items() if one is not None and "typical" in one.source]
    if typical:
        yield f"values of the selected {', '.join(typical)} are partly typical of the class; see the catalogue"
    if "frames.frame_interval_s" in spec.variables and _has_rates(facts.scene.to_dict()):
        yield "motions specified per frame do not depend on the frame interval; specify them per hour otherwise"
    yield from (f"in the simulations: {change}" for change in changes)
    for name, share in zip(("Morris", "Sobol'"), left_out, strict=True):
        if share > 0:
            yield f"sensitivity by {name} excludes {100 * share:.0f} % of its samples, which contain invalid rigs"
    by_name: dict[str, list[Sensitivity]] = {}
    for one in effects:
        by_name.setdefault(one.parameter, []).append(one)
    idle = [name for name, stated in by_name.items() if all(one.morris_mu_star == 0.0 for one in stated)]
    if idle:
        names = ", ".join(map(title_parameter, idle))
        yield f"no effect on any objective: {names}; their values follow from constraints or are arbitrary"


def describe_texture(facts: RigContext) -> str:
    """Return the size and the contrast of the texture that a prediction assumes."""
    causes = facts.causes
    feature_px = causes.wavelength_px / 2
    feature_mm = feature_px * causes.depth_mm / facts.scene.camera.focal_px
    contrast = 100 * causes.contrast / causes.grey_level if causes.grey_level > 0 else math.nan
    size = f"{format_number(feature_px, 2)} px, {format_number(feature_mm, 2)} mm on the surface"
    return (
        f"{TEXTURE} has features of {size} "
        f"(half the mean wavelength), and an RMS contrast of {format_number(contrast, 2)} % of the mean grey value in "
        "the images. Half the contrast doubles the standard deviations due to image noise"
    )


def describe_light(facts: RigContext) -> str:
    """Return the changes of light that simulations include."""
    light = facts.scene.lighting
    drift = [f"drift of {100 * light.drift_per_frame:g} % per frame"] if light.drift_per_frame else []
    flicker = [f"flicker of ± {100 * light.flicker.amplitude:g} %"] if light.flicker else []
    if drift or flicker:
        return f"{LIGHT} has a {' and a '.join(drift + flicker)}, which the simulations include and predictions do not"
    # RMS errors of a tilted plane, 160 x 120 px, 5 positions and frames: tests/design/optimisation.
    return (
        f"{LIGHT} is constant. Flicker of all lamps together costs nothing with refined, which estimates the gain of "
        "every image: up to ± 5 %, its errors change by less than 10 %. With structure_tensor, ± 1 % multiplies the "
        "errors of velocity by 3 or more (image noise 0.5 %, contrast 20 %). Its contribution in this scene: set "
        "lighting.flicker or lighting.drift_per_frame in the scene file, and run scenetruth design budget"
    )


TEXTURE, LIGHT = "the texture", "the light"
"""First words of the assumptions about texture and light, which the report shows with the rig."""


def _has_rates(plain: Any) -> bool:
    """Return whether a scene has nonzero motion specified per frame."""
    if isinstance(plain, Mapping):
        return any(
            ("per_frame" in str(key) and _is_nonzero(value)) or _has_rates(value) for key, value in plain.items()
        )
    return isinstance(plain, list | tuple) and any(map(_has_rates, plain))


def _is_nonzero(value: Any) -> bool:
    values = value if isinstance(value, list | tuple) else [value]
    return any(isinstance(one, int | float) and one != 0 for one in values)


def refuse_infeasible(spec: DesignSpec, found: Sequence[Evaluation]) -> None:
    """Raise `DesignSpecError` if no evaluated rig is feasible."""
    if any(one.holds for one in found):
        return
    made = [one for one in found if one.constraints]
    if not made:
        (problem, count), *_ = Counter(one.problem for one in found).most_common(1)
        raise DesignSpecError(
            [Problem("variables", f"none of {len(found):,} rigs is valid; {count:,} of them: {problem}")]
        )
    nearest = rank_evaluations(made)[0]
    problems = [_describe_exclusion(spec, one, made) for one in nearest.constraints if not one.holds]
    values = ", ".join(f"{name} = {format_value(value)}" for name, value in nearest.values.items())
    if not problems:
        problems.append(Problem("objectives", f"no rig has a valid prediction ({len(made):,} evaluated)"))
    problems.append(Problem("variables", f"the nearest of {len(found):,} evaluated rigs has {values}"))
    raise DesignSpecError(problems)


def _describe_exclusion(spec: DesignSpec, one: ConstraintValue, made: Sequence[Evaluation]) -> Problem:
    """Return the problem of a constraint that the nearest rig violates, with the number of rigs that satisfy it."""
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
        return Problem(
            path, f"{here}; {holding:,} of {len(same):,} rigs satisfy it, but none of them all other constraints"
        )
    best = max(same, key=lambda each: each.margin)
    return Problem(path, f"{here}; it excludes all {len(same):,} rigs, the best of which has {best.value:.4g}")
