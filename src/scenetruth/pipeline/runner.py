"""Stages of a run in a run directory; results of completed stages are reused."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

from scenetruth.errors import MismatchError, Problem, SceneError, ScenetruthError, StoreError
from scenetruth.estimators import EstimationTask, MethodChoice, choose, prepare
from scenetruth.number_format import format_two_digits
from scenetruth.output import (
    OwnershipResult,
    check_output,
    claim_pictures,
    lock_output,
    remove_leftovers,
    write_atomically,
)
from scenetruth.pipeline.preflight import compute_method_workload, compute_recording_workload
from scenetruth.pipeline.run_directory import MethodPaths, RunDirectory, claim_entry, claim_run
from scenetruth.progress import Progress, say
from scenetruth.provenance import own_release, scene_hash
from scenetruth.resources import Limits, MethodWorkload, estimate_cost, inspect_machine, refuse_resources
from scenetruth.scene import Scene
from scenetruth.scene.scene_loader import apply_overrides
from scenetruth.schema import check_same_run, digest, read_lineage, read_scene
from scenetruth.storage import (
    StoreWriter,
    claim_store,
    is_zip_name,
    open_store,
    open_store_files,
    write_images,
    write_store,
)

if TYPE_CHECKING:
    from concurrent.futures import Future

    import xarray as xr

    from scenetruth.pipeline.figure_worker import FigureWorker
    from scenetruth.scoring import FigureInfo, Score
    from scenetruth.settings import ScoreSettings
    from scenetruth.truth import TruthOptions

__all__ = ["PipelineRunner", "RunResult", "write_estimate"]


def write_estimate(work: EstimationTask, path: Path, *, zipped: bool = False) -> None:
    """Compute an estimate, and write it to a new store."""
    blank = work.blank()
    if blank is None:
        write_store(work.estimate(), path, zipped=zipped)
        return
    with StoreWriter(path, blank, zipped=zipped) as writer:
        writer.describe(work.fill(writer.put))


T = TypeVar("T")


@dataclass(frozen=True)
class RunResult:
    """Scores and errors of a run by method, and durations by type of task; other methods are unaffected by errors."""

    folder: RunDirectory
    scores: Mapping[str, Score] = field(default_factory=dict)
    failures: Mapping[str, ScenetruthError] = field(default_factory=dict)
    timings_s: Mapping[str, float] = field(default_factory=dict)


class PipelineRunner:
    """Runner of the stages in a directory; intermediate results stay in memory.

    ``check``: Whether to reject parts of different runs. ``asked``: Hash of all arguments of stages after rendering:
    an interrupted run with the same hash is resumed. None for single stages.
    """

    def __init__(
        self,
        folder: RunDirectory,
        overwrite: bool = False,
        check: bool = True,
        progress: Progress | None = None,
        helper: FigureWorker | None = None,
        limits: Limits | None = None,
        asked: str | None = None,
    ) -> None:
        self.folder, self.overwrite, self.check = folder, overwrite, check
        self.asked, self._goes_on = asked, False
        self.progress = progress
        self.helper, self.limits = helper, limits or Limits()
        self.scores: dict[str, Score] = {}
        self.failures: dict[str, ScenetruthError] = {}
        self.timings_s: dict[str, float] = {}
        self._estimates: dict[str, xr.Dataset] = {}

    def __enter__(self) -> Self:
        """Lock the directory until the block ends, and remove incomplete output of killed runs."""
        self._held = ExitStack()
        self._held.enter_context(lock_output(self.folder.path, claim_run))
        if self.folder.path.is_dir():
            remove_leftovers(self.folder.path, _claim)
            if self.asked is None:
                # Results of single stages do not belong to a run.
                self.folder.unfinished.unlink(missing_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._held.__exit__(kind, error, trace)

    @cached_property
    def recording(self) -> xr.Dataset:
        """The recording."""
        return open_store(self.folder.check_recording(), kind="recording")

    @cached_property
    def truth(self) -> xr.Dataset | None:
        """The truth; None if there is none."""
        return open_store(self.folder.truth, kind="truth") if self.folder.truth.exists() else None

    def results(self) -> RunResult:
        """Return the results."""
        return RunResult(self.folder, self.scores, self.failures, self.timings_s)

    @contextmanager
    def keeping_failures(self, method: str) -> Iterator[None]:
        """Record the failure of a method, so that other methods continue."""
        try:
            yield
        except ScenetruthError as error:
            self.failures[method] = error

    def render(
        self,
        scene: Scene,
        truth: TruthOptions,
        *,
        save_radiance: bool = False,
        images: Literal["png", "tiff"] | None = None,
    ) -> None:
        """Simulate recording and truth of a scene; the directory is written atomically with both."""
        from scenetruth.simulation import simulate_into

        if not self.overwrite and self._is_unfinished():
            self._goes_on = True
            self._say("resuming the interrupted run: images and truth exist")
            return
        with write_atomically(self.folder.path, overwrite=self.overwrite, claim=claim_run) as partial_:
            partial_.mkdir()
            with self._timed("simulate"):
                backend, reason = simulate_into(
                    partial_, scene, truth, save_radiance=save_radiance, progress=self.progress
                )
            self._say(f"rendered with {backend}" + (f": {reason}" if reason else ""))
            files = RunDirectory(partial_)
            if images is not None:
                with self._timed("images"):
                    write_images(open_store(files.recording, kind="recording"), files.images, images)
            if self.asked is not None:
                files.unfinished.write_text(self.asked, encoding="utf-8")
        self._forget()

    def finish(self) -> None:
        """Record that the run is complete."""
        self.folder.unfinished.unlink(missing_ok=True)

    def _has(self, method: str, *targets: Path) -> bool:
        """Return whether the resumed run has completed this; user-defined methods may have changed since."""
        return self._goes_on and ":" not in method and all(target.exists() for target in targets)

    def _is_unfinished(self) -> bool:
        try:
            return self.asked is not None and self.folder.unfinished.read_text(encoding="utf-8") == self.asked
        except (OSError, ValueError):
            return False

    def check_scene(self, scene: Scene) -> None:
        """Raise if the recording belongs to another scene."""
        wanted, found = scene_hash(scene), self.recording.attrs.get("scene_hash")
        if self.check and found is not None and found != wanted:
            message = f"belongs to another scene: {found}, not {wanted}; render it again"
            raise MismatchError([Problem(str(self.folder.recording), message)])

    def choice(self, method: str | None = None, overrides: Sequence[str] = ()) -> MethodChoice:
        """Return a method with settings for the recording."""
        section = dict((read_scene(self.recording) or {}).get("estimate") or {})
        if method is not None and section.get("method", self.folder.own_method) != method:
            section = {"method": method}
        alone = {"estimate": section}
        _refuse_fixed(overrides, "estimate")
        apply_overrides(alone, overrides)
        # Only the caller may name code, because stores may be of unknown origin.
        return _read_section(alone, "estimate", partial(choose, from_file=method is None))

    def score_settings(self, overrides: Sequence[str] = ()) -> ScoreSettings:
        """Return the score settings of the recorded scene with overrides ``score.FIELD=VALUE``."""
        from scenetruth.scoring import score_settings

        alone = {"score": dict((read_scene(self.recording) or {}).get("score") or {})}
        _refuse_fixed(overrides, "score")
        apply_overrides(alone, overrides)
        return _read_section(alone, "score", lambda given: score_settings(**given))

    def estimate(self, choice: MethodChoice) -> None:
        """Estimate with a method."""
        target = self.folder.paths(choice.method).estimate
        if self._has(choice.method, target):
            return
        self._refuse_existing(target)
        self._refuse_resources("estimate", compute_method_workload([choice]))
        with self._timed("estimate" if choice.method == self.folder.own_method else f"estimate {choice.method}"):
            try:
                with write_atomically(target, overwrite=self._replaces, claim=claim_store) as partial_:
                    work = prepare(self.recording, choice.method, choice.settings, self.progress)
                    write_estimate(work, partial_, zipped=is_zip_name(target))
            except BaseException as error:
                if not isinstance(error, Exception):
                    self._say(f"method '{choice.method}' was interrupted")
                raise
        self._estimates.pop(choice.method, None)

    def score(self, method: str, settings: ScoreSettings) -> None:
        """Score the estimate of a method."""
        from scenetruth.scoring import detect_convention_mismatches, score

        files = self.folder.paths(method)
        if self._has(method, files.estimate, files.score_json, files.score_csv):
            self._load_score(method)
            return
        self._refuse_existing(files.score_json, files.score_csv)
        estimated, truth = self._load_estimate(method), self.truth
        if truth is None:
            raise StoreError(self.folder.truth, "no such store: scoring needs a truth")
        self._refuse_resources("score")
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
            **read_lineage(self.recording),
            **read_lineage(estimated),
            "seed": attrs.get("seed"),
            "method": method,
            "render_backend": attrs.get("render_backend"),
            "render_fallback_reason": attrs.get("render_fallback_reason"),
            "working_point_px": estimated.attrs.get("working_point_px"),
            "estimate_settings": json.loads(estimated.attrs.get("settings", "{}")),
            "timings_s": dict(self.timings_s),
        }
        scored = score(estimated, truth, self.recording, settings=settings, metadata=metadata, allow_mismatch=True)
        for target, text in ((files.score_json, scored.to_json()), (files.score_csv, scored.to_csv())):
            with write_atomically(target, overwrite=self._replaces) as partial_:
                partial_.write_text(text, encoding="utf-8")
        self.scores[method] = scored
        for mismatch in detect_convention_mismatches(estimated, truth):
            self._say(f"possible convention error in the estimate of '{method}': {mismatch.message}")
        unseen = _unseen_growth(scored, method)
        if unseen:
            self._say(unseen)

    def report(self, method: str, figures: Collection[str] | None = None, figures_also: Collection[str] = ()) -> None:
        """Write figures and report, with errors if there is a truth; ``figures_also``: figure formats besides PNG."""
        from scenetruth.scoring.report.score_report import matches_fingerprint, write_report_with
        from scenetruth.strain import report_good_practice

        files = self.folder.paths(method)
        made_of = self._compute_report_digest(files, figures, figures_also)
        if not self.overwrite and files.figures.is_dir() and matches_fingerprint(files.report, made_of):
            self._say(f"{files.report} is up to date")
            return
        self._refuse_existing(files.report, files.figures)
        self._refuse_resources("report")
        estimated, truth = self._load_estimate(method), self.truth
        scored = None if truth is None else self._load_score(method)
        parts = {str(self.folder.recording): self.recording.attrs, str(files.estimate): estimated.attrs}
        if truth is not None and scored is not None:
            parts |= {str(self.folder.truth): truth.attrs, str(files.score_json): dict(scored.metadata)}
        if self.check:
            check_same_run(parts)
            scored_hash = None if scored is None else scored.metadata.get("estimate_hash")
            now = estimated.attrs.get("estimate_hash")
            if scored_hash is not None and now is not None and scored_hash != now:
                message = f"belongs to another estimate than {files.estimate}: {scored_hash}, not {now}; score again"
                raise MismatchError([Problem(str(files.score_json), message)])
        with (
            write_atomically(files.report, overwrite=self._replaces) as page,
            write_atomically(files.figures, overwrite=self._replaces, claim=claim_pictures) as made,
        ):
            # In the only directory that is cleaned up if this process is killed.
            made.mkdir()
            write_report_with(
                estimated,
                truth,
                self.recording,
                score=scored,
                output=made,
                progress=self.progress,
                allow_mismatch=True,
                good_practice=report_good_practice(self.recording, estimated),
                figures=figures,
                figure_formats=("png", *figures_also),
                made_of=made_of,
                elsewhere=self._elsewhere(files, made / "figures"),
            )
            (made / "report.html").rename(page)
            for picture in (made / "figures").iterdir():
                picture.rename(made / picture.name)
            (made / "figures").rmdir()

    def _compute_report_digest(self, files: MethodPaths, figures: Collection[str] | None, also: Collection[str]) -> str:
        stores = [store for store in (self.folder.recording, self.folder.truth, files.estimate) if store.exists()]
        seals = [open_store_files(store).read("zarr.json").decode(errors="replace") for store in stores]
        scored = files.score_json.read_bytes().hex() if files.score_json.exists() else None
        chosen = None if figures is None else sorted(figures)
        return digest([own_release(), seals, scored, chosen, sorted(also)])

    def _elsewhere(self, files: MethodPaths, folder: Path) -> Callable[[str], Future[FigureInfo | None]] | None:
        helper = self.helper
        if helper is None:
            return None
        stores: dict[str, str | None] = {
            "recording": str(self.folder.recording),
            "estimate": str(files.estimate),
            "truth": None if self.truth is None else str(self.folder.truth),
            "score": None if self.truth is None else str(files.score_json),
        }
        return lambda name: helper.draw(name, stores, folder)

    def _load_estimate(self, method: str) -> xr.Dataset:
        if method not in self._estimates:
            self._estimates[method] = open_store(self.folder.check_estimate(method), kind="estimate")
        return self._estimates[method]

    def _load_score(self, method: str) -> Score:
        from scenetruth.scoring import Score

        if method not in self.scores:
            self.scores[method] = Score.load(self.folder.paths(method).score_json)
        return self.scores[method]

    @property
    def _replaces(self) -> bool:
        """Whether results may be replaced: by request, or because they belong to an interrupted run."""
        return self.overwrite or self._goes_on

    def _refuse_existing(self, *targets: Path) -> None:
        for target in targets:
            check_output(target, overwrite=self._replaces, claim=_claim)

    def _refuse_resources(self, stage: str, effort: MethodWorkload | None = None) -> None:
        forecast = estimate_cost(compute_recording_workload(self.recording, effort), [stage])
        refuse_resources(forecast, inspect_machine(self.folder.path), self.limits)

    def _forget(self) -> None:
        for name in ("recording", "truth"):
            self.__dict__.pop(name, None)
        self._estimates.clear()
        self.scores.clear()

    @contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.timings_s[what] = round(time.perf_counter() - start, 3)

    def _say(self, text: str) -> None:
        say(text)


def _unseen_growth(scored: Score, method: str) -> str:
    """Return a note on growth whose median error exceeds its magnitude, with a recommendation."""
    from scenetruth.scoring.score_result import find_growing_objects

    values = scored.regions["interior"].get("growth_rate", {})
    growing = find_growing_objects(scored.regions)
    # Errors of static objects are smaller, and are not those of a leaf before them.
    if growing is not None and values and len(growing.regions) == 1:
        values = growing.values(scored.regions, "growth_rate")
    median, rms, relative = (values.get(name) for name in ("median_abs_error", "rmse", "relative_rmse"))
    if not scored.grows or median is None or not rms or not relative or median <= rms / relative:
        return ""
    better = "a longer frames.frame_interval_s" if method == "refined" else "--method refined"
    line = (
        f"the median absolute error is {format_two_digits(median)} %/h, the "
        f"RMS growth rate {format_two_digits(rms / relative)} %/h"
    )
    return f"growth is not resolved by '{method}': {line}; {better} is more precise"


def _claim(path: Path) -> OwnershipResult:
    return claim_entry(path) or OwnershipResult("is not a name of scenetruth")


def _refuse_fixed(overrides: Sequence[str], section: str) -> None:
    fixed = [text for text in overrides if not text.startswith(f"{section}.")]
    if fixed:
        message = f"only fields of '{section}' can be changed after rendering"
        raise SceneError([Problem("--set", message, text) for text in fixed])


def _read_section(alone: Mapping[str, Any], section: str, validate: Callable[[Any], T]) -> T:
    try:
        return validate(alone[section])
    except ScenetruthError as error:
        problems = getattr(error, "problems", ())
        raise SceneError([Problem(f"{section}.{item.path}", item.message, item.value) for item in problems]) from error
