"""Rectified images against the true camera in the fit, and against an ideal rig, on simulated captures.

Run it from the top of the repository: ``python -m benchmarks.capture_rectification [--seeds N] [--scenes NAME ...]``.
Each scene is recorded by a rig with lens distortion, an inclined stage axis and errors of the guide, and by an ideal
rig. The poses and the lens of the calibration are exact, so that only the treatment of the images differs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

import scenetruth as st
from scenetruth.camera import Camera
from scenetruth.capture import RigCalibration, import_capture, simulate_capture
from scenetruth.capture.rectification import ideal_principal_point, ideal_rotation, recorded_pixels

__all__ = ["exact_calibration", "main", "make_scene", "true_maps"]

Floats = NDArray[np.float64]

LENS = {"k1": -0.6, "k2": 8.0, "p1": 1e-3, "p2": -8e-4}
_BORDER_PX, _SEEN_PX = 16, 92
_RIGS: dict[str, dict[str, Any]] = {
    "screw_stage": {
        "lens": LENS, "point": (165.7, 114.4), "tilt_urad": (4000.0, -3000.0),
        "errors": {"preset": "screw_stage", "repeatability_um": 0.0, "backlash_um": 0.0},
    },
    "ideal": {"lens": None, "point": (159.5, 119.5), "tilt_urad": None, "errors": None},
}  # fmt: skip


def make_scene(name: str, seed: int, rig: str = "screw_stage", size: tuple[int, int] = (320, 240)) -> dict[str, Any]:
    """Return a scene of the cube's rig at a smaller image size, with noise of 1 % of full scale."""
    given = _RIGS[rig]
    camera: dict[str, Any] = {"width": size[0], "height": size[1], "focal_length_px": 5016}
    camera["principal_point_px"] = [given["point"][0] * size[0] / 320, given["point"][1] * size[1] / 240]
    if given["lens"]:
        camera["distortion"] = given["lens"]
    stage: dict[str, Any] = {"positions": 5, "baseline_mm": 5.0}
    if given["errors"]:
        stage |= {"errors": given["errors"], "axis_tilt_urad": list(given["tilt_urad"])}
    texture = {"kind": "noise", "wavelength_mm": [0.8, 4.0], "mean": 0.5, "rms_contrast": 0.25}
    objects: list[dict[str, Any]]
    if name == "plane":
        objects = [{
            "name": "plane", "mesh": {"kind": "plane", "size_mm": [90, 70]}, "texture": texture,
            "pose": {"position_mm": [0, 0, 660], "rotations": [{"axis": [0.3, 1, 0], "angle_deg": 30}]},
            "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.1, -0.05, -0.6]}],
        }]  # fmt: skip
    else:
        objects = [{
            "name": "cube", "mesh": {"kind": "box", "size_mm": [49, 49, 49]}, "texture": texture,
            "pose": {
                "position_mm": [0, 0, 692.56],
                "rotations": [{"axis": [0, 1, 0], "angle_deg": 45}, {"axis": [1, 0, 0], "angle_deg": 20}],
            },
            "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, -1]}],
        }]  # fmt: skip
    return {
        "camera": camera, "stage": stage, "frames": {"count": 5, "frame_interval_s": 60}, "objects": objects,
        "sensor": {"bit_depth": 12, "noise_std": 0.01}, "render": {"backend": "raycast", "supersampling": 4},
        "seed": seed,
    }  # fmt: skip


def exact_calibration(folder: Path) -> RigCalibration:
    """Return the calibration with the true lens and the true poses of the images of frame 0."""
    plain = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text())
    lens, stage = plain["camera"], plain["stage"]
    given = yaml.safe_load((folder / "capture.yaml").read_text())["camera"]
    camera = Camera(
        width=given["width"], height=given["height"], focal_length_px=lens["focal_length_px"],
        principal_point_px=lens["principal_point_px"], distortion=lens["distortion"],
    )  # fmt: skip
    visits = sorted((visit for visit in stage["visits"] if visit["t"] == 0), key=lambda visit: visit["s"])
    x_mm = 5.0 * np.array([visit["s"] for visit in visits])
    plane = RigCalibration.from_camera(camera, x_mm)
    values = plane.values.copy()
    names = {name: index for index, name in enumerate(plane.names)}
    axis = np.array(stage["axis"])
    values[names["axis_y"]], values[names["axis_z"]] = axis[1:]
    values[names["step_scale"]] = stage["step_scale"]
    for index, (visit, x) in enumerate(zip(visits, x_mm, strict=True)):
        start = plane.layout.first_position + 6 * index
        values[start : start + 3] = visit["rotation_rad"]
        values[start + 3 : start + 6] = np.array(visit["position_mm"]) - x * (1 + stage["step_scale"]) * axis
    return RigCalibration(
        plane.width, plane.height, x_mm, plane.reference, plane.names, values, plane.covariance, plane.prior_std
    )


