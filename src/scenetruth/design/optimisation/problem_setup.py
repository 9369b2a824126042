"""Set-up of the optimisation problem from a design specification: base scene, catalogues and design space."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scenetruth.design.optimisation.catalogues import CatalogueEntries, load_catalogues
from scenetruth.design.optimisation.design_records import DesignSpecError, Objective
from scenetruth.design.optimisation.rig_evaluation import (
    BaseRig,
    DesignSpace,
    EvaluationTask,
    Parameter,
    build_rig,
    predict_scene,
)
from scenetruth.design.optimisation.specification import (
    CATALOGUES,
    NAMED_VARIABLES,
    DesignReading,
    DesignSpec,
    DesignSpecLike,
    DesignVariable,
    ObjectiveSpec,
    read_design_spec,
)
from scenetruth.design.prediction import Prediction
from scenetruth.errors import EstimateError, Problem, SceneError
from scenetruth.estimators import choose
from scenetruth.estimators.method_specs import MethodSpec, parse_method
from scenetruth.scene import Overrides, Scene, read_scene
from scenetruth.scene.field_paths import PathError, assign, expand, value_at
from scenetruth.scene.scene_loader import SceneReading, change_scene
from scenetruth.scoring import QUANTITIES
from scenetruth.scoring.quantities import get_title
from scenetruth.validation_problems import suggest_word

__all__ = ["OptimisationProblem", "load_problem", "prepare_problem"]

_NO_EFFECT = ("format", "description", "storage", "seed", "score")
_MOST_TRIED = 64  # number of rigs that are tried until one has a prediction


@dataclass(frozen=True)
class OptimisationProblem:
    """A validated optimisation problem: input of the evaluations, design space and base scene."""

    task: EvaluationTask
    space: DesignSpace
    scene: Scene


def prepare_problem(spec: DesignSpec) -> OptimisationProblem:
    """Return the optimisation problem; raise `DesignSpecError` with all problems."""
    return _Setup(read_design_spec(spec)).required()


def load_problem(specification: DesignSpecLike, *, overrides: Overrides = ()) -> tuple[DesignSpec, OptimisationProblem]:
    """Return a design specification and its optimisation problem; raise an error with the problems of both."""
    reading = read_design_spec(specification, overrides=overrides)
    if reading.valid_part is None or not reading.problems:
        return reading.required(), _Setup(reading).required()
    raise DesignSpecError([*reading.problems, *_Setup(reading).problems], source=reading.source)


class _Setup:
    """Set-up of the problem of a specification, or of the valid remainder of one with problems."""

    def __init__(self, reading: DesignReading) -> None:
        spec, self.repair = reading.valid_part, reading.repair
        assert spec is not None
        self.spec, self.is_whole = spec, not reading.problems
        self.problems: list[Problem] = []
        self.entries = self._entries()
        self.scene, self.wrong = self._scene()
        self.space, self.places = self._space()
        self.result: OptimisationProblem | None = None
        if self.scene is not None:
            self._prepare(self.scene)

    def required(self) -> OptimisationProblem:
        """Return the optimisation problem, or raise an error with all problems."""
        if self.result is None or self.problems:
            raise DesignSpecError(self.problems)
        return self.result

    def _entries(self) -> CatalogueEntries | None:
        try:
            return load_catalogues(self.spec.catalogues)
        except DesignSpecError as error:
            self.problems += [Problem(f"catalogues: {one.path}", one.message, one.value) for one in error.problems]
            return None

    def _scene(self) -> tuple[Scene | None, frozenset[str]]:
        """Return the base scene with the changes and the method of the specification, and its parts with problems."""
        spec = self.spec
        chosen, wrong = self._method(), set[str]()
        if self.repair.is_wrong("scene"):
            return None, frozenset()
        try:
            reading = read_scene(spec.scene)
            scene = reading.valid_part
            if scene is not None:
                scene.require_grey("an optimisation")
        except SceneError as error:
            reading = SceneReading(None, error.problems)
        changes = dict(spec.set)
        if chosen is None:
            wrong.add("estimate")
        elif scene is not None and "estimate" not in {path.split(".")[0] for path in spec.set}:
            own = scene.estimate.settings.model_dump(mode="json") if scene.estimate.method == chosen.method else {}
            changes["estimate"] = {"method": chosen.method, **own, **chosen.settings}
        changed = change_scene(reading, changes)
        text = f" ({spec.scene})" if isinstance(spec.scene, str) else ""
        self.problems += [
            Problem(".".join(filter(None, ("scene", one.path))), f"{one.message}{text}", one.value)
            for one in changed.problems
        ]
        self.problems += [Problem(f"set.{one.path}", one.message, one.value) for one in changed.misplaced]
        removed = {each[1] for each in self.repair.wrong if each[:1] == ("set",) and len(each) > 1}
        return changed.scene, frozenset(wrong | changed.wrong | removed)

    def _method(self) -> MethodSpec | None:
        """Return the method; None if it has a problem."""
        given = self.spec.method
        if self.repair.is_wrong("method"):
            return None
        try:
            return parse_method(given, from_file=True) if isinstance(given, str) else _read_method(given)
        except EstimateError as error:
            self.problems += [Problem(f"method.{one.path}", one.message, one.value) for one in error.problems]
            return None

    def _is_hidden(self, path: str) -> bool:
        """Return whether a path leads into a part of the scene with problems, or to all of it."""
        return any(f"{path}.".startswith(f"{one}.") or f"{one}.".startswith(f"{path}.") for one in self.wrong)

    def _space(self) -> tuple[list[Parameter], dict[str, tuple[str, ...]]]:
        """Return the parameters without problems, and the fields of those of the scene."""
        found, places, taken = list[Parameter](), dict[str, tuple[str, ...]](), dict[str, tuple[str, ...]]()
        plain = None if self.scene is None else self.scene.to_dict()
        problems = list[Problem]()
        for name, variable in () if ("variables",) in self.repair.wrong else self.spec.variables.items():
            parameter = None
            if name in NAMED_VARIABLES:
                parameter = _named(name, variable, self.entries, problems)
            elif plain is not None and not self._is_hidden(name):
                own = _places(plain, name, problems)
                if own:
                    taken[name] = own
                    parameter = _parameter(name, variable, plain, own, problems)
            if parameter is not None:
                found.append(parameter)
                places |= {name: taken[name]} if name in taken else {}
        problems += _overlaps(taken)
        if ("variables",) not in self.repair.wrong:
            names = {*self.spec.variables, *(each[1] for each in self.repair.wrong if each[:1] == ("variables",))}
            problems += _find_undetermined(self.spec, names, None if self._is_hidden("camera") else self.scene)
        self.problems += problems
        undecided = {one.path.removeprefix("variables.") for one in problems}
        kept = [one for one in found if one.name not in undecided]
        return kept, {one.name: places[one.name] for one in kept if one.name in places}

    def _prepare(self, scene: Scene) -> None:
        """Check values and objectives by predictions, and build the problem if there are no problems."""
        space, complete = DesignSpace(tuple(self.space)), self.is_whole and not self.problems
        base = BaseRig(scene.to_dict(), self.places, self.entries or load_catalogues(), self.spec.light, math.nan)
        self.problems += _find_invalid_values(base, space)
        prediction = None
        try:
            base = replace(base, depth_mm=_compute_depth(scene, self.spec))
        except (SceneError, DesignSpecError) as error:
            self.problems += error.problems if complete else ()
        else:
            if len(space) and not self.wrong:
                self.problems += _find_ineffective(base, space)
            prediction = self._predict(base, space, scene, only_base=not complete or bool(self.problems))
        objectives = self._objectives(scene, prediction)
        if complete and not self.problems and prediction is not None:
            task = EvaluationTask(base, self.spec.constraints, objectives, scene.estimate.method)
            self.result = OptimisationProblem(task, space, scene)

    def _objectives(self, scene: Scene, prediction: Prediction | None) -> tuple[Objective, ...]:
        """Return the objectives after a check against a prediction, or without one, against the names of objects."""
        numbers = [] if ("objectives",) in self.repair.wrong else self.repair.indices("objectives")
        found = []
        for number, wanted in zip(numbers, self.spec.objectives, strict=bool(numbers)):
            where = f"objectives.{number}"
            if not any(part.startswith(("objects", "plants")) for part in self.wrong):
                self.problems += _in_no_region(where, wanted, scene, prediction)
            self.problems += _not_predicted(where, wanted, prediction, scene.estimate.method)
            units = QUANTITIES[wanted.quantity].units
            found.append(Objective(wanted.quantity, wanted.region, units, "", wanted.target, wanted.statistic))
        return tuple(_with_unique_title(one, found) for one in found)

    def _predict(self, base: BaseRig, space: DesignSpace, scene: Scene, *, only_base: bool) -> Prediction | None:
        """Return the prediction of the middle of the design space; of the base scene if other parts have problems."""
        if not only_base:
            try:
                return _predict_middle(base, space, scene.estimate.method)
            except DesignSpecError as error:
                self.problems += error.problems
                return None
        if any(self._is_hidden(part) for part in ("camera", "stage", "frames", "sensor", "estimate")):
            return None
        try:
            return predict_scene(scene, scene.estimate.method)
        except SceneError:
            return None


def _read_method(given: Mapping[str, Any]) -> MethodSpec:
    """Return a method given as a mapping of ``method``, its settings and an optional ``label``."""
    fields = {key: value for key, value in given.items() if key != "label"}
    chosen = choose(fields, from_file=True)
    return MethodSpec(chosen.method, {key: value for key, value in fields.items() if key != "method"})


def _places(plain: Mapping[str, Any], path: str, problems: list[Problem]) -> tuple[str, ...]:
    try:
        found = tuple(expand(plain, path))
        for place in found:
            value_at(plain, place)
    except PathError as error:
        text = str(error).replace(", under 'set'", "")
        problems.append(Problem(f"variables.{path}", text + suggest_word(path, NAMED_VARIABLES)))
        return ()
    return found


def _parameter(
    name: str, variable: DesignVariable, plain: Mapping[str, Any], places: tuple[str, ...], problems: list[Problem]
) -> Parameter | None:
    if variable.values is not None:
        return _choice(name, variable, problems)
    try:
        there = [value_at(plain, place) for place in places]
    except PathError as error:
        problems.append(Problem(f"variables.{name}", str(error)))
        return None
    whole = all(isinstance(value, int) and not isinstance(value, bool) for value in there)
    return _range(name, variable, problems, whole=whole)


def _range(name: str, variable: DesignVariable, problems: list[Problem], *, whole: bool) -> Parameter | None:
    low, high = float(variable.from_ or 0.0), float(variable.to or 0.0)
    if whole and math.ceil(low) >= math.floor(high):
        problems.append(Problem(f"variables.{name}", "must contain at least two integers", [low, high]))
        return None
    return Parameter(name, low, high, variable.log, whole)


def _choice(name: str, variable: DesignVariable, problems: list[Problem]) -> Parameter | None:
    if variable.values == "all" or variable.values is None:
        problems.append(
            Problem(
                f"variables.{name}",
                f"is none of the catalogues {', '.join(CATALOGUES)}; list its values",
                variable.values,
            )
        )
        return None
    values = list(variable.values)
    if any(value in values[:number] for number, value in enumerate(values)):
        problems.append(Problem(f"variables.{name}", "has duplicate values", values))
        return None
    if len(values) < 2:
        message = "must have at least two values; specify a constant under 'set'"
        problems.append(Problem(f"variables.{name}", message, values))
        return None
    return Parameter(name, choices=tuple(values))


def _named(
    name: str, variable: DesignVariable, entries: CatalogueEntries | None, problems: list[Problem]
) -> Parameter | None:
    if name not in CATALOGUES:
        if variable.values is not None:
            return _choice(name, variable, problems)
        if (variable.from_ or 0.0) <= 0:
            problems.append(Problem(f"variables.{name}", "must start above 0", variable.from_))
            return None
        return _range(name, variable, problems, whole=False)
    if variable.values is None:
        problems.append(
            Problem(f"variables.{name}", "is chosen from a catalogue; list names of entries, or specify all")
        )
        return None
    if entries is None:
        return None
    known = entries.of(name)
    values = list(known) if variable.values == "all" else list(variable.values)
    for one in values:
        if one not in known:
            text = suggest_word(str(one), known) or f"; valid entries: {', '.join(known)}"
            problems.append(Problem(f"variables.{name}", f"unknown catalogue entry{text}", one))
    if any(one not in known for one in values):
        return None
    return Parameter(name, choices=tuple(dict.fromkeys(values)))


def _overlaps(places: Mapping[str, tuple[str, ...]]) -> Iterator[Problem]:
    names = list(places)
    for number, one in enumerate(names):
        for other in names[:number]:
            if any(
                f"{here}.".startswith(f"{there}.") or f"{there}.".startswith(f"{here}.")
                for here in places[one]
                for there in places[other]
            ):
                yield Problem(f"variables.{one}", f"overlaps with '{other}'; vary only one of the two")


_CHOSEN = {
    "camera": ("camera.width", "camera.height", "camera.pixel_pitch_um", "camera.focal_length_px", "sensor"),
    "lens": ("camera.focal_length_mm", "camera.focal_length_px", "camera.distortion", "optics.psf"),
    "stage": ("stage.errors", "stage.time_per_position_s"),
    "exposure_s": ("shutter.exposure_time_s",),
}
"""Scene fields that a named variable determines."""


def _find_undetermined(spec: DesignSpec, names: Collection[str], scene: Scene | None) -> Iterator[Problem]:
    """Yield the problems of parameters that require or are determined by others.

    ``names``: Names of all parameters, including those with problems. ``scene``: None if its camera has problems.
    """
    if "f_number" in spec.variables and "lens" not in names:
        yield Problem(
            "variables.f_number", "requires a lens; add 'lens' with at least one catalogue entry to the variables"
        )
    if "lens" in spec.variables and "camera" not in names and scene is not None and scene.camera.pixel_pitch_um is None:
        message = (
            "requires the pixel pitch; specify camera.pixel_pitch_um and focal_length_mm in the scene, or add 'camera'"
        )
        yield Problem("variables.lens", f"{message} to the variables")
    for name, taken in _CHOSEN.items():
        for path in spec.variables if name in spec.variables else ():
            if any(f"{path}.".startswith(f"{one}.") for one in taken):
                yield Problem(
                    f"variables.{path}", f"has no effect: it is determined by '{name}'; vary only one of the two"
                )


def _compute_depth(scene: Scene, spec: DesignSpec) -> float:
    """Return the median depth of the first objective's region in the base scene, in mm."""
    try:
        quiet = scene.model_copy(update={"sensor": Scene.from_dict({**scene.to_dict(), "sensor": _SOME_NOISE}).sensor})
        prediction = predict_scene(quiet, scene.estimate.method)
    except SceneError as error:
        raise DesignSpecError(
            [Problem(f"scene.{one.path}", one.message, one.value) for one in error.problems]
        ) from error
    region = spec.objectives[0].region
    return prediction.by_region.get(region, prediction.causes).depth_mm


