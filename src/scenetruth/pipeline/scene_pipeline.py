"""The pipeline of a scene: recording and truth, estimates, scores and reports, in a run directory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scenetruth.compilation import announced_compilation
from scenetruth.errors import Problem, SceneError
from scenetruth.estimators import MethodChoice
from scenetruth.estimators.method_specs import MethodLike, offered_methods, read_methods
from scenetruth.pipeline.figure_worker import FigureWorker, open_figure_worker
from scenetruth.pipeline.preflight import compute_method_workload, method_choices, run_problems
from scenetruth.pipeline.run_directory import RunDirectory
from scenetruth.pipeline.runner import PipelineRunner, RunResult
from scenetruth.progress import Progress
from scenetruth.provenance import own_release, scene_hash
from scenetruth.resources import (
    Limits,
    compute_workload,
    estimate_cost,
    inspect_machine,
    limited_objects,
    refuse_resources,
)
from scenetruth.scene import Overrides, Scene, SceneLike, load_scene
from scenetruth.schema import digest

if TYPE_CHECKING:
    from scenetruth.truth import TruthMaps, TruthPoses, TruthViews

__all__ = ["STAGES", "RunStage", "run_scene"]

RunStage = Literal["render", "estimate", "score", "report"]
STAGES: tuple[RunStage, ...] = ("render", "estimate", "score", "report")
"""All stages in their order."""


def run_scene(
    scene: SceneLike,
    folder: str | Path,
    *,
    stages: Sequence[RunStage] = STAGES,
    methods: MethodLike | Sequence[MethodLike] | None = None,
    overrides: Overrides = (),
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "real",
    truth_content: TruthMaps = "standard",
    save_radiance: bool = False,
    images: Literal["png", "tiff"] | None = None,
    overwrite: bool = False,
    limits: Limits | None = None,
    check: bool = True,
    figures: Collection[str] | None = None,
    figures_also: Collection[str] = (),
    helpers: int | FigureWorker = 0,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> RunResult:
    """Take a scene through all stages, or some: render, estimate, score, report.

    What one stage has finished stays if a later one fails or is interrupted; the same call goes on from there. A
    method that fails keeps no other from its work.

    Parameters
    ----------
    scene
        The scene, its values, its file, or the name of one that is shipped.
    folder
        Where the results go.
    stages
        Which stages; without ``"render"``, the recording and the truth of an earlier run are taken from the folder.
    methods
        Methods of estimation: names, functions, or `scenetruth.estimators.MethodSpec` with settings; the scene's if
        not given. The scene's own method has the scene's settings, others have their defaults.
    overrides
        Changes of the scene, as of `load_scene`.
    truth_views, truth_poses, truth_content, save_radiance
        As of `simulate`.
    images
        Whether to write the images as files too, as 16-bit PNG or float TIFF.
    overwrite
        Whether results that exist may be replaced.
    limits
        Bounds of what the scene may ask for and take (`scenetruth.Limits`); those by default if not given.
    check
        Whether to refuse a folder that holds another scene's recording.
    figures
        Names of the figures of the report (`scenetruth.scoring.FIGURES`); all if not given.
    figures_also
        Formats that figures are written in beside PNG: ``"pdf"``, vectors for print.
    helpers
        Further processes to compile and to draw figures: none, or one, or one that runs already.
    progress
        Called with (what, done, total) as the work goes on.
    notice
        Called with lines that a user may want to read, such as the backend that rendered.

    Returns
    -------
    RunResults
        Scores by method, and what went wrong.

    Raises
    ------
    SceneError
        If the scene cannot be made, passes a bound, or a method cannot estimate its recording; before any work.
    MachineError
        If more memory, disk space or time is foreseen than the machine has, or than is allowed; before any work.
    EstimateError
        If there is no such method; before any work.
    OutputExistsError
        If results exist that may not be replaced; before any work.
    MismatchError
        If the folder holds another scene's recording.

    See Also
    --------
    simulate, estimate, score, write_report : The stages one by one, in memory.
    RunDirectory : Which file of the folder is what.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 60, "height": 50, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> with TemporaryDirectory() as folder:
    ...     results = run_scene(st.Scene.from_dict(plain), f"{folder}/wall", stages=("render", "estimate", "score"))
    ...     print(*sorted(path.name for path in results.folder.path.iterdir()))
    estimate.zarr recording.zarr scene.yaml score.csv score.json truth.zarr
    >>> error = results.scores["structure_tensor"].regions["interior"]["depth"]
    >>> error["count"] > 50, error["relative_rms"] < 0.02, results.failures
    (True, True, {})
    """
    from scenetruth.truth import TruthOptions, refuse_arguments

    refuse_arguments(scene, truth_views, truth_poses, truth_content, progress)
    scene = load_scene(scene, overrides=overrides)
    _refuse_unknown_figures(figures)
    unknown = [stage for stage in stages if stage not in STAGES]
    if unknown:
        raise SceneError([Problem("stages", f"must be some of {', '.join(STAGES)}", unknown)])
    specs = read_methods(methods) if methods else []
    choices = method_choices(scene, specs)
    # A scene names no code: module:function stays beside its own method.
    if scene.estimate.method not in [choice.method for choice in choices] and ":" not in choices[0].method:
        scene = scene.model_copy(update={"estimate": choices[0]})
    if "estimate" in stages:
        problems = run_problems(scene, choices)
        if problems:
            raise SceneError(problems)
    allowed = limits or Limits()
    if "render" in stages:
        demand = compute_workload(
            scene,
            limited_objects(scene, allowed),
            views=scene.stage.positions * scene.stage.rows if truth_views == "all" else 1,
            complete=truth_content == "complete",
            save_radiance=save_radiance,
        )
        demand = replace(demand, effort=compute_method_workload(choices))
        refuse_resources(estimate_cost(demand, stages), inspect_machine(Path(folder)), allowed)
    truth = TruthOptions(truth_views, truth_poses, truth_content)
    asked = None
    if "render" in stages and len(stages) > 1:
        of_methods = [choice.model_dump(mode="json") for choice in choices]
        rest = [list(stages), truth_views, truth_poses, truth_content, save_radiance, images]
        drawn = [None if figures is None else sorted(figures), sorted(figures_also)]
        asked = digest([own_release(), scene.model_dump(mode="json"), scene_hash(scene), of_methods, rest, drawn])
    with (
        offered_methods(specs),
        open_figure_worker(helpers if "report" in stages else 0) as helper,
        _compiling_in_parallel(helper, scene, choices if {"render", "estimate"} <= set(stages) else ()),
        PipelineRunner(
            RunDirectory(folder, scene.estimate.method),
            overwrite=overwrite,
            check=check,
            progress=progress,
            notice=notice,
            helper=helper,
            limits=allowed,
            asked=asked,
        ) as runner,
    ):
        if "render" in stages:
            runner.render(scene, truth, save_radiance=save_radiance, images=images)
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
    """Let a second process compile if this one is seen to compile, which is the first run on a machine.

    First the methods, then what this process comes to just before them.
    """
    from scenetruth.camera.sensor import build_sensor_chain
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
        # Told at once: what renders takes seconds to load before it comes to anything that is compiled.
        probe_kernel()
        yield


def _refuse_unknown_figures(figures: Collection[str] | None) -> None:
    if not figures:
        # Rendering need not wait for what draws.
        return
    from scenetruth.scoring import FIGURES

    unknown = sorted(set(figures) - set(FIGURES))
    if unknown:
        raise SceneError([Problem("figures", f"must be some of {', '.join(FIGURES)}", unknown)])
