"""Predicted errors of twins against obtained errors: random rigs, simulated, calibrated, estimated, and scored.

Run it from the top of the repository: ``python -m benchmarks.twin [--rigs N] [--first SEED] [--output FOLDER]``.
Each rig has its own scene (plane, plates, box or relief), texture, lens with distortion and blur, stage errors, sensor
and exposure. The twin has the capture without its truth. Ratios are predicted / obtained errors of the interior:
``pixel`` about their mean, ``total`` with the mean and, in the prediction, the uncertainty of the calibration. Both
errors scatter, because they have few independent values: z is the logarithm of the ratio over its standard deviation.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from scenetruth.capture import RigCalibration, calibrate_capture, import_capture, run_twin, simulate_capture
from scenetruth.capture.rectification import recorded_pixels
from scenetruth.capture.twin import sampling_std
from scenetruth.errors import CaptureWarning, EstimateWarning, SceneWarning
from scenetruth.estimators import estimate
from scenetruth.scene import Scene, load_scene
from scenetruth.schema import STATUS_VALID
from scenetruth.scoring import score
from scenetruth.scoring.regions import main_regions
from scenetruth.settings import ScoreSettings
from scenetruth.storage import open_store, save_store
from scenetruth.truth import make_truth

__all__ = ["draw_scene", "main", "measure", "truth_of_recording"]

SIZE = (240, 180)
QUANTITIES = ("depth", "velocity_z")
WANTED = (0.8, 1.25)


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


def _obtained_scatter(truth: xr.Dataset, estimated: xr.Dataset, name: str) -> float:
    """Return the relative scatter of the obtained error in the interior."""
    frames = estimated["t"].values
    exact = truth.sel(t=frames)
    variable, needs = ("depth", "disparity") if name == "depth" else ("velocity", "motion")
    found, true = (
        each[variable].values if name == "depth" else each[variable].values[2] for each in (estimated, exact)
    )
    inside = main_regions(exact, ScoreSettings().interior_margin_px)["interior"]
    valid = inside & (estimated[f"status_{needs}"].values == STATUS_VALID)
    return sampling_std(np.where(valid, found - true, np.nan))


def compare_rig(seed: int, output: Path, *, calibrated: bool) -> dict[str, Any]:
    """Return predicted and obtained errors of one rig."""
    begin, folder = time.process_time(), output / f"rig_{seed:03d}"
    folder.mkdir(parents=True, exist_ok=True)
    calibration = measure(folder, draw_scene(seed), calibrated=calibrated)
    predicted = run_twin(folder / "capture", folder / "run", folder / "twin", calibration=calibration).prediction
    recording = open_store(folder / "run" / "recording.zarr")
    truth = truth_of_recording(folder, recording, frame_axes(folder, calibration, recording))
    estimated = open_store(folder / "run" / "estimate.refined.zarr")
    obtained = score(estimated, truth, recording, allow_mismatch=True).regions["interior"]
    row: dict[str, Any] = {"seed": seed, "scene": draw_scene(seed)["description"].rsplit(" ", 1)[1]}
    for name in QUANTITIES:
        real = obtained[name]
        bias, rmse = float(real["bias"] or 0.0), float(real["rmse"] or np.nan)
        spread = float(np.sqrt(max(rmse**2 - bias**2, 0.0)))
        row[name] = {
            "obtained_pixel": spread,
            "predicted_pixel": predicted.value(name, "pixel_std").value,
            "obtained_bias": bias,
            "predicted_common": predicted.value(name, "common_std").value,
            "pixel": predicted.value(name, "pixel_std").value / spread,
            "total": predicted.value(name).value / rmse,
            "stated": predicted.value(name, "stated_capture").value / spread,
            "scatter": float(
                np.hypot(predicted.value(name, "sampling_std").value, _obtained_scatter(truth, estimated, name))
            ),
        }
    row["differs"] = [each.name for each in predicted.comparisons if each.agrees is False]
    row["seconds"] = time.process_time() - begin
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--output", type=Path, default=Path("outputs/twins"))
    parser.add_argument("--uncalibrated", action="store_true", help="intrinsics are given, positions nominal")
    given = parser.parse_args()
    rows = []
    heads = f"{'pixel Z':>8} {'pixel U_Z':>9} {'total Z':>8} {'total U_Z':>9} {'bias/common Z':>13}"
    print(f"{'rig':>4} {'scene':7} {heads}")
    for seed in range(given.first, given.first + given.rigs):
        file = given.output / f"rig_{seed:03d}.json"
        if not file.exists():
            with warnings.catch_warnings():
                for category in (SceneWarning, CaptureWarning, EstimateWarning):
                    warnings.simplefilter("ignore", category)
                row = compare_rig(seed, given.output, calibrated=not given.uncalibrated)
            file.write_text(json.dumps(row, indent=1))
        row = json.loads(file.read_text())
        rows.append(row)
        depth, rate = (row[name] for name in QUANTITIES)
        common = depth["obtained_bias"] / depth["predicted_common"] if depth["predicted_common"] else np.nan
        print(
            f"{seed:4} {row['scene']:7} {depth['pixel']:8.2f} {rate['pixel']:9.2f} {depth['total']:8.2f} "
            f"{rate['total']:9.2f} {common:13.2f}  {', '.join(row['differs'])}",
            flush=True,
        )
    for name in QUANTITIES:
        for which in ("pixel", "total", "stated"):
            ratios = np.array([row[name][which] for row in rows])
            inside = np.mean((ratios >= WANTED[0]) & (ratios <= WANTED[1]))
            print(
                f"{name:10} {which:6} predicted / obtained: geometric mean {np.exp(np.nanmean(np.log(ratios))):.2f}, "
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