_SOME_NOISE = {"noise_std": 0.01}


def _find_invalid_values(base: BaseRig, space: DesignSpace) -> Iterator[Problem]:
    """Yield the problems of values that are invalid for any values of the other parameters."""
    for number, one in enumerate(space.parameters):
        if one.name not in base.places:
            continue
        values = list(one.choices) if one.choices else [one.rounded(one.low), one.rounded(one.high)]
        seen: set[str] = set()
        for value in values:
            try:
                Scene.from_dict(_with(base, space, number, value))
            except SceneError as error:
                for problem in error.problems:
                    own = any(f"{problem.path}.".startswith(f"{place}.") for place in base.places[one.name])
                    if own and problem.message not in seen:
                        seen.add(problem.message)
                        yield Problem(f"variables.{one.name}", problem.message, problem.value)


def _with(base: BaseRig, space: DesignSpace, number: int, value: Any) -> dict[str, Any]:
    plain = copy.deepcopy(dict(base.plain))
    for place in base.places[space.parameters[number].name]:
        assign(plain, place, copy.deepcopy(value))
    return plain


def _find_ineffective(base: BaseRig, space: DesignSpace) -> Iterator[Problem]:
    """Yield a problem for each parameter without an effect on any statistic."""
    middle = [0.5] * len(space)
    for number, one in enumerate(space.parameters):
        if one.name in CATALOGUES:
            continue
        ends = []
        levels = len(one.choices)
        for unit in [(k + 0.5) / levels for k in range(levels)] or (0.0, 1.0):
            point = [*middle[:number], unit, *middle[number + 1 :]]
            try:
                plain = build_rig(base, space.values(point)).plain
                plain = Scene.from_dict(plain).to_dict()
            except (SceneError, PathError):
                break
            ends.append({key: value for key, value in plain.items() if key not in _NO_EFFECT})
        if len(ends) > 1 and all(end == ends[0] for end in ends):
            yield Problem(f"variables.{one.name}", "has no effect on any statistic; omit it")