def true_maps(truth: xr.Dataset, camera: Camera, calibration: RigCalibration | None, t: int = 0) -> dict[str, Floats]:
    """Return true depth and velocity at the pixels of the ideal rig of a calibration, or of the recorded images.

    ``camera``: True camera, in whose frame and pixels the truth is.
    """
    now = truth.sel(t=t)
    depth, velocity = now["depth"].values, now["velocity"].values
    growth, away = now["growth_rate"].values, now["boundary_distance"].values
    if calibration is None:
        return {"depth": depth, "velocity": velocity, "growth_rate": growth, "away": away}
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(np.float64)
    c = np.array(ideal_principal_point(calibration))
    rays = np.dstack([(np.dstack([columns, rows]) - c) / calibration.value("f"), np.ones_like(rows)])
    seen = recorded_pixels(calibration, rays, calibration.reference)
    at = [seen[..., 1], seen[..., 0]]

    def sampled(values: Floats, order: int = 3) -> Floats:
        whole = np.where(np.isfinite(values), values, np.nanmedian(values))
        return np.asarray(map_coordinates(whole, at, order=order, mode="nearest"))

    turn = ideal_rotation(calibration)
    points = camera.ray_directions(seen) * sampled(depth)[..., None]
    moved = np.stack([sampled(each) for each in velocity], axis=-1) @ turn
    outside = ~((at[0] >= 0) & (at[0] <= depth.shape[0] - 1) & (at[1] >= 0) & (at[1] <= depth.shape[1] - 1))
    near = np.where(outside, 0.0, sampled(away, 1))
    growth_there = sampled(growth)
    return {"depth": (points @ turn)[..., 2], "velocity": moved.transpose(2, 0, 1), "growth_rate": growth_there,
            "away": near}  # fmt: skip


def known_poses(calibration: RigCalibration, depth_mm: float, size: tuple[int, int]) -> Floats:
    """Return shifts, roll and scale of the image of every position against an ideal stage, at a depth, (S, 4)."""
    f, c = calibration.value("f"), np.array([calibration.value("c_x"), calibration.value("c_y")])
    columns, rows = np.meshgrid(np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 7))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]) - c
    points = np.column_stack([pixels / f, np.ones(len(pixels))]) * depth_mm
    found = []
    for index in range(len(calibration.positions_mm)):
        view = calibration.viewpoint(index)
        inside = view.to_camera(points)
        actual = f * inside[:, :2] / inside[:, 2:]
        along = step_mm(calibration, index)
        nominal = pixels - [f * along / depth_mm, 0.0]
        x, y = nominal.T
        one, none = np.ones_like(x), np.zeros_like(x)
        design = np.concatenate([np.stack([one, none, -y, x], axis=1), np.stack([none, one, x, y], axis=1)])
        found.append(np.linalg.lstsq(design, (actual - nominal).T.ravel(), rcond=None)[0])
    return np.array(found)


def step_mm(calibration: RigCalibration, index: int) -> float:
    """Return the displacement of a position along the axis."""
    from scenetruth.capture.rectification import step_factor

    along = calibration.positions_mm - calibration.positions_mm[calibration.reference]
    return float(step_factor(calibration) * along[index])


def estimate_recorded(folder: Path, calibration: RigCalibration, depth_mm: float) -> xr.Dataset:
    """Return the estimate from the recorded pixels, with the lens and the poses of the calibration in the fit."""
    from dataclasses import replace
    from unittest.mock import patch

    from scenetruth.estimators.refined.frame_task import FrameTask

    recording = import_capture(folder)
    camera = calibration.camera
    attrs = {
        "focal_length_px": camera.focal_px, "principal_point_px": list(camera.principal_point),
        "baseline_mm": step_mm(calibration, calibration.reference + 1),
    }  # fmt: skip
    if camera.distortion is not None:
        attrs["distortion"] = list(camera.distortion.coefficients)
    recording = without_tolerances(recording.assign_attrs(attrs))
    recording = recording.assign_coords(
        stage_x_mm=("s", [step_mm(calibration, index) for index in range(recording.sizes["s"])])
    )
    poses = known_poses(calibration, depth_mm, (calibration.width, calibration.height))
    outline = FrameTask._outline

    def with_poses(self: Any, frames: Any) -> Any:
        found = outline(self, frames)
        return replace(found, moved=np.tile(poses, (len(found.times), 1)))

    with patch.object(FrameTask, "_outline", with_poses):
        return st.estimate(recording, "refined")


