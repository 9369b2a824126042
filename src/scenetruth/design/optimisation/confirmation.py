"""Confirmation runs: simulation of selected candidates with several seeds, and comparison with the predictions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.benchmark.design_point import ignore_scene_warnings
from scenetruth.camera.lens import AiryPsf
from scenetruth.design.optimisation.design_records import (
    STATISTICS,
    Discrepancy,
    Objective,
    PredictionInterval,
    RankConsistency,
    RigDesign,
    compute_prediction_interval,
    compute_rig_interval,
)
from scenetruth.design.optimisation.problem_setup import OptimisationProblem
from scenetruth.design.optimisation.rig_evaluation import compute_objective_contributions, predict_scene
from scenetruth.design.optimisation.specification import ConfirmationSpec
from scenetruth.design.prediction.camera_response import compute_blur_px
from scenetruth.design.prediction.surface_samples import SurfaceSamples, sample_surface
from scenetruth.design.prediction.texture_information import compute_flow
from scenetruth.estimators import estimate
from scenetruth.jobs.results import ResultStore, TaskResult, compute_key, perform_task
from scenetruth.jobs.scheduler import for_each
from scenetruth.jobs.worker_setup import collect_versions
from scenetruth.number_format import format_two_digits
from scenetruth.progress import Progress
from scenetruth.provenance import scene_hash
from scenetruth.resources import Limits, limited_objects
from scenetruth.scene import Scene
from scenetruth.scoring import QUANTITIES, score
from scenetruth.simulation import simulate
from scenetruth.truth import TruthMaps

__all__ = [
    "ConfirmationResult", "ConfirmationTask", "ReducedScene", "check_pair_rank", "check_rank_consistency",
    "compare_with_prediction", "get_simulated_statistic", "reduce_scene", "simulate_candidate", "simulate_candidates",
    "simulate_objectives",
]  # fmt: skip


_NOTABLE_FACTOR = 1.3
"""Factor from which a difference is notable: predictions are within 30 % of the measured scatter in the median."""


def compare_with_prediction(
    rig: int, objective: Objective, predicted: float, simulated: PredictionInterval
) -> Discrepancy:
    """Compare the prediction and the simulation of an objective for one rig."""
    ratio = simulated.value / predicted if predicted > 0 and math.isfinite(predicted) else math.nan
    if not math.isfinite(ratio):
        says = f"{objective.title}: no valid estimate in the simulations ({predicted:.3g} predicted)"
        return Discrepancy(rig, objective.title, predicted, simulated, math.nan, True, says)
    inside = math.isnan(simulated.pi_low) or simulated.pi_low <= predicted <= simulated.pi_high
    notable = not 1 / _NOTABLE_FACTOR <= ratio <= _NOTABLE_FACTOR and not (inside and simulated.seeds > 1)
    text = f"{objective.title}: {objective.statistic_title} simulated {simulated.value:.3g}, "
    text += f"predicted for these images {predicted:.3g} {objective.unit}"
    if not notable and inside:
        says = f"{text}: consistent within the scatter of {simulated.seeds} seeds (factor {ratio:.2f})"
    elif not notable:
        says = f"{text}: a factor of {ratio:.2f}, not notable: half of all predictions are within 30 %"
    elif ratio > 1:
        says = f"{text}: {ratio:.1f} times the prediction, which includes noise and stage errors but not method bias"
    else:
        says = f"{text}: {ratio:.2f} times the prediction"
    return Discrepancy(rig, objective.title, predicted, simulated, ratio, notable, says)


_LITTLE_DISC_PX, _SMALL_DISC_PX, _LITTLE_MOTION_PX = 0.3, 2.0, 0.1
"""A blur disc of 0.3 px reduces the contrast at a wavelength of 4 px by 0.7 %, a motion of 0.1 px by 0.1 %."""
_VISIBLE_PX = 0.001
_SAMPLES = 12
_FEWER_SAMPLES = 2
_LEAST_WINDOWS, _LEAST_ROWS = 10.0, 32  # smallest image height, in standard deviations of the window and in px


@dataclass(frozen=True)
class ReducedScene:
    """Scene of reduced cost for a confirmation run, as plain data, and descriptions of the differences."""

    plain: Mapping[str, Any]
    changes: tuple[str, ...]


def reduce_scene(scene: Scene, region: str, max_size_px: int | None) -> ReducedScene:
    """Return a scene of reduced cost: cropped images, without negligible defocus and motion blur."""
    look = sample_surface(scene, limited_objects(scene, Limits(), Path()), Path())
    chosen = _chosen(look, region)
    plain, changes = scene.to_dict(), list[str]()
    cut = _cut(scene, look, chosen, max_size_px)
    if cut:
        plain["camera"] |= cut
        camera = scene.camera
        changes.append(f"images cropped from {camera.width} x {camera.height} to {cut['width']} x {cut['height']} px")
    changes += _focus(scene, plain, look.depth_mm[chosen])
    if scene.shutter.exposure_time_s > 0:
        flow = compute_flow(look)[chosen]
        moved = compute_blur_px(scene, look.depth_mm[chosen], flow.copy())
        most = float(np.hypot(*moved.T).max(initial=0.0))
        if most < _LITTLE_MOTION_PX:
            plain["shutter"]["exposure_time_s"] = 0.0
            changes.append(f"motion blur omitted ({_at_most_px(most)})")
    return ReducedScene(plain, tuple(changes))


def _at_most_px(most: float) -> str:
    return f"at most {format_two_digits(most)} px" if most >= _VISIBLE_PX else f"below {_VISIBLE_PX:g} px"


def _focus(scene: Scene, plain: dict[str, Any], depth_mm: NDArray[np.float64]) -> list[str]:
    """Replace the defocus of a scene by a cheaper equivalent, in place; return descriptions of the changes."""
    defocus, psf = scene.optics.defocus, scene.optics.psf
    if defocus is None:
        return []
    discs = defocus.blur_diameter_px(depth_mm, scene.camera.focal_px)
    most = float(discs.max(initial=0.0))
    if most < _LITTLE_DISC_PX:
        plain["optics"]["defocus"] = None
        return [f"defocus blur omitted ({_at_most_px(most)})"]
    if most < _SMALL_DISC_PX and not isinstance(psf, AiryPsf):
        # The standard deviation of a disc along each axis is a quarter of its diameter.
        sigma = math.hypot(0.0 if psf is None else psf.sigma_px, float(np.sqrt(np.mean(discs**2))) / 4)
        plain["optics"] |= {"defocus": None, "psf": {"kind": "gaussian", "sigma_px": sigma}}
        return [f"defocus blur ({_at_most_px(most)}) included in the point spread function"]
    plain["optics"]["defocus"]["samples"] = min(_SAMPLES, defocus.samples)
    plain["render"]["supersampling"] = min(_FEWER_SAMPLES, scene.render.samples)
    few = plain["optics"]["defocus"]["samples"]
    return [f"{few} aperture samples instead of {defocus.samples}"] if few < defocus.samples else []


def _chosen(look: SurfaceSamples, region: str) -> NDArray[np.bool_]:
    name = region.removeprefix("object_")
    if region.startswith("object_") and name in look.names:
        own = look.body == look.names.index(name)
        if own.any():
            return np.asarray(own)
    return np.ones(len(look), dtype=np.bool_)


def _cut(scene: Scene, look: SurfaceSamples, chosen: NDArray[np.bool_], max_size_px: int | None) -> dict[str, Any]:
    """Return the camera fields for images cropped to the centre of a region; empty without cropping."""
    camera = scene.camera
    longer = max(camera.width, camera.height)
    if max_size_px is None or longer <= max_size_px:
        return {}
    width, height = (side * max_size_px / longer for side in (camera.width, camera.height))
    places = scene.stage.x_mm
    # The centre must be visible from all positions: added columns are compensated by fewer rows.
    wide = width + camera.focal_px * float(np.ptp(places)) / float(np.median(look.depth_mm[chosen]))
    sigma = float(getattr(scene.estimate.settings, "window_sigma_px", 0.0))
    low = min(max(width * height / wide, _LEAST_WINDOWS * sigma, _LEAST_ROWS), max(height, _LEAST_ROWS))
    columns, rows = min(round(wide), camera.width), min(round(low), camera.height)
    # The centre of a curved region may be outside it, so the nearest point of the region is used.
    x, y = look.points.x[chosen], look.points.y[chosen]
    nearest = int(np.argmin((x - np.median(x)) ** 2 + (y - np.median(y)) ** 2))
    c_x, c_y = camera.principal_point
    left = int(np.clip(round(c_x + float(x[nearest]) - columns / 2), 0, camera.width - columns))
    top = int(np.clip(round(c_y + float(y[nearest]) - rows / 2), 0, camera.height - rows))
    return {"width": columns, "height": rows, "principal_point_px": [c_x - left, c_y - top]}


Figures = dict[str, dict[str, float]]
"""Statistics by title of the objective: ``rmse``, ``median_abs_error``, ``p95_abs_error``, ``bias``, ``density``."""

_STATISTICS = ("rmse", "median_abs_error", "p95_abs_error", "bias", "density")


_ALL_UNDEFINED = dict.fromkeys(_STATISTICS, math.nan)
"""Statistics of an objective without valid pixels, which are complete."""


def get_simulated_statistic(figures: Figures | None, title: str, statistic: str) -> float:
    """Return a statistic of an objective from a simulation; NaN where missing."""
    kind = STATISTICS[statistic]
    return kind.factor * (figures or {}).get(title, {}).get(kind.scored, math.nan)


@dataclass(frozen=True)
class ConfirmationTask:
    """Input of a worker for all confirmation runs: scenes as plain data, seeds of each rig, and resource limits."""

    folder: str
    plains: tuple[Mapping[str, Any], ...]
    seeds: tuple[int, ...]
    objectives: tuple[Objective, ...]
    versions: tuple[tuple[str, str], ...]
    limits: Limits | None = None

    def __len__(self) -> int:
        """Return the number of simulations."""
        return len(self.plains) * len(self.seeds)

    def scene(self, number: int) -> Scene:
        """Return the scene of a simulation."""
        rig, seed = divmod(number, len(self.seeds))
        return Scene.from_dict({**self.plains[rig], "seed": self.seeds[seed]})

    def key(self, number: int) -> str:
        """Return a hash of all inputs of a simulation."""
        scene = self.scene(number)
        depends: dict[str, Any] = {
            "scene": scene_hash(scene),
            "score": scene.score.model_dump(mode="json"),
            "method": scene.estimate.model_dump(mode="json"),
            "objectives": [(one.quantity, one.region, one.title) for one in self.objectives],
            "versions": self.versions,
        }
        return compute_key(depends)

    @property
    def store(self) -> ResultStore:
        """Results of the simulations by key."""
        return ResultStore(Path(self.folder), "run the optimisation again")

    def figures(self, number: int) -> Figures | None:
        """Return the statistics of a simulation; None if it is missing or lacks a required statistic."""
        key = self.key(number)
        plain = self.store.find(key, key)
        if plain is None:
            return None
        figures: Figures = plain["figures"]
        lacking = [
            one
            for one in self.objectives
            if STATISTICS[one.statistic].scored not in figures.get(one.title, _ALL_UNDEFINED)
        ]
        return None if lacking else figures


def simulate_objectives(scene: Scene, objectives: tuple[Objective, ...], limits: Limits | None = None) -> Figures:
    """Simulate a scene, run its method and score the estimate."""
    with ignore_scene_warnings():
        content: TruthMaps = "complete" if _is_further(objectives) else "standard"
        recording, truth = simulate(scene, truth_content=content, limits=limits)
        maps = estimate(recording, scene.estimate.method, scene.estimate.settings.model_dump())
        found = score(maps, truth, settings=scene.score)
    figures: Figures = {}
    # Scores have regions of objects only for several objects; the interior is that of a single object.
    alone = len(scene.parts) == 1
    for one in objectives:
        region = "interior" if alone and one.region.startswith("object_") else one.region
        entries = found.regions.get(region, {}).get(one.quantity, {})
        values = {name: float(value) for name in _STATISTICS if (value := entries.get(name)) is not None}
        if "rmse" in values:
            figures[one.title] = values
    return figures


def _is_further(objectives: tuple[Objective, ...]) -> bool:
    """Return whether an objective requires the complete truth."""
    variables = {QUANTITIES[one.quantity].variable for one in objectives}
    return not variables <= _STANDARD


_STANDARD = frozenset(("depth", "disparity", "velocity", "flow", "normal", "growth_rate", ""))
"""Variables of the standard truth; windowed growth (empty name) is derived from them."""


def simulate_candidate(job: ConfirmationTask, number: int) -> TaskResult:
    """Run and score one simulation; an exception is returned as part of the result."""
    rig, seed = divmod(number, len(job.seeds))

    def work() -> dict[str, Any]:
        found = simulate_objectives(job.scene(number), job.objectives, job.limits)
        key = job.key(number)
        job.store.write(key, key, {"figures": found})
        return {"simulation": number}

    label = f"simulated rig {rig + 1}, seed {job.seeds[seed]}"
    return perform_task(number, work, label=label, versions=job.versions)


_LARGEST_SEED = 2**63 - 1


@dataclass(frozen=True)
class ConfirmationResult:
    """Simulated rigs by number, comparison with the predictions, and changes of the simulated scenes."""

    rigs: Mapping[int, RigDesign]
    discrepancies: tuple[Discrepancy, ...]
    changes: tuple[str, ...]


def simulate_candidates(
    rigs: Sequence[RigDesign],
    prepared: OptimisationProblem,
    confirm: ConfirmationSpec,
    folder: Path,
    workers: int = 1,
    *,
    scheduler: str | None = None,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
    limits: Limits | None = None,
) -> ConfirmationResult:
    """Simulate rigs with several seeds; existing results are reused."""
    if not rigs:
        return ConfirmationResult({}, (), ())
    task = prepared.task
    light = [reduce_scene(Scene.from_dict(rig.scene), task.objectives[0].region, confirm.max_size_px) for rig in rigs]
    job = ConfirmationTask(
        str((folder / "simulations").resolve()),
        tuple(one.plain for one in light),
        derive_seeds(prepared.scene.seed, confirm.seeds),
        task.objectives,
        tuple(sorted(collect_versions().items())),
        limits,
    )
    missing = [number for number in range(len(job)) if job.figures(number) is None]
    for_each(
        missing,
        simulate_candidate,
        (job,),
        present=len(job) - len(missing),
        workers=workers,
        scheduler=scheduler,
        what="simulations",
        progress=progress,
        notice=notice,
    )
    found: dict[int, RigDesign] = {}
    discrepancies: list[Discrepancy] = []
    for place, rig in enumerate(rigs):
        each = [job.figures(place * confirm.seeds + number) for number in range(confirm.seeds)]
        entries = replace(rig, figures=_group_by_seed(each, task.objectives))
        intervals = {one.title: compute_rig_interval(entries, one.title, one.statistic) for one in task.objectives}
        found[rig.number] = replace(entries, simulated={title: one for title, one in intervals.items() if one.seeds})
        scene = Scene.from_dict(light[place].plain)
        prediction = predict_scene(scene, task.method)
        for objective in task.objectives:
            parts = compute_objective_contributions(objective, scene, prediction)
            here = sum(value * value for value in parts.values()) ** 0.5
            simulated = found[rig.number].simulated.get(objective.title, compute_prediction_interval([]))
            discrepancies.append(compare_with_prediction(rig.number, objective, here, simulated))
    changes = tuple(dict.fromkeys(change for one in light for change in one.changes))
    return ConfirmationResult(found, tuple(discrepancies), changes)


def derive_seeds(seed: int, count: int) -> tuple[int, ...]:
    """Return the seeds of the simulations, which follow the seed of the scene."""
    return tuple((seed + 1 + number) % (_LARGEST_SEED + 1) for number in range(count))


def _group_by_seed(
    each: Sequence[Figures | None], objectives: Sequence[Objective]
) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return all statistics by title of the objective, one value for each seed."""
    entries = {
        one.title: {
            name: tuple(get_simulated_statistic(figures, one.title, name) for figures in each) for name in STATISTICS
        }
        for one in objectives
    }
    for title, figures_of in entries.items():
        figures_of["density"] = tuple((one or {}).get(title, {}).get("density", math.nan) for one in each)
    return entries