def _predict_middle(base: BaseRig, space: DesignSpace, method: str) -> Prediction:
    """Return the prediction of the central rig of the design space, or of another valid rig."""
    from scipy.stats import qmc

    points = np.vstack([np.full(len(space), 0.5), qmc.Sobol(len(space), seed=0).random(_MOST_TRIED)])
    last: SceneError | None = None
    for point in points:
        try:
            return predict_scene(Scene.from_dict(build_rig(base, space.values(point.tolist())).plain), method)
        except SceneError as error:
            last = last or error
    assert last is not None
    problems = [
        Problem(
            one.path or "variables",
            f"{one.message}; none of {_MOST_TRIED} tested rigs has a prediction",
            one.value,
        )
        for one in last.problems
    ]
    raise DesignSpecError(problems)


def _in_no_region(where: str, wanted: ObjectiveSpec, scene: Scene, prediction: Prediction | None) -> Iterator[Problem]:
    regions = ["all", "interior", *(f"object_{item.name}" for _, item in scene.parts)]
    if prediction is not None:
        regions = list(prediction.regions)
    if wanted.region not in regions:
        yield Problem(f"{where}.region", f"unknown region; valid regions: {', '.join(regions)}", wanted.region)


def _not_predicted(where: str, wanted: ObjectiveSpec, prediction: Prediction | None, method: str) -> Iterator[Problem]:
    if prediction is not None and wanted.quantity not in prediction.quantities:
        known = ", ".join(prediction.quantities) or "nothing"
        message = f"is not available for this scene and method {method}; available quantities: {known}"
        yield Problem(f"{where}.quantity", message, wanted.quantity)
    elif wanted.statistic == "p95_abs_error" and QUANTITIES[wanted.quantity].error != "difference":
        message = f"is not available for {wanted.quantity}, a distance or an angle; use another statistic, such as rmse"
        yield Problem(f"{where}.statistic", message, wanted.statistic)


def _with_unique_title(objective: Objective, others: list[Objective]) -> Objective:
    name = get_title(objective.quantity)
    place = objective.region.removeprefix("object_")
    alone = len({one.region for one in others}) == 1 and objective.region in ("all", "interior")
    title = name if alone else f"{name} of {place}" if objective.region.startswith("object_") else f"{name}, {place}"
    same = sum((one.quantity, one.region) == (objective.quantity, objective.region) for one in others)
    return replace(objective, title=f"{title}, {objective.statistic_title}" if same > 1 else title)
