"""Pipeline of a scene: recording and truth, estimates, scores and reports, in a run directory."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scenetruth.camera import build_sensor_chain
from scenetruth.compilation import announced_compilation
from scenetruth.errors import ArgumentError, Problem, SceneError
from scenetruth.estimators import MethodChoice
from scenetruth.estimators.method_specs import MethodLike, MethodSpec, offered_methods, read_methods
from scenetruth.pipeline.figure_worker import FigureWorker, open_figure_worker
from scenetruth.pipeline.preflight import compute_method_workload, method_choices, run_problems
from scenetruth.pipeline.run_directory import RunDirectory
from scenetruth.pipeline.runner import PipelineRunner, RunResult
from scenetruth.progress import Progress
from scenetruth.provenance import own_release, scene_hash
from scenetruth.resources import (
    Forecast,
    Limits,
    ObjectWorkload,
    compute_workload,
    estimate_cost,
    inspect_machine,
    limited_objects,
    load_checked_scene,
    refuse_resources,
)
from scenetruth.scene import Overrides, Scene, SceneLike
from scenetruth.schema import digest

if TYPE_CHECKING:
    from scenetruth.truth import TruthMaps, TruthOptions, TruthPoses, TruthViews

__all__ = ["STAGES", "RunStage", "estimate_run_cost", "run_pipeline", "run_scene"]

RunStage = Literal["render", "estimate", "score", "report"]
STAGES: tuple[RunStage, ...] = ("render", "estimate", "score", "report")
"""All stages in order."""


def estimate_run_cost(scene: Scene, parts: Sequence[ObjectWorkload]) -> Forecast:
    """Return the cost of a run of a scene on this machine: all images, all stages, the scene's own method."""
    demand = replace(compute_workload(scene, parts), effort=compute_method_workload([scene.estimate]))
    return estimate_cost(demand, STAGES)


def run_scene(
    scene: SceneLike,
    *,
    methods: MethodLike | Sequence[MethodLike] | None = None,
    stages: Sequence[RunStage] = STAGES,
    overrides: Overrides = (),
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "actual",
    truth_content: TruthMaps = "standard",
    save_radiance: bool = False,
    save_images: Literal["png", "tiff"] | None = None,
    limits: Limits | None = None,
    output: str | Path,
    overwrite: bool = False,
    allow_mismatch: bool = False,
    figures: Collection[str] | None = None,
    progress: Progress | None = None,
) -> RunResult:
    """Run all or selected stages of a scene: render, estimate, score, report.

    Results of completed stages are kept if a later stage fails or is interrupted; the same call resumes the run. Other
    methods continue if one fails.

    Parameters
    ----------
    scene
        The scene, its values, its file, or the name of a bundled scene.
    methods
        Methods of estimation: names, functions, or `scenetruth.estimators.MethodSpec` with settings; default: the
        method of the scene. The settings of the scene apply to its own method, defaults to others.
    stages
        Stages to run; without ``"render"``, recording and truth of an earlier run are used.
    overrides
        Changed fields of the scene, as for `load_scene`.
    truth_views, truth_poses, truth_content, save_radiance
        As for `simulate`.
    save_images
        Whether to write image files too, as 16-bit PNG or float TIFF.
    limits
        Resource limits (`scenetruth.Limits`); the default limits if not given.
    output
        Run directory.
    overwrite
        Whether existing results may be replaced.
    allow_mismatch
        Whether the directory may contain the recording of another scene.
    figures
        Names of the figures of the report (`scenetruth.scoring.FIGURES`); default: all.
    progress
        Called with (what, done, total).

    Returns
    -------
    RunResults
        Scores by method, and failures.

    Raises
    ------
    ArgumentError
        If arguments are invalid; lists every problem.
    SceneError
        If the scene is invalid, exceeds a limit, or a method cannot estimate its recording; raised before any work.
    MachineError
        If the predicted memory, disk space or time exceeds the machine or the limits; raised before any work.
    EstimateError
        If a method is unknown; raised before any work.
    OutputExistsError
        If existing results may not be replaced; raised before any work.
    MismatchError
        If the directory contains the recording of another scene.

    See Also
    --------
    simulate, estimate, score, write_report : The single stages, in memory.
    RunDirectory : Names of the files.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 60, "height": 50, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> with TemporaryDirectory() as folder:
    ...     results = run_scene(plain, stages=("render", "estimate", "score"), output=f"{folder}/wall")
    ...     print(*sorted(path.name for path in results.folder.path.iterdir()))
    estimate.zarr recording.zarr scene.yaml score.csv score.json truth.zarr
    >>> error = results.scores["structure_tensor"].regions["interior"]["depth"]
    >>> error["count"] > 50, error["relative_rmse"] < 0.02, results.failures
    (True, True, {})
    """
    return run_pipeline(
        scene,
        output,
        methods=methods,
        stages=stages,
        overrides=overrides,
        truth=(truth_views, truth_poses, truth_content),
        save_radiance=save_radiance,
        save_images=save_images,
        limits=limits,
        overwrite=overwrite,
        allow_mismatch=allow_mismatch,
        figures=figures,
        progress=progress,
    )


