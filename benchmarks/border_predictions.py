"""Errors of depth by `refined` beside predictions: pixels that all images show within whole windows, and the others.

The last column is the RMSE of all valid pixels relative to the predicted RMSE; the others are relative to the median.

Run it from the top of the repository: ``python -m benchmarks.border_predictions``; a wall that fills images of
160 x 120 px, noise texture of 4 to 24 px, noise of 1 %, 500 mm away, steps of 4 mm (8 px), three seeds.
"""

from __future__ import annotations

import numpy as np

import scenetruth as st
from benchmarks.jobs import heading, line

__all__ = ["measure", "wall"]

WIDTH, HEIGHT, FOCAL_PX, DEPTH_MM = 160, 120, 1000.0, 500.0
REACH_PX = 12
SEEDS = (1, 2, 3)
COLUMNS = (
    "tilt, degrees",
    "cameras",
    "maps, mm",
    "whole windows, %",
    "RMSE",
    "scaled median",
    "z",
    "others: RMSE",
    "std",
    "all: RMSE",
)


def wall(cameras: int, tilt_deg: float, seed: int) -> st.Scene:
    """Return the scene of a wall."""
    plate = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [140, 110]},
        "pose": {"position_mm": [0, 0, DEPTH_MM], "rotations": [{"axis": [0, 1, 0], "angle_deg": tilt_deg}]},
        "texture": {"kind": "noise", "wavelength_mm": [2, 12], "mean": 0.5, "rms_contrast": 0.25},
    }
    plain = {
        "camera": {"width": WIDTH, "height": HEIGHT, "focal_length_px": FOCAL_PX},
        "stage": {"positions": cameras, "baseline_mm": 4.0},
        "frames": {"count": 1},
        "objects": [plate],
        "sensor": {"kind": "gaussian", "noise_std": 0.01},
        "render": {"backend": "raycast"},
        "seed": seed,
    }
    return st.Scene.from_dict(plain)


def measure(cameras: int, tilt_deg: float, seed: int) -> dict[str, float]:
    """Return errors of depth relative to the prediction from images, for both groups of pixels."""
    scene = wall(cameras, tilt_deg, seed)
    prediction = st.predict(scene, method="refined", model="maps")
    predicted = prediction.precision("depth", "interior").value
    recording, truth = st.simulate(scene)
    estimate = st.estimate(recording, "refined")
    error, std = (estimate["depth"] - truth["depth"]).values[0], estimate["depth_std"].values[0]
    valid = estimate["valid"].values[0] & np.isfinite(error)
    rows, columns = np.indices(error.shape)
    whole = (rows >= REACH_PX) & (rows < HEIGHT - REACH_PX)
    for x_mm in recording["stage_x_mm"].values:
        place = columns - FOCAL_PX * x_mm / truth["depth"].values[0]
        whole &= (place >= REACH_PX) & (place <= WIDTH - 1 - REACH_PX)
    inner, outer = valid & whole, valid & ~whole
    return {
        "predicted": predicted,
        "share": float(whole.mean()),
        "rmse": _rms(error[inner]) / predicted,
        "median": 1.4826 * float(np.median(np.abs(error[inner]))) / predicted,
        "z": _rms(error[inner] / std[inner]),
        "rmse_others": _rms(error[outer]) / predicted,
        "std_others": _rms(std[outer]) / predicted,
        "all": _rms(error[valid]) / prediction.precision("depth", "all").rmse,
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    print(heading(COLUMNS))
    for tilt in (0.0, 40.0):
        for count in (2, 3, 5, 9):
            runs = [measure(count, tilt, seed) for seed in SEEDS]
            means = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
            ratios = (means[name] for name in ("rmse", "median", "z", "rmse_others", "std_others", "all"))
            first = f"{tilt:g}", count, f"{means['predicted']:.3f}", f"{100 * means['share']:.0f}"
            print(line([*first, *(f"{one:.2f}" for one in ratios)]), flush=True)
