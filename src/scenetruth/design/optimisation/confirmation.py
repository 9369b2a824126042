"""Confirmation runs.

Selected candidates simulated with several seeds, compared with their predictions and with each other.
"""

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
from scenetruth.progress import Progress
from scenetruth.provenance import scene_hash
from scenetruth.resources import Limits, limited_objects
from scenetruth.scene import Scene
from scenetruth.scoring import QUANTITIES, score
from scenetruth.simulation import simulate

__all__ = [
    "ConfirmationResult",
    "ConfirmationTask",
    "ReducedScene",
    "check_pair_rank",
    "check_rank_consistency",
    "compare_with_prediction",
    "get_simulated_statistic",
    "reduce_scene",
    "simulate_candidate",
    "simulate_candidates",
    "simulate_objectives",
]


_NOTABLE_FACTOR = 1.3
"""Envelopes are within 30 % of measured scatter in the median: by more than this factor, a difference is notable."""


def compare_with_prediction(
    rig: int, objective: Objective, predicted: float, simulated: PredictionInterval
) -> Discrepancy:
    """Return prediction and simulation of one objective at one rig."""
    ratio = simulated.value / predicted if predicted > 0 and math.isfinite(predicted) else math.nan
    if not math.isfinite(ratio):
        says = f"{objective.title}: nothing was estimated in the simulations, where {predicted:.3g} was predicted"
        return Discrepancy(rig, objective.title, predicted, simulated, math.nan, True, says)
    inside = math.isnan(simulated.pi_low) or simulated.pi_low <= predicted <= simulated.pi_high
    notable = not 1 / _NOTABLE_FACTOR <= ratio <= _NOTABLE_FACTOR and not (inside and simulated.seeds > 1)
    told = f"{objective.title}: {objective.told_in} simulated {simulated.value:.3g}, "
    told += f"predicted of these images {predicted:.3g} {objective.unit}"
    if not notable:
        says = f"{told}: as far as {simulated.seeds} seeds tell, they agree (factor {ratio:.2f})"
    elif ratio > 1:
        says = f"{told}: {ratio:.1f} times the prediction, which knows noise and the stage but no bias of the method"
    else:
        says = f"{told}: {ratio:.2f} of the prediction"
    return Discrepancy(rig, objective.title, predicted, simulated, ratio, notable, says)


_LITTLE_DISC_PX, _SMALL_DISC_PX, _LITTLE_MOTION_PX = 0.3, 2.0, 0.1
"""A disc of 0.3 px takes 0.7 % of the contrast of a wave of 4 px; a motion of 0.1 px takes 0.1 %."""
_SAMPLES = 12
_FEWER_SAMPLES = 2
_LEAST_WINDOWS, _LEAST_ROWS = 10.0, 32
"""Rows that are left: standard deviations of the window, and px."""


@dataclass(frozen=True)
class ReducedScene:
    """What is simulated instead of a rig's scene.

    ``plain``: The scene as plain values.
    ``changes``: What is different, in words.
    """

    plain: Mapping[str, Any]
    changes: tuple[str, ...]


def reduce_scene(scene: Scene, region: str, max_size_px: int | None) -> ReducedScene:
    """Return what is simulated of a scene."""
    look = sample_surface(scene, limited_objects(scene, Limits(), Path()), Path())
    chosen = _chosen(look, region)
    plain, changes = scene.to_dict(), list[str]()
    cut = _cut(scene, look, chosen, max_size_px)
    if cut:
        plain["camera"] |= cut
        camera = scene.camera
        changes.append(f"images cut from {camera.width} x {camera.height} to {cut['width']} x {cut['height']} px")
    changes += _focus(scene, plain, look.depth_mm[chosen])
    if scene.shutter.exposure_time_s > 0:
        flow = compute_flow(look)[chosen]
        moved = compute_blur_px(scene, look.depth_mm[chosen], flow.copy())
        most = float(np.hypot(*moved.T).max(initial=0.0))
        if most < _LITTLE_MOTION_PX:
            plain["shutter"]["exposure_time_s"] = 0.0
            changes.append(f"motion while images are exposed left out, {most:.2g} px at most")
    return ReducedScene(plain, tuple(changes))