def without_tolerances(recording: xr.Dataset) -> xr.Dataset:
    """Return a recording that states no tolerances."""
    kept = {name: value for name, value in recording.attrs.items() if not str(name).startswith("stage_tolerance_")}
    found = recording.copy()
    found.attrs = kept
    return found


def assess(estimate: xr.Dataset, true: dict[str, Floats], among: NDArray[np.bool_]) -> list[float]:
    """Return the mean error of depth, and of depth and U_Z what a plane does not explain, and z of that."""
    now = estimate.sel(t=0)
    rows, columns = np.nonzero(among)
    design = np.column_stack([np.ones(len(rows)), columns, rows])
    found: list[float] = []
    for error, std in (
        (now["depth"].values - true["depth"], now["depth_std"].values),
        (now["velocity"].values[2] - true["velocity"][2], now["velocity_std"].values[2]),
    ):
        own = error[among]
        rest = own - design @ np.linalg.lstsq(design, own, rcond=None)[0]
        found += [float(own.mean()), float(rest.std()), float(np.sqrt(np.mean((rest / std[among]) ** 2)))]
    return found


def estimate_all(scene: str, seed: int, scratch: Path) -> dict[str, tuple[xr.Dataset, dict[str, Floats], float]]:
    """Return estimate, truth and processor time for every treatment of the images."""
    found = {}

    def add(name: str, recording: xr.Dataset | None, true: dict[str, Floats], estimate: Any = None) -> None:
        begin = time.process_time()
        made = estimate() if recording is None else st.estimate(recording, "refined")
        found[name] = (made, true, time.process_time() - begin)

    for rig in ("ideal", "screw_stage"):
        folder = simulate_capture(
            make_scene(scene, seed, rig), scratch / rig, poses=0, dark=0, flat=0, static=0, step_std=1e-12
        )
        calibration = exact_calibration(folder)
        camera, truth = calibration.camera, st.load_store(folder / "truth" / "truth.zarr")
        recorded = true_maps(truth, camera, None)
        if rig == "ideal":
            # The capture file states the focal length of a data sheet.
            plain = import_capture(folder).assign_attrs(focal_length_px=camera.focal_px)
            add("ideal rig", without_tolerances(plain), recorded)
            continue
        recording = without_tolerances(import_capture(folder, calibration=calibration))
        rectified = true_maps(truth, camera, calibration)
        add("rectified", recording, rectified)
        add("rectified, share unknown", recording.drop_vars("noise_share"), rectified)
        depth_mm = float(recording.attrs["rectified_depth_mm"])
        known = partial(estimate_recorded, folder, calibration, depth_mm)
        add("recorded, poses given", None, recorded, known)
        add("recorded, poses estimated", import_capture(folder, calibration=calibration, geometry="recorded"), recorded)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", nargs="+", default=["plane", "cube"])
    given = parser.parse_args()
    for scene in given.scenes:
        rows: dict[tuple[str, str], list[list[float]]] = {}
        for seed in range(given.first, given.first + given.seeds):
            with tempfile.TemporaryDirectory() as scratch:
                found = estimate_all(scene, seed, Path(scratch))
            valid = np.logical_and.reduce([
                made.sel(t=0)["valid"].values & (true["away"] > _BORDER_PX) for made, true, _ in found.values()
            ])  # fmt: skip
            inside = np.zeros_like(valid)
            # Pixels that all cameras see, with their windows.
            inside[_BORDER_PX:-_BORDER_PX, _SEEN_PX:-_SEEN_PX] = True
            for name, (made, true, seconds) in found.items():
                for part, among in (("seen by all", valid & inside), ("all", valid)):
                    values = [*assess(made, true, among), seconds]
                    rows.setdefault((part, name), []).append(values)
        for part in ("seen by all", "all"):
            print(f"{scene}, {given.seeds} captures, pixels {part}")
            print(f"{'images':27} {'dZ mean':>8} {'rest, mm':>9} {'loss':>7} {'z':>5}"
                  f" {'U_Z rest':>9} {'loss':>7} {'z':>5} {'cpu s':>6}")  # fmt: skip
            ideal = np.sqrt(np.mean(np.square(rows[part, "ideal rig"]), axis=0))
            for name in found:
                own = np.sqrt(np.mean(np.square(rows[part, name]), axis=0))
                loss = own / ideal - 1
                print(f"{name:27} {own[0]:8.4f} {own[1]:9.4f} {loss[1]:+7.1%} {own[2]:5.2f}"
                      f" {own[4]:9.5f} {loss[4]:+7.1%} {own[5]:5.2f} {own[6]:6.1f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
