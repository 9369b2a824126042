"""Predicted errors of twins against obtained errors: random rigs, simulated, calibrated, estimated, and scored.

Run it from the top of the repository: ``python -m benchmarks.twin [--rigs N] [--first SEED] [--output FOLDER]``.
Each rig has its own scene (plane, plates, box or relief), texture, lens with distortion and blur, stage errors, sensor
and exposure. The twin has the capture without its truth. Compared are the errors about their mean, without the common
part, over the same pixels: those of the interior of the twin that are valid in capture and twin. Errors of one map
scatter, because they have few independent values. Where the twin states that this is more than 12 %, the comparison is
repeated: four simulations of the twin, and four captures of the rig, which differ in the noise. Ratios are predicted /
obtained: ``pixel`` of all, ``single`` with the one capture that the twin is made from, ``true_interior`` with all valid
pixels of the interior of the truth, ``total`` with the mean and the stated uncertainty of the calibration, and
``stated`` with the deviation that the method states. z is the logarithm of the ratio in deviations of its scatter.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from scenetruth.capture import (
    RegionError,
    RigCalibration,
    calibrate_capture,
    import_capture,
    run_twin,
    simulate_capture,
)
from scenetruth.capture.rectification import recorded_pixels
from scenetruth.capture.twin import sampling_std
from scenetruth.errors import CaptureWarning, EstimateWarning, SceneWarning
from scenetruth.estimators import estimate
from scenetruth.scene import Scene, load_scene
from scenetruth.schema import STATUS_VALID
from scenetruth.scoring.regions import main_regions
from scenetruth.settings import ScoreSettings
from scenetruth.simulation import make_truth
from scenetruth.storage import open_store, save_store

__all__ = ["draw_scene", "main", "measure", "truth_of_recording"]

SIZE = (240, 180)
QUANTITIES = ("depth", "velocity_z")
NUMBERS = ("pixel_std", "rmse", "common_std", "stated_capture", "sampling_std")
WANTED = (0.8, 1.25)
FEW = 0.12


def draw_scene(seed: int) -> dict[str, Any]:
    """Return the scene of a random rig."""
    draw = np.random.default_rng([seed, 37])
    focal, distance = float(draw.uniform(1500, 2600)), float(draw.uniform(450, 750))
    pixel_mm = distance / focal
    field = np.array(SIZE) * pixel_mm
    positions = int(draw.choice([3, 4, 5]))
    travel = float(draw.uniform(0.12, 0.2)) * field[0]
    shortest = float(draw.uniform(4.0, 6.0)) * pixel_mm
    texture = {
        "kind": "noise",
        "wavelength_mm": [shortest, shortest * float(draw.uniform(3, 6))],
        "mean": float(draw.uniform(0.3, 0.5)),
        "rms_contrast": float(draw.uniform(0.08, 0.25)),
    }
    speed = float(draw.uniform(0.5, 2.0)) * pixel_mm
    motion: list[dict[str, Any]] = [
        {"kind": "velocity", "velocity_mm_per_frame": (speed * draw.uniform(-1, 1, 3) * (1, 1, 2)).tolist()}
    ]
    tilt = [
        {"axis": [0, 1, 0], "angle_deg": float(draw.uniform(-20, 20))},
        {"axis": [1, 0, 0], "angle_deg": float(draw.uniform(-15, 15))},
    ]
    scene_type = ("plane", "plates", "box", "relief")[seed % 4]
    wall: dict[str, Any] = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": (2.2 * field).tolist()},
        "pose": {"position_mm": [0, 0, distance], "rotations": tilt},
        "texture": texture,
        "motion": motion,
    }
    objects = [wall]
    if scene_type == "plates":
        wall["motion"], wall["pose"] = [], {"position_mm": [0, 0, distance + 25], "rotations": tilt[:1]}
        objects.append(
            {
                "name": "plate",
                "mesh": {"kind": "plane", "size_mm": (0.55 * field).tolist()},
                "pose": {"position_mm": [0, 0, distance - 15], "rotations": tilt[1:]},
                "texture": texture,
                "motion": motion,
            }
        )
    if scene_type == "box":
        edge = 0.62 * float(field[1])
        turn = [{"axis": [0, 1, 0], "angle_deg": 45}, {"axis": [1, 0, 0], "angle_deg": 35}]
        wall["mesh"] = {"kind": "box", "size_mm": [edge] * 3}
        wall["pose"] = {"position_mm": [0, 0, distance + 0.6 * edge], "rotations": turn}
    if scene_type == "relief":
        wave: dict[str, Any] = {"amplitude_mm": 3.0, "wavelength_mm": [0.6 * float(field[0])] * 2, "resolution_mm": 1.0}
        wall["mesh"] = {"kind": "relief", "size_mm": (2.2 * field).tolist(), **wave}
    sensor: dict[str, Any] = {"kind": "emva1288", "preset": "industrial_cmos"}
    sensor["photon_rate_per_s"] = 1.3e6 * float(draw.uniform(0.25, 1.0))
    return {
        "description": f"Random rig {seed}: {scene_type}",
        "camera": {
            "width": SIZE[0],
            "height": SIZE[1],
            "focal_length_px": focal,
            "principal_point_px": (np.array([119.5, 89.5]) + draw.uniform(-4, 4, 2)).tolist(),
            "distortion": {"k1": float(draw.uniform(-1.5, 1.5)), "p1": float(draw.uniform(-1e-3, 1e-3))},
        },
        "optics": {"psf": {"kind": "gaussian", "sigma_px": float(draw.uniform(0.55, 0.8))}},
        "stage": {
            "positions": positions,
            "baseline_mm": travel / (positions - 1),
            "errors": {"preset": str(draw.choice(["screw_stage", "air_bearing"]))},
        },
        "frames": {"count": int(draw.choice([3, 4, 5])), "frame_interval_s": 60},
        "objects": objects,
        "sensor": sensor,
        "render": {"backend": "raycast"},
        "seed": seed,
    }


def board_of(scene: Scene) -> dict[str, Any]:
    """Return a checkerboard that fits into all images of the stage."""
    distance = scene.objects[0].pose.position_mm[2]
    return {"kind": "checkerboard", "squares": [7, 6], "square_mm": round(19 * distance / scene.camera.focal_px, 2)}


def measure(folder: Path, scene: dict[str, Any], *, calibrated: bool = True) -> RigCalibration | None:
    """Simulate, calibrate, import and estimate a capture; the truth is moved out of its folder."""
    loaded = Scene.from_dict(scene)
    capture = folder / "capture"
    if not (folder / "truth").exists():
        given: dict[str, Any] = {"board": board_of(loaded), "dark": 8, "flat": 8, "static": 6}
        simulate_capture(scene, capture, poses=8, warp_mm=0.005, **given)
        shutil.copytree(capture / "truth", folder / "truth.partial", dirs_exist_ok=True)
        shutil.rmtree(capture / "truth")
        (folder / "truth.partial").rename(folder / "truth")
        if not calibrated:
            plain = yaml.safe_load((capture / "capture.yaml").read_text())
            plain["camera"] |= loaded.camera.model_dump(mode="json", exclude_none=True)
            (capture / "capture.yaml").write_text(yaml.safe_dump(plain))
    calibration = None
    if calibrated:
        file = folder / "calibration.yaml"
        if not file.exists():
            calibrate_capture(capture, output=folder)
        calibration = RigCalibration.load(file)
    run = folder / "run"
    if not (run / "recording.zarr").exists():
        lens: dict[str, Any] = {"calibration": calibration} if calibrated else {}
        import_capture(capture, output=run, **lens)
    if not (run / "estimate.refined.zarr").exists():
        recording = open_store(run / "recording.zarr").load()
        save_store(estimate(recording, "refined"), run / "estimate.refined.zarr")
    return calibration


def truth_of_recording(folder: Path, recording: xr.Dataset, axes: np.ndarray) -> xr.Dataset:
    """Return the exact truth on the pixels of a recording.

    ``axes``: Axes of the frame of the recording in that of the reference camera, as columns.
    """
    scene = load_scene(folder / "truth" / "scene.yaml")
    parameters = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text())
    (visit,) = [each for each in parameters["stage"]["visits"] if each["s"] == 0 and each["t"] == 0]
    rotation = Rotation.from_rotvec(visit["rotation_rad"]).as_matrix() @ axes
    turn = 1e6 * Rotation.from_matrix(rotation).as_rotvec()
    offset = 1e3 * np.array(visit["position_mm"])
    names = ("x_um", "y_um", "z_um", "pitch_urad", "yaw_urad", "roll_urad")
    pose = dict(zip(names, [*offset.tolist(), *turn.tolist()], strict=True))
    plain = scene.to_dict()
    # Disparity is that of the baseline of the recording.
    plain["stage"] = {"positions": 1, "baseline_mm": float(recording.attrs["baseline_mm"]), "poses": [pose]}
    plain["camera"] = {
        "width": recording.sizes["x"],
        "height": recording.sizes["y"],
        "focal_length_px": float(recording.attrs["focal_length_px"]),
        "principal_point_px": [float(value) for value in recording.attrs["principal_point_px"]],
    }
    if "distortion" in recording.attrs:
        lens = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        plain["camera"]["distortion"] = dict(zip(lens, map(float, recording.attrs["distortion"]), strict=False))
    plain["optics"] = {}
    return make_truth(Scene.from_dict(plain, folder=folder / "truth"))


def frame_axes(folder: Path, calibration: RigCalibration | None, recording: xr.Dataset) -> np.ndarray:
    """Return the axes of the frame of a recording in that of the true reference camera, as columns.

    A calibration knows the principal point to a pixel, and with it the direction of Z in the camera. Both frames are
    those of the same rays, so that the rotation is that of the rays of the recording to the true rays of its pixels.
    """
    if calibration is None or recording.attrs.get("geometry") != "rectified":
        return np.eye(3)
    width, height = recording.sizes["x"], recording.sizes["y"]
    pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7)), axis=-1).reshape(-1, 2)
    c = np.array(recording.attrs["principal_point_px"])
    rays = np.column_stack([(pixels - c) / float(recording.attrs["focal_length_px"]), np.ones(len(pixels))])
    points = float(recording.attrs["rectified_depth_mm"]) * rays
    recorded = recorded_pixels(calibration, points, calibration.reference)
    true_rays = load_scene(folder / "truth" / "scene.yaml").camera.ray_directions(recorded)
    one, other = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (true_rays, rays))
    return np.asarray(Rotation.align_vectors(one, other)[0].as_matrix())


def repeat(folder: Path, scene: dict[str, Any], number: int, calibration: RigCalibration | None) -> xr.Dataset:
    """Return the estimate of a repeated capture of the same rig, with other noise."""
    place = folder / f"repetition_{number}"
    file = place / "run" / "estimate.refined.zarr"
    if not file.exists():
        given: dict[str, Any] = {
            "poses": 0,
            "dark": 8,
            "flat": 8,
            "static": 0,
            "truth_maps": False,
            "noise_seed": 1000 + number,
        }
        simulate_capture(scene, place / "capture", **given)
        plain = yaml.safe_load((folder / "capture" / "capture.yaml").read_text())
        made = yaml.safe_load((place / "capture" / "capture.yaml").read_text())
        plain["files"] = made["files"]
        for name in ("board", "strip"):
            plain.pop(name, None)
        (place / "capture" / "capture.yaml").write_text(yaml.safe_dump(plain))
        lens: dict[str, Any] = {} if calibration is None else {"calibration": calibration}
        recording = import_capture(place / "capture", output=place / "run", **lens)
        save_store(estimate(recording.load(), "refined"), file)
    return open_store(file).load()


def errors_of(estimated: xr.Dataset, truth: xr.Dataset, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors of a quantity and the stated deviations of a pixel, shape (t, y, x), NaN where invalid."""
    variable, need = ("depth", "disparity") if name == "depth" else ("velocity", "motion")
    exact = truth.sel(t=estimated["t"].values)
    maps = [estimated[variable], exact[variable], estimated[f"{variable}_std"]]
    found, true, std = (np.asarray(each.values if name == "depth" else each.values[2], np.float64) for each in maps)
    valid = (estimated["status_disparity"].values == STATUS_VALID) & (
        estimated[f"status_{need}"].values == STATUS_VALID
    )
    return np.where(valid, found - true, np.nan), std