def _focus(scene: Scene, plain: dict[str, Any], depth_mm: NDArray[np.float64]) -> list[str]:
    """Put what is out of focus in a form that takes less time, in place; return what that was."""
    defocus, psf = scene.optics.defocus, scene.optics.psf
    if defocus is None:
        return []
    discs = defocus.blur_diameter_px(depth_mm, scene.camera.focal_px)
    most = float(discs.max(initial=0.0))
    if most < _LITTLE_DISC_PX:
        plain["optics"]["defocus"] = None
        return [f"blur out of focus left out, {most:.2g} px at most"]
    if most < _SMALL_DISC_PX and not isinstance(psf, AiryPsf):
        # A disc has a quarter of its diameter as standard deviation along each axis.
        sigma = math.hypot(0.0 if psf is None else psf.sigma_px, float(np.sqrt(np.mean(discs**2))) / 4)
        plain["optics"] |= {"defocus": None, "psf": {"kind": "gaussian", "sigma_px": sigma}}
        return [f"blur out of focus, {most:.2g} px at most, made a part of the point spread"]
    plain["optics"]["defocus"]["samples"] = min(_SAMPLES, defocus.samples)
    plain["render"]["supersampling"] = min(_FEWER_SAMPLES, scene.render.supersampling)
    few = plain["optics"]["defocus"]["samples"]
    return [f"{few} samples of the aperture, not {defocus.samples}"] if few < defocus.samples else []


def _chosen(look: SurfaceSamples, region: str) -> NDArray[np.bool_]:
    name = region.removeprefix("object_")
    if region.startswith("object_") and name in look.names:
        own = look.body == look.names.index(name)
        if own.any():
            return np.asarray(own)
    return np.ones(len(look), dtype=np.bool_)


def _cut(scene: Scene, look: SurfaceSamples, chosen: NDArray[np.bool_], max_size_px: int | None) -> dict[str, Any]:
    """Return the fields of a camera that sees the middle of a region only; nothing if it sees no less."""
    camera = scene.camera
    longer = max(camera.width, camera.height)
    if max_size_px is None or longer <= max_size_px:
        return {}
    width, height = (side * max_size_px / longer for side in (camera.width, camera.height))
    places = scene.stage.x_mm
    # What is in the middle must be seen from all positions; as many rows are left out as columns are added.
    wide = width + camera.focal_px * float(np.ptp(places)) / float(np.median(look.depth_mm[chosen]))
    sigma = float(getattr(scene.estimate.settings, "window_sigma_px", 0.0))
    low = min(max(width * height / wide, _LEAST_WINDOWS * sigma, _LEAST_ROWS), max(height, _LEAST_ROWS))
    columns, rows = min(round(wide), camera.width), min(round(low), camera.height)
    # The middle of what is bent may lie beside it: the point next to it does not.
    x, y = look.points.x[chosen], look.points.y[chosen]
    nearest = int(np.argmin((x - np.median(x)) ** 2 + (y - np.median(y)) ** 2))
    c_x, c_y = camera.principal_point
    left = int(np.clip(round(c_x + float(x[nearest]) - columns / 2), 0, camera.width - columns))
    top = int(np.clip(round(c_y + float(y[nearest]) - rows / 2), 0, camera.height - rows))
    return {"width": columns, "height": rows, "principal_point_px": [c_x - left, c_y - top]}


Figures = dict[str, dict[str, float]]
"""Scores by objective's title: ``rmse``, ``median_abs_error``, ``p95_abs_error``, ``bias``, ``density``."""

_STATISTICS = ("rmse", "median_abs_error", "p95_abs_error", "bias", "density")


_ALL_UNDEFINED = dict.fromkeys(_STATISTICS, math.nan)
"""Nothing was told: nothing is lacking."""


def get_simulated_statistic(figures: Figures | None, title: str, statistic: str) -> float:
    """Return the figure of an objective's simulation; NaN where there is none."""
    kind = STATISTICS[statistic]
    return kind.factor * (figures or {}).get(title, {}).get(kind.scored, math.nan)


@dataclass(frozen=True)
class ConfirmationTask:
    """All that a worker needs to simulate any rig with any seed.

    ``folder``: Where figures go.
    ``plains``: Scenes of the rigs.
    ``seeds``: Seeds of each.
    ``objectives``: What is measured.
    ``versions``: What figures depend on besides.
    """

    folder: str
    plains: tuple[Mapping[str, Any], ...]
    seeds: tuple[int, ...]
    objectives: tuple[Objective, ...]
    versions: tuple[tuple[str, str], ...]

    def __len__(self) -> int:
        """Return how many simulations there are."""
        return len(self.plains) * len(self.seeds)

    def scene(self, number: int) -> Scene:
        """Return the scene of a simulation."""
        rig, seed = divmod(number, len(self.seeds))
        return Scene.from_dict({**self.plains[rig], "seed": self.seeds[seed]})

    def key(self, number: int) -> str:
        """Return a hash of all that its figures depend on."""
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
        """The results of simulations, which are named by their keys."""
        return ResultStore(Path(self.folder), "design again")

    def figures(self, number: int) -> Figures | None:
        """Return the figures of a simulation; None if it is not made, or lacks a statistic that is wanted."""
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


