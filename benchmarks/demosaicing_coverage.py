"""Standard deviations of ``refined`` behind a Bayer filter: errors relative to them, as a table in Markdown.

Run from the top of the repository: ``python -m benchmarks.demosaicing_coverage``.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion

import scenetruth as st
from benchmarks.jobs import heading, line

FOCAL_LENGTH_PX, DISTANCE_MM = 1500.0, 600.0
MARGIN_PX = 8
LEAF = {"kind": "leaf", "outline": "ovate", "length_mm": 70, "width_mm": 55, "fold_deg": 10}
BALL = {"kind": "sphere", "radius_mm": 40}
TUBE = {"kind": "cylinder", "radius_mm": 35, "length_mm": 90}
BOX = {"kind": "box", "size_mm": [50, 50, 50]}
TINTS = {
    "grey": None,
    "coloured": {"red": 1.0, "green": 0.6, "blue": 0.3},
    "green": {"red": 0.3, "green": 1.0, "blue": 0.25},
    "red": {"red": 1.0, "green": 0.25, "blue": 0.3},
}
CASES: dict[str, tuple[dict[str, Any], tuple[float, float], str, float]] = {
    "box": (BOX, (3, 12), "grey", 2.9),
    "leaf": (LEAF, (5, 24), "coloured", 2.1),
    "green leaf": (LEAF, (2, 20), "green", 2.55),
    "ball, held out": (BALL, (3, 20), "coloured", 2.7),
    "green leaf, held out": (LEAF, (4, 16), "green", 3.3),
    "red leaf": (LEAF, (4, 18), "red", 2.5),
    "cylinder": (TUBE, (5, 15), "grey", 2.3),
}
"""Mesh, wavelengths of the texture in px, colour, and baseline in mm."""
NOISES = (0.003, 0.02)


def scene(case: str, method: str, noise: float) -> dict[str, Any]:
    """Return a textured object that moves under a disc lamp, before a wall."""
    mesh, (shortest, longest), colour, baseline_mm = CASES[case]
    px = DISTANCE_MM / FOCAL_LENGTH_PX
    place = [-35.0, 0.0, DISTANCE_MM] if mesh is LEAF else [0.0, 0.0, DISTANCE_MM + 20 * (mesh is BOX)]
    turned = [{"axis": [0, 1, 0], "angle_deg": 45}, {"axis": [1, 0, 0], "angle_deg": 20}] if mesh is BOX else []
    item: dict[str, Any] = {
        "name": "object",
        "mesh": mesh,
        "texture": {"kind": "noise", "wavelength_mm": [shortest * px, longest * px], "mean": 0.4},
        "pose": {"position_mm": place, "rotations": turned},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.11, 0.05, -0.2]}],
    }
    if TINTS[colour] is not None:
        item["tint"] = TINTS[colour]
    wall = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [600, 500]},
        "texture": {"kind": "noise", "wavelength_mm": [3 * px, 30 * px], "mean": 0.4},
        "pose": {"position_mm": [0, 0, DISTANCE_MM + 60]},
    }
    lamp = {"kind": "disc", "position_mm": [-200, -300, 100], "target_mm": [0, 0, DISTANCE_MM], "radius_mm": 40}
    return {
        "camera": {"width": 130, "height": 100, "focal_length_px": FOCAL_LENGTH_PX, "bands": ["red", "green", "blue"]},
        "stage": {"positions": 5, "baseline_mm": baseline_mm},
        "frames": {"count": 3},
        "lighting": {"ambient": 0.15, "lights": [{**lamp, "irradiance": 0.9, "reference_distance_mm": 600}]},
        "background": 0.05,
        "objects": [item, wall],
        "sensor": {"noise_std": noise, "bit_depth": 12, "bayer": "rggb", "demosaicing": method},
        "score": {"interior_margin_px": MARGIN_PX},
    }


def measured(case: str, method: str, noise: float) -> list[str]:
    """Return RMSE and RMS z-score of depth, RMS z-scores of U_X and U_Y, share beyond six deviations, valid pixels."""
    found = st.simulate(scene(case, method, noise))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", st.EstimateWarning)
        estimate = st.estimate(found.recording, "refined").isel(t=0)
    truth = found.truth.sel(t=estimate["t"])
    inner = binary_erosion(truth["object_id"].values == 0, iterations=MARGIN_PX)
    valid = inner & estimate["valid"].values.astype(bool)
    if not valid.any():
        return ["", "", "", "", "", "0"]
    error = (estimate["depth"] - truth["depth"]).values[valid]
    z = error / estimate["depth_std"].values[valid]
    moved = (estimate["velocity"] - truth["velocity"]) / estimate["velocity_std"]
    across, down = (moved.sel(component=component).values[valid] for component in "XY")
    beyond = np.maximum(np.abs(z), np.abs(across)) > 6
    rms = [float(np.sqrt(np.mean(values**2))) for values in (error, z, across, down)]
    return [*(f"{each:.2f}" for each in rms), f"{100 * beyond.mean():.2f}", f"{100 * valid.sum() / inner.sum():.0f}"]


def main() -> None:
    """Print the table."""
    columns = [
        "RMSE of Z, mm",
        "RMS z-score of Z",
        "RMS z-score of U_X",
        "RMS z-score of U_Y",
        "beyond 6, %",
        "valid, %",
    ]
    print(heading(["object", "waves, px", "colour", "demosaicing", "noise, %", *columns]))
    for case, (_, (shortest, longest), colour, _) in CASES.items():
        for method in ("malvar", "bilinear", "binomial"):
            for noise in NOISES:
                cells = measured(case, method, noise)
                print(line([case, f"{shortest} to {longest}", colour, method, f"{100 * noise:g}", *cells]), flush=True)


if __name__ == "__main__":
    main()