def spread_of(maps: Sequence[NDArray[np.float64]], inside: NDArray[np.bool_]) -> float:
    """Return the standard deviation of errors about the mean of their map, over all maps."""
    kept = [each[inside & np.isfinite(each)] for each in maps]
    values = [float(each.var()) for each in kept if each.size]
    return float(np.sqrt(np.mean(values))) if values else float("nan")


def compare_rig(seed: int, output: Path, *, calibrated: bool, draws: int, few: float) -> dict[str, Any]:
    """Return predicted and obtained errors of one rig.

    ``draws``: Simulations of the twin, and captures of the rig, if errors of one scatter by more than ``few``.
    """
    begin, folder = time.process_time(), output / f"rig_{seed:03d}"
    folder.mkdir(parents=True, exist_ok=True)
    scene = draw_scene(seed)
    calibration = measure(folder, scene, calibrated=calibrated)
    run = (folder / "capture", folder / "run", folder / "twin")
    predicted = run_twin(*run, calibration=calibration).prediction
    scatter = [predicted.value(name, "sampling_std").value for name in QUANTITIES]
    # The number follows from what the twin states, not from the comparison.
    count = draws if not max(scatter) <= few else 1
    if count > 1:
        predicted = run_twin(*run, calibration=calibration, draws=count).prediction
    recording = open_store(folder / "run" / "recording.zarr")
    truth = truth_of_recording(folder, recording, frame_axes(folder, calibration, recording)).load()
    estimates = [open_store(folder / "run" / "estimate.refined.zarr").load()]
    estimates += [repeat(folder, scene, number, calibration) for number in range(1, count)]
    twin = open_store(folder / "twin" / "run" / "estimate.refined.zarr").load()
    frames = estimates[0]["t"].values
    margin = ScoreSettings().interior_margin_px
    interior = main_regions(open_store(folder / "twin" / "run" / "truth.zarr").load().sel(t=frames), margin)["interior"]
    true_interior = main_regions(truth.sel(t=frames), margin)["interior"]
    row: dict[str, Any] = {"seed": seed, "scene": scene["description"].rsplit(" ", 1)[1], "draws": count}
    for name in QUANTITIES:
        found = [errors_of(each, truth, name) for each in estimates]
        shown = interior & np.isfinite(errors_of(twin, truth, name)[0])
        parts = [np.where(shown, errors, np.nan) for errors, _ in found]
        spread = spread_of(parts, shown)
        first = spread_of(parts[:1], shown)
        bias = float(np.mean([np.nanmean(each) for each in parts])) if np.isfinite(spread) else float("nan")
        value = {key: predicted.value(name, key).value for key in RegionError.__dataclass_fields__ if key in NUMBERS}
        own = [sampling_std(errors, std) for errors, (_, std) in zip(parts, found, strict=True)]
        scatter_own = float(np.sqrt(np.mean(np.square(own)) / count))
        row[name] = {
            "pixels": int(np.isfinite(parts[0]).sum()),
            "obtained_pixel": spread,
            "predicted_pixel": value["pixel_std"],
            "obtained_bias": bias,
            "predicted_common": value["common_std"],
            "pixel": value["pixel_std"] / spread,
            "single": value["pixel_std"] / first,
            "true_interior": value["pixel_std"] / spread_of([each for each, _ in found], true_interior),
            "total": value["rmse"] / float(np.hypot(spread, bias)),
            "stated": value["stated_capture"] / spread,
            "scatter": float(np.hypot(value["sampling_std"], scatter_own)),
        }
    row["differs"] = [each.name for each in predicted.comparisons if each.agrees is False]
    row["valid"] = float((estimates[0]["status_disparity"] == STATUS_VALID).mean())
    row["seconds"] = time.process_time() - begin
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--output", type=Path, default=Path("outputs/twins"))
    parser.add_argument("--draws", type=int, default=4, help="simulations and captures where errors of one scatter")
    parser.add_argument("--few", type=float, default=FEW, help="scatter of one simulation above which there are more")
    parser.add_argument("--uncalibrated", action="store_true", help="intrinsics are given, positions nominal")
    given = parser.parse_args()
    rows = []
    heads = "".join(
        f"{f'pixels {symbol}':>11} {'ratio':>6} {'±':>6} {'1 map':>6} {'true':>6}" for symbol in ("Z", "U_Z")
    )
    print(f"{'rig':>4} {'scene':7} {'draws':>5}{heads} {'bias/common Z':>14}")
    for seed in range(given.first, given.first + given.rigs):
        file = given.output / f"rig_{seed:03d}.json"
        if not file.exists():
            with warnings.catch_warnings():
                for category in (SceneWarning, CaptureWarning, EstimateWarning):
                    warnings.simplefilter("ignore", category)
                calibrated = not given.uncalibrated
                row = compare_rig(seed, given.output, calibrated=calibrated, draws=given.draws, few=given.few)
            file.write_text(json.dumps(row, indent=1))
        row = json.loads(file.read_text())
        rows.append(row)
        depth, rate = (row[name] for name in QUANTITIES)
        common = depth["obtained_bias"] / depth["predicted_common"] if depth["predicted_common"] else np.nan
        shown = "".join(
            f"{each['pixels']:11,} {each['pixel']:6.2f} {each['scatter']:6.2f} {each['single']:6.2f} "
            f"{each['true_interior']:6.2f}"
            for each in (depth, rate)
        )
        differs = ", ".join(row["differs"])
        print(f"{seed:4} {row['scene']:7} {row['draws']:5}{shown} {common:14.2f}  {differs}", flush=True)
    for name in QUANTITIES:
        for which in ("pixel", "single", "true_interior", "total", "stated"):
            ratios = np.array([row[name][which] for row in rows])
            inside = np.mean((ratios >= WANTED[0]) & (ratios <= WANTED[1]))
            print(
                f"{name:10} {which:13} predicted / obtained: geometric mean {np.exp(np.nanmean(np.log(ratios))):.2f}, "
                f"spread {np.exp(np.nanstd(np.log(ratios))):.2f}, between 0.8 and 1.25: {100 * inside:.0f} %"
            )
        ratios, scatter = (np.array([row[name][which] for row in rows]) for which in ("pixel", "scatter"))
        z = np.log(ratios) / scatter
        by_chance = np.nanmean(np.diff(norm.cdf(np.log(WANTED)[:, None] / scatter), axis=0))
        print(
            f"{name:10} scatter of the ratio {np.sqrt(np.nanmean(scatter**2)):.2f}, z {np.sqrt(np.nanmean(z**2)):.2f}; "
            f"an exact prediction would be between 0.8 and 1.25 in {100 * by_chance:.0f} %"
        )


if __name__ == "__main__":
    main()
