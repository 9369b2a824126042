"""The one way through the house: scene, recording and truth, estimates, scores, reports, in a folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
import xarray as xr

from scenetruth.camera import chain_of
from scenetruth.errors import MismatchError, OutputExistsError, Problem, SceneError, ScenetruthError, StoreError
from scenetruth.estimators import MethodChoice, choose, estimate, find_method, requirements
from scenetruth.progress import Progress
from scenetruth.provenance import intrinsics_from, scene_hash
from scenetruth.run_folder import RunFolder
from scenetruth.scene import Scene
from scenetruth.scene.load import apply_overrides
from scenetruth.schema import check_same_run, identity_of, make_recording, scene_of
from scenetruth.storage import load, save, write_aside, write_images

if TYPE_CHECKING:
    from scenetruth.scoring import Score
    from scenetruth.settings import ScoreSettings
    from scenetruth.truth import TruthMaps, TruthPoses, TruthViews

__all__ = ["STAGES", "RunResults", "Runner", "Stage", "method_choices", "run_problems", "run_scene"]

Stage = Literal["render", "estimate", "score", "report"]
T = TypeVar("T")
STAGES: tuple[Stage, ...] = ("render", "estimate", "score", "report")
"""All stages in their order."""


@dataclass(frozen=True)
class RunResults:
    """What a run has made.

    Parameters
    ----------
    folder
        Where everything is.
    scores
        The scores by method.
    failures
        What went wrong, by method; the results of other methods and stages are there all the same.
    timings_s
        Seconds spent on each kind of work.
    """

    folder: RunFolder
    scores: Mapping[str, Score] = field(default_factory=dict)
    failures: Mapping[str, ScenetruthError] = field(default_factory=dict)
    timings_s: Mapping[str, float] = field(default_factory=dict)


def run_scene(
    scene: Scene,
    folder: str | Path,
    *,
    stages: Sequence[Stage] = STAGES,
    methods: Sequence[str | MethodChoice] = (),
    truth_views: TruthViews = "reference",
    truth_poses: TruthPoses = "real",
    truth_content: TruthMaps = "standard",
    ideal: bool = False,
    images: Literal["png", "tiff"] | None = None,
    overwrite: bool = False,
    check: bool = True,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> RunResults:
    """Take a scene through all stages, or some: render, estimate, score, report.

    What one stage has finished stays if a later one fails or is interrupted. A method that fails keeps no other from
    its work.

    Parameters
    ----------
    scene
        The scene; paths in it are absolute, as `load_scene` makes them.
    folder
        Where the results go.
    stages
        Which stages; without ``"render"``, the recording and the truth of an earlier run are taken from the folder.
    methods
        Names of methods of estimation, or methods with their settings; what the scene says if not given. The scene's
        own method has the scene's settings, others have their defaults.
    truth_views, truth_poses, truth_content, ideal
        As of `simulate`.
    images
        Whether to write the images as files too, as 16-bit PNG or float TIFF.
    overwrite
        Whether results that exist may be replaced.
    check
        Whether to refuse a folder that holds another scene's recording.
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
        If the scene cannot be made, or a method cannot estimate its recording; before any work.
    EstimateError
        If there is no such method; before any work.
    OutputExistsError
        If results exist that may not be replaced; before any work.
    MismatchError
        If the folder holds another scene's recording.

    See Also
    --------
    simulate, estimate, score, write_report : The stages one by one, in memory.
    RunFolder : Which file of the folder is what.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 60, "height": 50, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> with TemporaryDirectory() as folder:
    ...     results = run_scene(st.scene_from_plain(plain), f"{folder}/wall", stages=("render", "estimate", "score"))
    ...     print(*sorted(path.name for path in results.folder.path.iterdir()))
    estimate.zarr recording.zarr scene.yaml score.csv score.json truth.zarr
    >>> error = results.scores["structure_tensor"].regions["interior"]["depth"]
    >>> error["count"] > 50, error["relative_rms"] < 0.02, results.failures
    (True, True, {})
    """
    unknown = [stage for stage in stages if stage not in STAGES]
    if unknown:
        raise SceneError([Problem("stages", f"must be some of {', '.join(STAGES)}", unknown)])
    choices = method_choices(scene, methods)
    if choices and choices[0].method != scene.estimate.method and scene.estimate.method not in _names(choices):
        scene = scene.model_copy(update={"estimate": choices[0]})
    if "estimate" in stages:
        problems = run_problems(scene, choices)
        if problems:
            raise SceneError(problems)
    runner = Runner(RunFolder(folder, scene.estimate.method), overwrite, check, progress, notice)
    if "render" in stages:
        runner.render(scene, truth_views, truth_poses, truth_content, ideal=ideal, images=images)
    else:
        runner.check_scene(scene)
    for choice in choices:
        with runner.keeping_failures(choice.method):
            if "estimate" in stages:
                runner.estimate(choice)
            if "score" in stages:
                runner.score(choice.method, scene.score)
            if "report" in stages:
                runner.report(choice.method)
    return runner.results()


def method_choices(scene: Scene, methods: Sequence[str | MethodChoice]) -> list[MethodChoice]:
    """Return methods with their settings: the scene's for the scene's own method, defaults for others.

    Raises
    ------
    EstimateError
        If there is no such method.
    """
    own = scene.estimate
    if not methods:
        return [own]
    return [
        item if isinstance(item, MethodChoice) else own if item == own.method else choose({"method": item})
        for item in dict.fromkeys(methods)
    ]


def _names(choices: Sequence[MethodChoice]) -> list[str]:
    return [choice.method for choice in choices]


def run_problems(scene: Scene, choices: Sequence[MethodChoice]) -> list[Problem]:
    """Return what will keep methods from estimating the recording of a scene, before it is made."""
    blank = _blank_recording(scene)
    found = [
        problem for choice in choices for problem in requirements(blank, find_method(choice.method), choice.settings)
    ]
    return list(dict.fromkeys(found))


def _blank_recording(scene: Scene) -> xr.Dataset:
    """Return the recording of a scene with images that take no memory: all of their pixels are one."""
    camera, stage, dtype = scene.camera, scene.stage, chain_of(scene.sensor).dtype
    rows = () if stage.rows == 1 else (stage.rows,)
    shape = (*rows, stage.positions, scene.frames.count, camera.height, camera.width)
    intrinsics = intrinsics_from(scene)
    return make_recording(
        np.broadcast_to(np.zeros((), dtype=dtype), shape),
        intrinsics.focal_length_px,
        intrinsics.baseline_mm,
        intrinsics.principal_point_px,
        intrinsics.frame_interval_s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if rows else None,
    )


class Runner:
    """Runs stages in a folder, and keeps in memory what the next stage needs.

    Parameters
    ----------
    folder
        The folder.
    overwrite
        Whether results that exist may be replaced.
    check
        Whether to refuse parts of different runs.
    progress
        Called with (what, done, total).
    notice
        Called with lines that a user may want to read.
    """

    def __init__(
        self,
        folder: RunFolder,
        overwrite: bool = False,
        check: bool = True,
        progress: Progress | None = None,
        notice: Callable[[str], None] | None = None,
    ) -> None:
        self.folder, self.overwrite, self.check = folder, overwrite, check
        self.progress, self.notice = progress, notice
        self.scores: dict[str, Score] = {}
        self.failures: dict[str, ScenetruthError] = {}
        self.timings_s: dict[str, float] = {}
        self._estimates: dict[str, xr.Dataset] = {}

    @cached_property
    def recording(self) -> xr.Dataset:
        """The recording."""
        return load(self.folder.recording, "recording")

    @cached_property
    def truth(self) -> xr.Dataset | None:
        """The truth; None if there is none."""
        return load(self.folder.truth, "truth") if self.folder.truth.exists() else None

    def results(self) -> RunResults:
        """Return what has been made."""
        return RunResults(self.folder, self.scores, self.failures, self.timings_s)

    @contextmanager
    def keeping_failures(self, method: str) -> Iterator[None]:
        """Note what goes wrong with a method, so that others can go on."""
        try:
            yield
        except ScenetruthError as error:
            self.failures[method] = error

    def render(
        self,
        scene: Scene,
        truth_views: TruthViews = "reference",
        truth_poses: TruthPoses = "real",
        truth_content: TruthMaps = "standard",
        *,
        ideal: bool = False,
        images: Literal["png", "tiff"] | None = None,
    ) -> None:
        """Make recording and truth of a scene; the folder appears with both, or not at all."""
        import yaml

        from scenetruth.simulation import simulate

        with write_aside(self.folder.path, overwrite=self.overwrite) as aside:
            with self._timed("simulate"):
                recording, truth = simulate(
                    scene,
                    truth_views=truth_views,
                    truth_poses=truth_poses,
                    truth_content=truth_content,
                    ideal=ideal,
                    progress=self.progress,
                )
            backend, reason = recording.attrs["render_backend"], recording.attrs["render_fallback_reason"]
            self._say(f"rendered with {backend}" + (f": {reason}" if reason else ""))
            with self._timed("save"):
                aside.mkdir(parents=True)
                files = RunFolder(aside)
                text = yaml.safe_dump(scene.to_plain(), sort_keys=False, allow_unicode=True)
                files.scene.write_text(text, encoding="utf-8")
                save(recording, files.recording)
                save(truth, files.truth)
                if images is not None:
                    write_images(recording, files.images, images)
        self.recording, self.truth = recording, truth

    def check_scene(self, scene: Scene) -> None:
        """Refuse a folder whose recording was made from another scene."""
        wanted, found = scene_hash(scene), self.recording.attrs.get("scene_hash")
        if self.check and found is not None and found != wanted:
            message = f"was made from another scene: {found}, not {wanted}; render it again"
            raise MismatchError([Problem(str(self.folder.recording), message)])

    def choice(self, method: str | None = None, overrides: Sequence[str] = ()) -> MethodChoice:
        """Return a method with settings for the recording in the folder.

        Parameters
        ----------
        method
            The method; that of the recorded scene if not given.
        overrides
            Changes of the recorded settings, ``estimate.FIELD=VALUE``.

        Raises
        ------
        SceneError
            If an override does not fit.
        """
        section = dict((scene_of(self.recording) or {}).get("estimate") or {})
        if method is not None and section.get("method", self.folder.own_method) != method:
            section = {"method": method}
        alone = {"estimate": section}
        _refuse_fixed(overrides, "estimate")
        apply_overrides(alone, overrides)
        return _section_of(alone, "estimate", choose)

    def score_settings(self, overrides: Sequence[str] = ()) -> ScoreSettings:
        """Return the score settings of the recorded scene with overrides ``score.FIELD=VALUE``."""
        from scenetruth.scoring import score_settings

        alone = {"score": dict((scene_of(self.recording) or {}).get("score") or {})}
        _refuse_fixed(overrides, "score")
        apply_overrides(alone, overrides)
        return _section_of(alone, "score", lambda given: score_settings(**given))

    def estimate(self, choice: MethodChoice) -> None:
        """Estimate with a method."""
        target = self.folder.of(choice.method).estimate
        self._refuse_existing(target)
        with self._timed("estimate" if choice.method == self.folder.own_method else f"estimate {choice.method}"):
            try:
                found = estimate(self.recording, choice.method, choice.settings, progress=self.progress)
            except BaseException as error:
                if not isinstance(error, Exception):
                    self._say(f"method '{choice.method}' was interrupted")
                raise
        save(found, target, overwrite=self.overwrite)
        self._estimates[choice.method] = found

    def score(self, method: str, settings: ScoreSettings) -> None:
        """Score the estimate of a method."""
        from scenetruth.scoring import score

        files = self.folder.of(method)
        self._refuse_existing(files.score_json, files.score_csv)
        estimated, truth = self._estimate_of(method), self.truth
        if truth is None:
            raise StoreError(self.folder.truth, "no such store: without a truth there is nothing to score against")
        if self.check:
            check_same_run(
                {
                    str(self.folder.recording): self.recording.attrs,
                    str(self.folder.truth): truth.attrs,
                    str(files.estimate): estimated.attrs,
                }
            )
        attrs = self.recording.attrs
        metadata = {
            "versions": json.loads(attrs.get("versions", "{}")),
            **identity_of(self.recording),
            **identity_of(estimated),
            "seed": attrs.get("seed"),
            "method": method,
            "render_backend": attrs.get("render_backend"),
            "render_fallback_reason": attrs.get("render_fallback_reason"),
            "working_point_px": estimated.attrs.get("working_point_px"),
            "estimate_settings": json.loads(estimated.attrs.get("settings", "{}")),
            "timings_s": dict(self.timings_s),
        }
        scored = score(estimated, truth, self.recording, metadata=metadata, check=False, **settings.model_dump())
        for target, text in ((files.score_json, scored.to_json()), (files.score_csv, scored.to_csv())):
            with write_aside(target, overwrite=self.overwrite) as aside:
                aside.write_text(text, encoding="utf-8")
        self.scores[method] = scored

    def report(self, method: str) -> None:
        """Draw the pictures of a method's estimate and write the page; its errors too, where there is a truth."""
        from scenetruth.scoring import write_report

        files = self.folder.of(method)
        self._refuse_existing(files.report, files.figures)
        estimated, truth = self._estimate_of(method), self.truth
        scored = None if truth is None else self._score_of(method)
        parts = {str(self.folder.recording): self.recording.attrs, str(files.estimate): estimated.attrs}
        if truth is not None and scored is not None:
            parts |= {str(self.folder.truth): truth.attrs, str(files.score_json): dict(scored.metadata)}
        if self.check:
            check_same_run(parts)
            made_of = None if scored is None else scored.metadata.get("estimate_hash")
            now = estimated.attrs.get("estimate_hash")
            if made_of is not None and now is not None and made_of != now:
                message = f"belongs to another estimate than {files.estimate}: {made_of}, not {now}; score again"
                raise MismatchError([Problem(str(files.score_json), message)])
        with TemporaryDirectory(prefix=".report-", dir=self.folder.path) as made:
            write_report(self.recording, estimated, truth, scored, Path(made), progress=self.progress, check=False)
            for name, target in (("figures", files.figures), ("report.html", files.report)):
                with write_aside(target, overwrite=self.overwrite) as place:
                    Path(made, name).rename(place)

    def _estimate_of(self, method: str) -> xr.Dataset:
        if method not in self._estimates:
            self._estimates[method] = load(self.folder.of(method).estimate, "estimate")
        return self._estimates[method]

    def _score_of(self, method: str) -> Score:
        from scenetruth.scoring import Score

        if method not in self.scores:
            file = self.folder.of(method).score_json
            try:
                self.scores[method] = Score.from_json(file.read_text(encoding="utf-8"))
            except OSError as error:
                raise StoreError(file, "cannot be read; make it with `scenetruth score`") from error
        return self.scores[method]

    def _refuse_existing(self, *targets: Path) -> None:
        for target in targets:
            if target.exists() and not self.overwrite:
                raise OutputExistsError(target, "exists already; say --overwrite to replace it")

    @contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.timings_s[what] = round(time.perf_counter() - start, 3)

    def _say(self, text: str) -> None:
        if self.notice is not None:
            self.notice(text)


def _refuse_fixed(overrides: Sequence[str], section: str) -> None:
    fixed = [text for text in overrides if not text.startswith(f"{section}.")]
    if fixed:
        message = f"only fields of '{section}' can be changed after rendering"
        raise SceneError([Problem("--set", message, text) for text in fixed])


def _section_of(alone: Mapping[str, Any], section: str, validate: Callable[[Any], T]) -> T:
    """Validate a section of a scene on its own; problems have its path."""
    try:
        return validate(alone[section])
    except ScenetruthError as error:
        problems = getattr(error, "problems", ())
        raise SceneError([Problem(f"{section}.{item.path}", item.message, item.value) for item in problems]) from error