def simulate_objectives(scene: Scene, objectives: tuple[Objective, ...]) -> Figures:
    """Simulate a scene, estimate with its method, and score."""
    with ignore_scene_warnings():
        recording, truth = simulate(scene, truth_content="complete" if _is_further(objectives) else "standard")
        maps = estimate(recording, scene.estimate.method, scene.estimate.settings.model_dump())
        found = score(maps, truth, settings=scene.score)
    figures: Figures = {}
    # Scores name single objects only where there are several: the interior is that of the only one.
    alone = len(scene.parts) == 1
    for one in objectives:
        region = "interior" if alone and one.region.startswith("object_") else one.region
        told = found.regions.get(region, {}).get(one.quantity, {})
        values = {name: float(value) for name in _STATISTICS if (value := told.get(name)) is not None}
        if "rmse" in values:
            figures[one.title] = values
    return figures


def _is_further(objectives: tuple[Objective, ...]) -> bool:
    """Whether something is measured that the standard truth does not tell."""
    variables = {QUANTITIES[one.quantity].variable for one in objectives}
    return not variables <= _STANDARD


_STANDARD = frozenset(("depth", "disparity", "velocity", "flow", "normal", "growth_rate", ""))
"""Variables of the standard truth; windowed growth follows from them and has none."""


def simulate_candidate(job: ConfirmationTask, number: int) -> TaskResult:
    """Make one simulation, for whoever works through many: what goes wrong is returned."""
    rig, seed = divmod(number, len(job.seeds))

    def work() -> dict[str, Any]:
        found = simulate_objectives(job.scene(number), job.objectives)
        key = job.key(number)
        job.store.write(key, key, {"figures": found})
        return {"simulation": number}

    label = f"rig {rig + 1} of those that are simulated, seed {job.seeds[seed]}"
    return perform_task(number, work, label=label, versions=job.versions)


_LARGEST_SEED = 2**63 - 1


@dataclass(frozen=True)
class ConfirmationResult:
    """What simulations say.

    ``rigs``: The rigs with their figures, by number.
    ``discrepancies``: Prediction beside simulation.
    ``changes``: What is different in simulations, in words.
    """

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
) -> ConfirmationResult:
    """Simulate rigs with several seeds, in pieces of work that are done once."""
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
        told = replace(rig, figures=_group_by_seed(each, task.objectives))
        intervals = {one.title: compute_rig_interval(told, one.title, one.statistic) for one in task.objectives}
        found[rig.number] = replace(told, simulated={title: one for title, one in intervals.items() if one.seeds})
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
    """Return the seeds of simulations: those that follow the scene's own."""
    return tuple((seed + 1 + number) % (_LARGEST_SEED + 1) for number in range(count))


def _group_by_seed(
    each: Sequence[Figures | None], objectives: Sequence[Objective]
) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return all statistics by objective's title, a figure for each seed."""
    told = {
        one.title: {
            name: tuple(get_simulated_statistic(figures, one.title, name) for figures in each) for name in STATISTICS
        }
        for one in objectives
    }
    for title, figures_of in told.items():
        figures_of["density"] = tuple((one or {}).get(title, {}).get("density", math.nan) for one in each)
    return told


_LEVEL = 0.975


def check_rank_consistency(rigs: Sequence[RigDesign], objectives: Sequence[Objective]) -> tuple[RankConsistency, ...]:
    """Return all pairs of rigs that were simulated, objective by objective."""
    found = [
        check_pair_rank(one, other, objective)
        for objective in objectives
        for one, other in combinations([rig for rig in rigs if objective.title in rig.simulated], 2)
        if one.predicted[objective.title] != other.predicted[objective.title]
    ]
    return tuple(found)


def check_pair_rank(one: RigDesign, other: RigDesign, objective: Objective) -> RankConsistency:
    """Judge a pair of rigs.

    A seed gives all rigs the same texture, and draws noise and errors of the stage from the same streams. What rigs
    have in common goes out of the differences of logarithms. Their mean is known to within t s / √n, with Student's t
    of n - 1 degrees of freedom and their standard deviation s.
    """
    from scipy.special import stdtrit

    title = objective.title
    better, worse = sorted((one, other), key=lambda rig: rig.predicted[title])
    figures = [rig.figures.get(title, {}).get(objective.statistic, ()) for rig in (better, worse)]
    pairs = [(a, b) for a, b in zip(*figures, strict=True) if 0 < a < math.inf and 0 < b < math.inf]
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


_UNDECIDED = "cannot be told"
