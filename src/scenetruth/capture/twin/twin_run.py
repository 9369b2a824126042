"""Simulation of a twin as a capture, its estimation with the method of the measurement, and the predicted errors."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.calibration_errors import add_calibration_errors
from scenetruth.capture.capture_file import Capture, CaptureLike, load_capture
from scenetruth.capture.capture_import import import_capture
from scenetruth.capture.folder_reading import CaptureFolder, open_capture
from scenetruth.capture.simulated_capture import simulate_capture
from scenetruth.capture.twin.prediction import (
    Comparison,
    TwinPrediction,
    compare_estimates,
    draw_prediction,
    mark_bends,
    predict_errors,
)
from scenetruth.capture.twin.surface_texture import ImageSet
from scenetruth.capture.twin.twin_scene import (
    SCENE_FILE,
    MeasuredRun,
    Twin,
    make_twin,
    open_measurement,
)
from scenetruth.errors import ArgumentError, Problem, SceneWarning
from scenetruth.estimators import estimate, find_method
from scenetruth.estimators.registry import validate_settings
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.output import write_atomically
from scenetruth.progress import Progress
from scenetruth.provenance import own_release
from scenetruth.scene import Scene, load_scene
from scenetruth.schema import digest
from scenetruth.scoring import Score, score
from scenetruth.scoring.scorer import score_settings as read_settings
from scenetruth.settings import ScoreSettings
from scenetruth.simulation import make_truth
from scenetruth.storage import RECORDING, TRUTH, is_store, open_store, save_store, store_name

__all__ = ["TwinRun", "run_twin"]

_INDEX, _SCENE, _CAPTURE, _RUN = "twin.json", "scene", "capture", "run"
_FOLDER = JobFolder(_INDEX, "a twin", _RUN)
_PREDICTION, _TABLE, _PICTURE = "prediction.json", "prediction.csv", "prediction.png"
_LEAST_STATIC = 2
_DRAW, _MOST_DRAWS = "draw_", 100


@dataclass(frozen=True, eq=False)
class TwinRun:
    """Simulated and estimated twin of a measurement.

    Attributes
    ----------
    folder
        Output folder: ``scene`` with the scene file, ``capture`` with the simulated images, the run directory ``run``
        with recording, estimate and truth, ``draw_02`` and further with those of the other simulations, and
        ``prediction.json``, ``.csv`` and ``.png``.
    scene
        Scene file of the twin.
    prediction
        Errors to expect from the measurement.
    score
        Score of the twin.

    See Also
    --------
    run_twin : Returns it.

    Examples
    --------
    >>> from scenetruth.capture import TwinRun
    >>> sorted(TwinRun.__dataclass_fields__)
    ['folder', 'prediction', 'scene', 'score']
    """

    folder: Path
    scene: Path
    prediction: TwinPrediction
    score: Score


def run_twin(
    capture: CaptureLike,
    run: str | Path,
    output: str | Path,
    *,
    calibration: RigCalibration | str | Path | None = None,
    method: str | None = None,
    mesh: str | Path | None = None,
    score_settings: ScoreSettings | Mapping[str, Any] | None = None,
    seed: int = 20,
    draws: int = 1,
    progress: Progress | None = None,
) -> TwinRun:
    """Predict the errors of a measurement by simulating its twin and estimating it in the same manner.

    The twin is simulated as a capture with as many dark, flat and static images, imported with the same calibration,
    and estimated with the method and the settings of the measurement. Its errors are those about its exact truth. If
    interrupted, the same call resumes.

    Parameters
    ----------
    capture, run, calibration, method, mesh, seed
        As for `make_twin`.
    output
        Output folder.
    score_settings
        Bounds of the regions, as for `scenetruth.score`.
    draws
        Number of simulations, which differ in the noise and in the visits of the stage. The relative standard deviation
        ``sampling_std`` of the predicted errors falls with its root. A later call with more draws adds the missing.
    progress
        Called with (what, done, total).

    Returns
    -------
    TwinRun
        Twin, score and predicted errors.

    Raises
    ------
    ArgumentError
        If ``draws`` is not between 1 and 100.
    CaptureError
        If the capture, the run or the calibration cannot be used, or do not belong together; lists every problem.
    EstimateError
        If the method of the estimate is not installed.
    SceneError
        If the mesh cannot be read.
    ScoreError
        If the settings of the score are invalid.
    OutputExistsError
        If the folder contains another twin, or other data.

    Warns
    -----
    EstimateWarning, CaptureWarning
        As for the measurement.

    See Also
    --------
    make_twin : Only makes the scene.
    scenetruth.optimise : Designs a rig; the scene of the twin is a measured base.

    Notes
    -----
    The rig of the twin is the estimated one, so that its errors do not contain those of the calibration. The prediction
    adds the uncertainty that the estimate states for all pixels in common.

    Examples
    --------
    >>> import scenetruth as st
    >>> try:
    ...     run_twin({"camera": {"width": 640}}, "run", "twin")
    ... except st.CaptureError as error:
    ...     print(len(error.problems) > 0)
    True
    """
    if not 1 <= draws <= _MOST_DRAWS:
        message = f"must be between 1 and {_MOST_DRAWS}"
        raise ArgumentError([Problem("draws", message, draws)], source="a twin")
    folder, measured, rig = open_measurement(capture, run, calibration, method, mesh, repeatable=True)
    # Raises before any work if the method is not installed.
    validate_settings(find_method(measured.method), measured.settings)
    settings = score_settings if isinstance(score_settings, ScoreSettings) else read_settings(**(score_settings or {}))
    identity = {
        "format": 1,
        "release": own_release(),
        "capture": digest(folder.capture.to_dict()),
        "estimate": measured.estimate.attrs.get("estimate_hash", ""),
        "calibration": None if rig is None else digest([list(rig.names), rig.values.tolist()]),
        "mesh": None if mesh is None else digest(Path(mesh).read_bytes().hex()),
        "score": settings.model_dump(mode="json"),
        "seed": seed,
    }
    other = "contains the twin of another measurement, other settings or another release; choose another"
    with _FOLDER.open(output, identity, other=other) as place:
        return _Running(folder, measured, rig, place, progress).finish(Path(run), mesh, (seed, draws), settings)


class _Running:
    """The steps of a twin that are not complete yet."""

    def __init__(
        self,
        folder: CaptureFolder,
        measured: MeasuredRun,
        calibration: RigCalibration | None,
        place: Path,
        progress: Progress | None,
    ) -> None:
        self.folder, self.measured, self.calibration = folder, measured, calibration
        self.place, self.progress = place, progress

    def finish(
        self, run: Path, mesh: str | Path | None, seed_and_draws: tuple[int, int], settings: ScoreSettings
    ) -> TwinRun:
        seed, draws = seed_and_draws
        scene, notes = self._scene(run, mesh, seed)
        twin_capture, recording, found = self._measure(scene, self.place)
        estimates = [found]
        for number in range(1, draws):
            again = scene.model_copy(update={"seed": scene.seed + number})
            estimates.append(self._measure(again, self.place / f"{_DRAW}{number + 1:02d}")[2])
        truth = self._truth(scene)
        scored = score(found, truth, recording, settings=settings, allow_mismatch=True)
        self._put("score.json", scored.to_json(), _RUN)
        self._put("score.csv", scored.to_csv(), _RUN)
        comparisons = tuple(self._compare(found, recording, twin_capture))
        prediction = predict_errors(
            scored, estimates, truth, recording, self._with_calibration(), comparisons, notes
        )  # fmt: skip
        prediction.save(self.place / _PREDICTION, overwrite=True)
        self._put(_TABLE, prediction.to_dataframe().to_csv(index=False))
        draw_prediction(
            self.place / _PICTURE, (self.measured.recording, self.measured.estimate), (recording, found), truth
        )
        return TwinRun(self.place, self.place / _SCENE / SCENE_FILE, prediction, scored)

    def _measure(self, scene: Scene, place: Path) -> tuple[Path, xr.Dataset, xr.Dataset]:
        """Return the simulated capture of a scene, its recording and its estimate."""
        folder = self._simulate(scene, place)
        recording = self._import(folder, place)
        return folder, recording, self._estimate(recording, place)

    def _with_calibration(self) -> xr.Dataset:
        """Return the estimate of the measurement with the errors of the calibration."""
        found = self.measured.estimate
        rectified = self.measured.recording.attrs.get("geometry") == "rectified"
        if self.calibration is None or not rectified or "calibration_modes" in found or "depth_std" not in found:
            return found
        return add_calibration_errors(found, self.calibration)

    def _put(self, name: str, text: str, folder: str = "") -> None:
        with write_atomically(self.place / folder / name, overwrite=True) as partial:
            partial.write_text(text, encoding="utf-8")

    def _scene(self, run: Path, mesh: str | Path | None, seed: int) -> tuple[Scene, tuple[str, ...]]:
        place, notes = self.place / _SCENE, self.place / "notes.txt"
        if not (place / SCENE_FILE).exists() or not notes.exists():
            made: Twin = make_twin(
                self.folder.capture,
                run,
                place,
                calibration=self.calibration,
                method=self.measured.method,
                mesh=mesh,
                seed=seed,
                overwrite=True,
                progress=self.progress,
            )
            lines = [f"noise from {made.sensor.origin}", *made.notes]
            self._put(notes.name, "\n".join(lines))
        return load_scene(place / SCENE_FILE), tuple(notes.read_text(encoding="utf-8").splitlines())

    def _simulate(self, scene: Scene, place: Path) -> Path:
        sets = self.folder.sets
        counts: dict[str, Any] = {}
        for name in ("dark", "flat", "static"):
            found = sets.get(name)
            counts[name] = 0 if found is None else max(map(len, found.levels.values()))
        # The maps of the truth are those of the rectified recording, see below.
        counts |= {"truth_maps": False}
        return simulate_capture(
            scene, place / _CAPTURE, poses=0, step_std=0.0, progress=self.progress, **counts
        )  # fmt: skip

    def _capture(self, folder: Path) -> Capture:
        """Return the simulated images as a capture with what is stated of the real rig."""
        given, made = self.folder.capture.to_dict(), load_capture(folder).to_dict()
        stage = {**made["stage"], "step_std": self.folder.capture.stage.step_std}
        if "errors" in given["stage"]:
            stage["errors"] = given["stage"]["errors"]
        frames = {name: value for name, value in given["frames"].items() if name not in ("times", "times_file")}
        files = dict(made["files"])
        if self.folder.capture.files.mask is not None:
            files["mask"] = str(Path(self.folder.capture.files.mask).resolve())
        plain = {name: value for name, value in given.items() if name not in ("board", "strip")}
        plain |= {"stage": stage, "frames": frames, "files": files}
        if "rectified_depth_mm" in self.measured.recording.attrs:
            # The plane through which the images were rectified.
            plain["distance_mm"] = float(self.measured.recording.attrs["rectified_depth_mm"])
        if "black_level_dn" in made["camera"]:
            plain["camera"] = {**given["camera"], "black_level_dn": made["camera"]["black_level_dn"]}
        return Capture.from_dict(plain, source=folder, folder=folder)

    def _import(self, folder: Path, place: Path) -> xr.Dataset:
        store = place / _RUN / store_name(RECORDING, zipped=False)
        if not is_store(store):
            given: dict[str, Any] = {}
            if self.calibration is not None:
                geometry = self.measured.recording.attrs.get("geometry", "recorded")
                given = {"calibration": self.calibration, "geometry": geometry}
            elif self._undistorted():
                given = {"undistort": True}
            import_capture(self._capture(folder), output=store.parent, progress=self.progress, **given)
        return open_store(store, kind="recording")

    def _undistorted(self) -> bool:
        """Return whether the recording of the measurement has been resampled to images without distortion."""
        attrs = self.measured.recording.attrs
        return self.folder.capture.camera.distortion is not None and "distortion" not in attrs

    def _estimate(self, recording: xr.Dataset, place: Path) -> xr.Dataset:
        store = place / _RUN / store_name(f"estimate.{self.measured.method}", zipped=False)
        if not is_store(store):
            found = estimate(recording.load(), self.measured.method, self.measured.settings, progress=self.progress)
            save_store(found, store)
        return open_store(store, kind="estimate")

    def _truth(self, scene: Scene) -> xr.Dataset:
        """Return the truth on the pixels of the recording, which may be those of an ideal rig."""
        store = self.place / _RUN / store_name(TRUTH, zipped=False)
        if not is_store(store):
            camera = ImageSet.of(self.measured.recording).camera
            stage: dict[str, Any] = {
                "positions": scene.stage.positions,
                "baseline_mm": float(self.measured.recording.attrs["baseline_mm"]),
                "positions_mm": self.measured.recording["stage_x_mm"].values.tolist(),
            }
            if scene.stage.rows > 1:
                stage |= {"rows": scene.stage.rows, "row_spacing_mm": scene.stage.row_spacing_mm}
            ideal = scene.model_copy(update={"camera": camera, "stage": type(scene.stage).model_validate(stage)})
            with warnings.catch_warnings():
                # Warnings of the scene have been given by the simulation.
                warnings.simplefilter("ignore", SceneWarning)
                found = make_truth(ideal, truth_poses="nominal", progress=self.progress)
            save_store(mark_bends(found, self.measured.pixel_std("depth")), store)
        return open_store(store, kind="truth")

    def _compare(self, found: xr.Dataset, recording: xr.Dataset, folder: Path) -> list[Comparison]:
        scales = (float(self.measured.recording.attrs["full_scale"]), float(recording.attrs["full_scale"]))
        listed = list(compare_estimates(self.measured.estimate, found, scales))
        static = self.folder.sets.get("static")
        if static is not None and max(map(len, static.levels.values())) >= _LEAST_STATIC:
            twin = open_capture(self._capture(folder)).sets["static"]
            values = [
                float(np.sqrt(np.median(each.moments(next(iter(each.levels))).variance))) for each in (static, twin)
            ]  # fmt: skip
            listed.insert(1, Comparison("noise of the static images, median", "DN", *values))
        contrast = [_contrast(each) for each in (self.measured.recording, recording)]
        listed.append(Comparison("RMS gradient of the reference image", "% of full scale per px", *contrast))
        return listed


def _contrast(recording: xr.Dataset) -> float:
    """Return the RMS gradient of the reference image in % of full scale per px."""
    rows, columns = np.gradient(100 * ImageSet.of(recording).reference())
    return float(np.sqrt(np.nanmean(rows**2 + columns**2)))