_LEVEL = 0.975


def check_rank_consistency(rigs: Sequence[RigDesign], objectives: Sequence[Objective]) -> tuple[RankConsistency, ...]:
    """Return the rank consistency of all pairs of simulated rigs, for each objective."""
    found = [
        check_pair_rank(one, other, objective)
        for objective in objectives
        for one, other in combinations([rig for rig in rigs if objective.title in rig.simulated], 2)
        if one.predicted[objective.title] != other.predicted[objective.title]
    ]
    return tuple(found)


def check_pair_rank(one: RigDesign, other: RigDesign, objective: Objective) -> RankConsistency:
    """Compare the simulated rank of two rigs with the predicted rank.

    The same seed gives all rigs the same texture and the same random streams of noise and stage errors, so that common
    effects cancel in the differences of logarithms. The confidence interval of the mean difference is ± t s / √n, with
    Student's t for n - 1 degrees of freedom and the standard deviation s of the differences.
    """
    from scipy.special import stdtrit

    title = objective.title
    better, worse = sorted((one, other), key=lambda rig: rig.predicted[title])
    figures = [rig.figures.get(title, {}).get(objective.statistic, ()) for rig in (better, worse)]
    pairs = [(a, b) for a, b in zip(*figures, strict=False) if 0 < a < math.inf and 0 < b < math.inf]
    predicted = worse.predicted[title] / better.predicted[title]
    if len(pairs) < 2:
        return RankConsistency(
            title, better.number, worse.number, predicted, math.nan, math.nan, math.nan, len(pairs), _UNDECIDED
        )
    logs = np.log([b / a for a, b in pairs])
    middle = float(logs.mean())
    half = float(stdtrit(len(logs) - 1, _LEVEL) * logs.std(ddof=1) / math.sqrt(len(logs)))
    verdict = "kept" if middle > half else "swapped" if middle < -half else _UNDECIDED
    low, factor, high = (math.exp(min(each, 700.0)) for each in (middle - half, middle, middle + half))
    return RankConsistency(title, better.number, worse.number, predicted, factor, low, high, len(logs), verdict)


def find_indistinct(best: RigDesign, rigs: Sequence[RigDesign], objectives: Sequence[Objective]) -> list[RigDesign]:
    """Return a rig and those whose simulations differ from its own in no objective beyond the scatter of seeds."""
    found = []
    for one in rigs:
        pairs = [check_pair_rank(best, one, objective) for objective in objectives]
        if one is best or all(pair.verdict == _UNDECIDED and math.isfinite(pair.simulated) for pair in pairs):
            found.append(one)
    return found


_UNDECIDED = "undecided"