def run_pipeline(
    scene: SceneLike,
    output: str | Path,
    *,
    methods: MethodLike | Sequence[MethodLike] | None = None,
    stages: Sequence[RunStage] = STAGES,
    overrides: Overrides = (),
    truth: tuple[TruthViews, TruthPoses, TruthMaps] = ("reference", "actual", "standard"),
    save_radiance: bool = False,
    save_images: Literal["png", "tiff"] | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
    allow_mismatch: bool = False,
    figures: Collection[str] | None = None,
    figure_formats: Sequence[str] = ("png",),
    helpers: int | FigureWorker = 0,
    progress: Progress | None = None,
) -> RunResult:
    """Run stages as in `run_scene`, for the command line, with a second process."""
    from scenetruth.truth import TruthOptions, refuse_arguments

    refuse_arguments(scene, *truth, progress)
    specs = read_methods(methods) if methods else []
    with offered_methods(specs):
        allowed = (limits or Limits()) if "render" in stages else None
        loaded = load_checked_scene(scene, overrides=overrides, limits=allowed)
        return _run_stages(
            loaded,
            Path(output),
            specs,
            stages=stages,
            truth=TruthOptions(*truth),
            save_radiance=save_radiance,
            save_images=save_images,
            allowed=limits or Limits(),
            overwrite=overwrite,
            allow_mismatch=allow_mismatch,
            figures=figures,
            figures_also=tuple(one for one in figure_formats if one != "png"),
            helpers=helpers,
            progress=progress,
        )


def _run_stages(
    scene: Scene,
    output: Path,
    specs: Sequence[MethodSpec],
    *,
    stages: Sequence[RunStage],
    truth: TruthOptions,
    save_radiance: bool,
    save_images: Literal["png", "tiff"] | None,
    allowed: Limits,
    overwrite: bool,
    allow_mismatch: bool,
    figures: Collection[str] | None,
    figures_also: Sequence[str],
    helpers: int | FigureWorker,
    progress: Progress | None,
) -> RunResult:
    _refuse_unknown_figures(figures)
    unknown = [stage for stage in stages if stage not in STAGES]
    if unknown:
        raise ArgumentError([Problem("stages", f"must be some of {', '.join(STAGES)}", unknown)])
    if save_images == "png" and build_sensor_chain(scene.sensor).channels(scene.camera.bands):
        message = "must be tiff for a camera with bands: only grey images are written as 16-bit PNG"
        raise ArgumentError([Problem("save_images", message, save_images)])
    choices = method_choices(scene, specs)
    # A scene cannot name code: module:function is valid next to the method of the scene only.
    is_named = not specs or (isinstance(specs[0].method, str) and ":" not in specs[0].method)
    if scene.estimate.method not in [choice.method for choice in choices] and is_named:
        scene = scene.model_copy(update={"estimate": choices[0]})
    if "estimate" in stages:
        problems = run_problems(scene, choices)
        if problems:
            raise SceneError(problems)
    if "render" in stages:
        demand = compute_workload(
            scene,
            limited_objects(scene, allowed),
            views=scene.stage.positions * scene.stage.rows if truth.views == "all" else 1,
            complete=truth.content != "standard",
            save_radiance=save_radiance,
        )
        demand = replace(demand, effort=compute_method_workload(choices))
        refuse_resources(estimate_cost(demand, stages), inspect_machine(output), allowed)
    asked = None
    if "render" in stages and len(stages) > 1:
        of_methods = [choice.model_dump(mode="json") for choice in choices]
        rest = [list(stages), truth.views, truth.poses, truth.content, save_radiance, save_images]
        drawn = [None if figures is None else sorted(figures), sorted(figures_also)]
        own_code = [one.fingerprint for one in specs if one.fingerprint]
        asked = digest(
            [own_release(), scene.model_dump(mode="json"), scene_hash(scene), of_methods, rest, drawn, *own_code]
        )
    with (
        open_figure_worker(helpers if "report" in stages else 0) as helper,
        _compiling_in_parallel(helper, scene, choices if {"render", "estimate"} <= set(stages) else ()),
        PipelineRunner(
            RunDirectory(output, scene.estimate.method),
            overwrite=overwrite,
            check=not allow_mismatch,
            progress=progress,
            helper=helper,
            limits=allowed,
            asked=asked,
        ) as runner,
    ):
        if "render" in stages:
            runner.render(scene, truth, save_radiance=save_radiance, images=save_images)
        else:
            runner.check_scene(scene)
        for choice in choices:
            with runner.keeping_failures(choice.method):
                if "estimate" in stages:
                    runner.estimate(choice)
                if "score" in stages:
                    runner.score(choice.method, scene.score)
                if "report" in stages:
                    runner.report(choice.method, figures, figures_also)
        if asked is not None and not runner.failures:
            runner.finish()
    return runner.results()


@contextmanager
def _compiling_in_parallel(
    helper: FigureWorker | None, scene: Scene, choices: Sequence[MethodChoice]
) -> Iterator[None]:
    """Compile in a second process if this process compiles: methods first, then kernels just before their use."""
    from scenetruth.pipeline.compile_probe_kernels import probe_kernel

    if helper is None or not choices:
        yield
        return

    def begin(name: str, before: int) -> None:
        if before == 0:
            for choice in choices:
                helper.compile_method(choice, build_sensor_chain(scene.sensor).dtype.name)
            helper.compile_last_of_truth()

    with announced_compilation(begin):
        # Reported before the renderer is loaded, which takes seconds.
        probe_kernel()
        yield


def _refuse_unknown_figures(figures: Collection[str] | None) -> None:
    if not figures:
        # Rendering does not wait for the plotting libraries.
        return
    from scenetruth.scoring import FIGURES

    unknown = sorted(set(figures) - set(FIGURES))
    if unknown:
        raise ArgumentError([Problem("figures", f"must be some of {', '.join(FIGURES)}", unknown)])
