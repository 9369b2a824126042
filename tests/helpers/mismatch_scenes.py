"""Small scenes with slopes and with motion in all components, and estimates of them that are right but for noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

import scenetruth as st
from scenetruth.schema import label, read_intrinsics
from scenetruth.simulation import make_truth

Map = NDArray[np.float64]

VARIABLES = ("depth", "disparity", "flow", "velocity")

WALL: dict[str, Any] = {
    "name": "wall",
    "mesh": {
        "kind": "relief",
        "size_mm": [190, 170],
        "amplitude_mm": 5,
        "wavelength_mm": [60, 48],
        "resolution_mm": 2,
    },
    "pose": {
        "position_mm": [0, 0, 140],
        "rotations": [{"axis": [0, 1, 0], "angle_deg": 25}, {"axis": [1, 0, 0], "angle_deg": 15}],
    },
    "motion": [
        {"kind": "rotation", "axis": [0.3, 1, 0.5], "rate_deg_per_frame": 0.5},
        {"kind": "velocity", "velocity_mm_per_frame": [0.9, -0.5, -0.8]},
    ],
}
BALL: dict[str, Any] = {
    "name": "ball",
    "mesh": {"kind": "sphere", "radius_mm": 19, "resolution_mm": 2},
    "pose": {"position_mm": [-9, 6, 100]},
    "motion": [
        {"kind": "rotation", "axis": [1, 0.2, -0.4], "rate_deg_per_frame": 1.5},
        {"kind": "velocity", "velocity_mm_per_frame": [-1.2, 1.6, 1.1]},
    ],
}
BOX: dict[str, Any] = {
    "name": "box",
    "mesh": {"kind": "box", "size_mm": [34, 30, 30]},
    "pose": {
        "position_mm": [6, -4, 120],
        "rotations": [{"axis": [0, 1, 0], "angle_deg": 40}, {"axis": [1, 0, 0], "angle_deg": 25}],
    },
    "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.4, 0.7, -1]}],
}
PLANE: dict[str, Any] = {
    "name": "plane",
    "mesh": {"kind": "plane", "size_mm": [200, 200]},
    "pose": {"position_mm": [0, 0, 120], "rotations": [{"axis": [1, 1, 0], "angle_deg": 35}]},
    "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.5, 0.3, -1]}],
}
STILL: dict[str, Any] = {
    "name": "still",
    "mesh": {"kind": "plane", "size_mm": [400, 400]},
    "pose": {"position_mm": [0, 0, 120]},
}
FAR: dict[str, Any] = {**STILL, "name": "far", "pose": {"position_mm": [0, 0, 160]}}
STAIRS: dict[str, Any] = {
    "name": "stairs",
    "mesh": {"kind": "stairs", "steps_mm": [4, 4, 4, 4], "tread_mm": [22, 90]},
    "pose": {"position_mm": [0, 0, 110]},
    "motion": [{"kind": "velocity", "velocity_mm_per_frame": [1, 0, -1]}],
}


def truth_of(*objects: dict[str, Any], width: int = 64, height: int = 48, **camera: Any) -> xr.Dataset:
    """Return the truth of five positions and five frames, thirty a second."""
    plain = {
        "camera": {"width": width, "height": height, "focal_length_px": 90, **camera},
        "stage": {"positions": 5, "baseline_mm": 7},
        "frames": {"count": 5, "frame_interval_s": 1 / 30},
        "objects": [{**item, "texture": {"kind": "uniform"}} for item in objects],
        "render": {"backend": "raycast", "supersampling": 1},
    }
    return make_truth(st.Scene.from_dict(plain))


@dataclass(frozen=True)
class Errors:
    """What a method leaves.

    Parameters
    ----------
    noise, bias
        As a share of the value: of depth and disparity at the pixel, of motion the rms over the image.
    outliers, missing
        Shares of the pixels.
    blur_px
        Standard deviation of the window.
    coarse
        Share of the noise's variance that is smooth over some pixels.
    """

    noise: float = 0.005
    bias: float = 0.003
    outliers: float = 0.01
    missing: float = 0.05
    blur_px: float = 0.0
    coarse: float = 0.5


def right_estimate(truth: xr.Dataset, errors: Errors, seed: int) -> xr.Dataset:
    """Return an estimate without slips, of all frames."""
    rng = np.random.default_rng(seed)
    arrays = {name: _with_errors(truth[name].values, errors, rng) for name in VARIABLES}
    unknown = rng.random(truth["depth"].shape) < errors.missing
    for values in arrays.values():
        values[..., unknown] = np.nan
    return estimate_of(arrays, truth)


def estimate_of(arrays: dict[str, Map], like: xr.Dataset) -> xr.Dataset:
    """Return an estimate of the frames and pixels of another data set, unlike `make_estimate` with any signs."""
    maps = {name: np.asarray(values, dtype=np.float32) for name, values in arrays.items()}
    return label("estimate", maps, read_intrinsics(like), t=like["t"].values, y=like["y"].values, x=like["x"].values)


def _with_errors(true: Map, errors: Errors, rng: np.random.Generator) -> Map:
    stacked = true if true.ndim == 4 else true[np.newaxis]
    there = np.isfinite(stacked)
    filled = np.where(there, stacked, np.nanmedian(stacked))
    if errors.blur_px:
        filled = ndimage.gaussian_filter(filled, (0, 0, errors.blur_px, errors.blur_px))
    # Depth and disparity err by a share of themselves, motion by a share of what moves most, and of a little.
    size = np.abs(filled) if len(stacked) == 1 else np.sqrt(np.mean(filled**2)) + 0.02
    white = rng.standard_normal(filled.shape)
    smooth = ndimage.gaussian_filter(rng.standard_normal(filled.shape), (0, 0, 2, 2))
    noise = np.sqrt(1 - errors.coarse) * white + np.sqrt(errors.coarse) * smooth / smooth.std()
    bias = errors.bias * rng.choice([-1, 1], size=(len(filled), 1, 1, 1))
    found = filled * (1 + bias) + errors.noise * size * noise
    wrong = rng.random(filled.shape[1:]) < errors.outliers
    spread = np.ptp(filled) + np.std(filled) + 0.1 * np.abs(filled).max()
    found[:, wrong] += spread * rng.uniform(-1, 1, size=(len(filled), wrong.sum()))
    found = np.where(there, found, np.nan)
    return found if true.ndim == 4 else found[0]
