"""From a capture folder to a report in one call: check, calibration, import, estimate and report; resumable."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from scenetruth.capture.calibration import RigCalibration, RigGuess, RigSolution
from scenetruth.capture.calibration_errors import add_calibration_errors
from scenetruth.capture.capture_calibration import (
    CALIBRATION_FILE,
    POINTS_FILE,
    CaptureGuess,
    board_problems,
    calibrate_folder,
    fit_points,
    load_points,
    output_files,
    rig_priors,
    save_calibration,
    start_values,
)
from scenetruth.capture.capture_check import CaptureReport, check_capture
from scenetruth.capture.capture_file import CaptureLike
from scenetruth.capture.capture_import import import_capture
from scenetruth.capture.folder_reading import CaptureFolder, open_capture
from scenetruth.capture.report import CaptureResults, write_capture_page
from scenetruth.errors import CaptureError, OutputExistsError, Problem
from scenetruth.estimators import find_method, prepare
from scenetruth.estimators.estimation import requirements
from scenetruth.estimators.method_specs import MethodLike, MethodSpec, offered_methods, read_method
from scenetruth.output import (
    Claim,
    check_output,
    claim_file,
    claim_pictures,
    lock_output,
    scratch_path,
    write_atomically,
)
from scenetruth.pipeline import (
    PipelineRunner,
    RunDirectory,
    compute_method_workload,
    compute_recording_workload,
    write_estimate,
)
from scenetruth.plain_data import parse_json
from scenetruth.progress import Progress, say
from scenetruth.provenance import own_release
from scenetruth.resources import Limits, estimate_cost, inspect_machine, refuse_resources
from scenetruth.schema import digest
from scenetruth.storage import claim_store, open_store, save_store

__all__ = ["CaptureRun", "run_capture"]

_INDEX, _CHECK, _PAGE, _FIGURES = "capture_run.json", "check.json", "capture.html", "capture_figures"
_OTHER = (
    "was made from other images, another capture file, other settings or by another release; choose another output, or "
    "repeat with --overwrite to replace what other inputs have given"
)


@dataclass(frozen=True, eq=False)
class CaptureRun:
    """Result of a run of a capture.

    ``folder``: Directory with recording, estimate and report.
    ``page``: Page of the capture: calibration, noise, results, suggestions.
    ``check``: Findings of the check.
    ``calibration``: Calibration of the rig; None without images of a board.
    ``reused``: Stages whose results existed.

    See Also
    --------
    run_capture : Returns it.

    Examples
    --------
    >>> import scenetruth as st
    >>> from scenetruth.capture import CaptureReport, CaptureRun
    >>> run = CaptureRun(st.RunDirectory("lab_run"), Path("lab_run/capture.html"), CaptureReport((), 45), None)
    >>> run.folder.recording.name, run.calibration is None
    ('recording.zarr', True)
    """

    folder: RunDirectory
    page: Path
    check: CaptureReport
    calibration: RigCalibration | None
    reused: tuple[str, ...] = ()


def run_capture(
    capture: CaptureLike,
    output: str | Path,
    *,
    method: MethodLike = "refined",
    guess: CaptureGuess | None = None,
    std: Mapping[str, float] | None = None,
    distortion: Sequence[str] | None = None,
    check: bool = True,
    overwrite: bool = False,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> CaptureRun:
    """Check a capture, calibrate its rig, read its images, estimate depth and motion, and write a report.

    Without images of a board, the camera of the capture file, or of ``guess``, is used. Method ``refined`` then
    corrects the poses of the camera from the images, within the tolerances of the stage.

    Parameters
    ----------
    capture
        Folder with a ``capture.yaml``, the path of such a file, or a capture.
    output
        Directory of the results. If interrupted, the same call resumes: each result appears under its name when it is
        complete. Results of other inputs are rejected.
    method
        Method of estimation: a name, a function, or `scenetruth.estimators.MethodSpec` with settings.
    guess, std, distortion
        As for `calibrate_capture`.
    check
        Whether mistakes that the check finds end the run.
    overwrite
        Replace results of other inputs: those of changed images, of a changed capture file or of another method.
    limits
        Resource limits; the default limits if not given.
    progress
        Called with (what, done, total).

    Returns
    -------
    CaptureRun
        Paths and results.

    Raises
    ------
    CaptureError
        If files do not fit the capture or do not serve for a calibration, or the check finds mistakes; lists every
        problem.
    ValueError
        A `CalibrationError` if the boards are not detected, contradict each other, or determine too little.
    EstimateError
        If the method is unknown or cannot estimate the recording.
    MachineError
        If the predicted memory, disk space or time exceeds the machine or the limits.
    OutputExistsError
        If the directory contains results of other inputs; raised before any work.

    See Also
    --------
    check_capture, calibrate_capture, import_capture, scenetruth.estimate : The single steps.

    Examples
    --------
    >>> from scenetruth.capture import run_capture
    >>> try:
    ...     run_capture("no_such_folder", "outputs/lab")
    ... except CaptureError as error:
    ...     print(type(error).__name__)
    CaptureError
    """
    spec = read_method(method)
    folder = open_capture(capture)
    with offered_methods([spec]):
        run = _Run(folder, Path(output), spec, (guess, std, distortion), limits or Limits(), progress)
        run.refuse(overwrite=overwrite)
        with lock_output(run.output / "run"):
            return run.finish(check=check)


@dataclass(frozen=True)
class _Stage:
    """A stage: hash of everything that it depends on, its products, and its work."""

    name: str
    inputs: str
    products: tuple[tuple[Path, Claim], ...]
    work: Callable[[], None]

    @property
    def exists(self) -> bool:
        """Whether all products exist."""
        return all(path.exists() for path, _ in self.products)


class _Run:
    """A run in an output directory: its stages, and the index of those that are complete."""

    def __init__(
        self,
        folder: CaptureFolder,
        output: Path,
        method: MethodSpec,
        start: tuple[CaptureGuess | None, Mapping[str, float] | None, Sequence[str] | None],
        limits: Limits,
        progress: Progress | None,
    ) -> None:
        self.folder, self.output, self.method, self.limits, self.progress = folder, output, method, limits, progress
        self.guess, self.std, self.distortion = start
        self.name = method.choice().method
        self.run = RunDirectory(output, self.name)
        self.calibration: RigCalibration | None = None
        self.solution: RigSolution | None = None
        self.report: CaptureReport | None = None
        self.stages = self._stages()

    def _stages(self) -> list[_Stage]:
        capture, folder = self.folder.capture, self.folder
        plain = capture.to_dict()
        sets = [name for frames in folder.sets.values() for names in frames.levels.values() for name in names]
        of_sets, of_images = self._marks(sets), self._marks(file.name for file in folder.images.files.values())
        strip = None if capture.strip is None else capture.strip.file
        tables = [capture.stage.positions_file, capture.frames.times_file, capture.files.mask, strip]
        # The inputs of a stage are those of all stages before it, and its own.
        values = [own_release(), plain, of_sets, of_images, self._marks(map(str, filter(None, tables)))]
        inputs = digest(values)
        files = self.run.paths(self.name)
        stages = [_Stage("check", inputs, ((self.output / _CHECK, claim_file),), self._check)]
        if folder.board:
            inputs = digest([inputs, self._marks(folder.board.values()), self._marked_start()])
            products = tuple((file, claim_file) for file in output_files(self.output))
            stages.append(_Stage("calibrate", inputs, products, self._calibrate))
        inputs = digest([inputs, self._marked_start()])
        stages.append(_Stage("import", inputs, ((self.run.recording, claim_store),), self._import))
        inputs = digest([inputs, self.method.spelled, self.method.fingerprint])
        stages.append(_Stage("estimate", inputs, ((files.estimate, claim_store),), self._estimate))
        pictures = ((files.report, claim_file), (files.figures, claim_pictures))
        stages.append(_Stage("report", inputs, pictures, self._report))
        of_page = ((self.output / _PAGE, claim_file), (self.output / _FIGURES, claim_pictures))
        stages.append(_Stage("page", inputs, of_page, self._write_page))
        return stages

    def _marks(self, names: Iterable[str]) -> list[list[Any]]:
        """Return name, size and time of change of files."""
        found = []
        for name in names:
            stat = (self.folder.capture.folder / name).stat()
            found.append([name, stat.st_size, stat.st_mtime_ns])
        return found

    def _marked_start(self) -> list[Any]:
        guess: Any = self.guess
        if isinstance(guess, RigCalibration):
            guess = [guess.values.tolist(), guess.covariance.tolist()]
        elif isinstance(guess, BaseModel):
            guess = guess.model_dump(mode="json")
        elif isinstance(guess, str | PathLike):
            file = Path(guess)
            guess = [str(file), digest(file.read_bytes().hex())] if file.is_file() else str(file)
        return [guess, dict(self.std or {}), None if self.distortion is None else list(self.distortion)]

    def _read_index(self) -> dict[str, dict[str, Any]]:
        """Return what the index states of every stage."""
        file = self.output / _INDEX
        if not file.exists():
            return {}
        try:
            found = parse_json(file.read_bytes())
            return {str(name): dict(values) for name, values in found["stages"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise OutputExistsError(file, f"is damaged: {error}; choose another directory") from error

    def _note(self, stage: _Stage, *, complete: bool) -> None:
        index = self._read_index() | {stage.name: {"inputs": stage.inputs, "complete": complete}}
        text = json.dumps({"format": 1, "stages": index}, indent=1)
        with write_atomically(self.output / _INDEX, overwrite=True) as partial:
            partial.write_text(text + "\n", encoding="utf-8")

    def refuse(self, *, overwrite: bool) -> None:
        """Raise for problems of the files, of the method, and for results of other inputs, before any work."""
        folder, problems = self.folder, list[Problem]()
        if folder.board:
            problems += board_problems(folder, has_guess=self.guess is not None)
        start = start_values(folder, self.guess, self.std, problems)
        rig_priors(folder, distortion=self.distortion, problems=problems, announced=False)
        if not folder.board and not problems and _focal_length(start) is None:
            message = "is missing: add images of a board, give the focal length, or import a calibration"
            problems.append(Problem("camera.focal_length_px", message))
        pixels = folder.images.pixels
        if folder.board and pixels.bayer is not None and pixels.plane == "mosaic":
            message = (
                "must be red, green or blue: images of a calibrated rig are resampled, which would mix the colours"
            )
            problems.append(Problem("camera.plane", message, pixels.plane))
        if problems:
            raise CaptureError(problems, source=folder.capture.folder)
        # The focal length does not matter for what a method requires.
        any_lens = replace(folder, capture=_with_camera(folder, RigGuess(focal_length_px=1e3)))
        choice = self.method.choice()
        found = requirements(any_lens.plan().blank(), find_method(choice.method), choice.settings)
        if found:
            raise CaptureError(found, source=folder.capture.folder)
        if self.output.exists() and not self.output.is_dir():
            raise OutputExistsError(self.output, "is a file; choose another directory")
        index = self._read_index()
        for stage in self.stages:
            own = overwrite or index.get(stage.name, {}).get("inputs") == stage.inputs
            for path, claim in stage.products:
                if path.exists() and not own:
                    raise OutputExistsError(path, _OTHER)
                # Files of others are never replaced.
                check_output(path, overwrite=True, claim=claim)

    def finish(self, *, check: bool) -> CaptureRun:
        """Do what is not complete yet."""
        self.output.mkdir(parents=True, exist_ok=True)
        reused = []
        for stage in self.stages:
            state = self._read_index().get(stage.name, {})
            if state == {"inputs": stage.inputs, "complete": True} and stage.exists:
                reused.append(stage.name)
            else:
                self._note(stage, complete=False)
                stage.work()
                self._note(stage, complete=True)
            if stage.name == "check" and check:
                self._end_with_mistakes()
        if reused:
            say(f"results that exist: {', '.join(reused)}")
        return CaptureRun(self.run, self.output / _PAGE, self._findings(), self._calibrated(), tuple(reused))

    def _check(self) -> None:
        self.report = check_capture(self.folder.capture, progress=self.progress)
        with write_atomically(self.output / _CHECK, overwrite=True) as partial:
            partial.write_text(json.dumps(self.report.to_dict(), indent=1) + "\n", encoding="utf-8")

    def _findings(self) -> CaptureReport:
        if self.report is None:
            self.report = CaptureReport.from_dict(parse_json((self.output / _CHECK).read_bytes()))
        return self.report

    def _end_with_mistakes(self) -> None:
        errors = [finding for finding in self._findings().findings if finding.severity == "error"]
        if errors:
            raise CaptureError([Problem(one.mistake, one.message) for one in errors], source=self.folder.capture.folder)

    def _calibrate(self) -> None:
        self.calibration, self.solution = calibrate_folder(
            self.folder, guess=self.guess, std=self.std, distortion=self.distortion, progress=self.progress
        )
        save_calibration(self.calibration, self.solution, self.output, overwrite=True)

    def _calibrated(self) -> RigCalibration | None:
        if self.calibration is None and self.folder.board:
            self.calibration = RigCalibration.load(self.output / CALIBRATION_FILE)
        return self.calibration

    def _fitted(self) -> RigSolution | None:
        """Return the fit of the calibration; that of an earlier call is repeated from its points."""
        calibration = self._calibrated()
        if self.solution is None and calibration is not None:
            priors = rig_priors(self.folder, distortion=self.distortion)
            self.solution = fit_points(self.folder, load_points(self.output / POINTS_FILE), calibration, priors)
        return self.solution

    def _import(self) -> None:
        calibration, capture, undistort = self._calibrated(), self.folder.capture, False
        if calibration is None:
            capture = _with_camera(self.folder, start_values(self.folder, self.guess, self.std, []), self.std)
            # Methods that assume a pinhole camera get images of one.
            blank = replace(self.folder, capture=capture).plan().blank()
            ignored = find_method(self.method.method).needs.describe_ignored(blank, self.name)
            undistort = any("distortion" in text for text in ignored)
        import_capture(
            capture, output=self.output, overwrite=True, undistort=undistort, calibration=calibration,
            progress=self.progress,
        )  # fmt: skip

    def _estimate(self) -> None:
        recording, choice = open_store(self.run.recording, kind="recording"), self.method.choice()
        workload = compute_recording_workload(recording, compute_method_workload([choice]))
        refuse_resources(estimate_cost(workload, ["estimate"]), inspect_machine(self.output), self.limits)
        calibration, target = self._calibrated(), self.run.paths(self.name).estimate
        with write_atomically(target, overwrite=True, claim=claim_store) as partial:
            work = prepare(recording, choice.method, choice.settings, self.progress)
            if calibration is None:
                write_estimate(work, partial)
                return
            scratch = scratch_path(partial)
            write_estimate(work, scratch)
            found = open_store(scratch, kind="estimate")
            if {"depth", "depth_std"} <= set(found):
                save_store(add_calibration_errors(found, calibration.measured()), partial)
                shutil.rmtree(scratch)
            else:
                say(f"method '{self.name}' states no standard deviation of depth: calibration errors are not added")
                scratch.rename(partial)

    def _report(self) -> None:
        with PipelineRunner(self.run, overwrite=True, progress=self.progress, limits=self.limits) as runner:
            runner.report(self.name)

    def _write_page(self) -> None:
        files = self.run.paths(self.name)
        results = CaptureResults(
            self.folder, self._findings(), self._calibrated(), self._fitted(),
            open_store(files.estimate, kind="estimate"), self.name, files.report.name, files.figures,
        )  # fmt: skip
        with (
            write_atomically(self.output / _PAGE, overwrite=True) as page,
            write_atomically(self.output / _FIGURES, overwrite=True, claim=claim_pictures) as pictures,
        ):
            pictures.mkdir()
            page.write_text(write_capture_page(results, pictures, self.progress), encoding="utf-8")


def _focal_length(start: RigGuess | RigCalibration | None) -> float | None:
    return start.value("f") if isinstance(start, RigCalibration) else None if start is None else start.focal_length_px


def _with_camera(
    folder: CaptureFolder, start: RigGuess | RigCalibration | None, std: Mapping[str, float] | None = None
) -> Any:
    """Return the capture with the camera of start values, and its stated standard deviations."""
    capture = folder.capture
    if start is None:
        return capture
    deviations = dict(std or {})
    if isinstance(start, RigCalibration):
        camera = start.camera
        deviations = {name: start.std(name) for name in ("f", "c_x", "c_y")} | deviations
        start = RigGuess(
            focal_length_px=camera.focal_px, principal_point_px=camera.principal_point, distortion=camera.distortion
        )
    stated: dict[str, Any] = {
        "focal_length_px": start.focal_length_px,
        "focal_length_mm": None,
        "pixel_pitch_um": None,
        "principal_point_px": start.principal_point_px,
        "distortion": start.distortion,
    }
    if "f" in deviations:
        stated["focal_length_std_px"] = deviations["f"]
    if {"c_x", "c_y"} & deviations.keys():
        centre = [deviations.get(name, 0.0) for name in ("c_x", "c_y")]
        stated["principal_point_std_px"] = float(np.sqrt(np.mean(np.square(centre))))
    changed = capture.model_copy(update={"camera": capture.camera.model_copy(update=stated)})
    changed._folder = capture._folder
    return changed
