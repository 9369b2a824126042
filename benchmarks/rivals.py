"""Compare the estimator with OpenCV's stereo and optical flow on the noise cube, and print a table in Markdown.

All methods run through `scenetruth.estimate`, and all figures come from `scenetruth.score`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import scenetruth as st

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"

METHODS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("StereoSGBM (3-way)", "opencv_stereo", {"stereo": "sgbm", "min_disparity_px": 16}),
    ("StereoBM", "opencv_stereo", {"stereo": "bm", "min_disparity_px": 16}),
    ("Farnebäck", "opencv_flow", {"flow": "farneback"}),
    ("DIS (medium)", "opencv_flow", {"flow": "dis"}),
    ("StereoSGBM + Farnebäck", "opencv_scene_flow", {"min_disparity_px": 16}),
    (
        "4D structure tensor, one working point",
        "structure_tensor",
        {"working_point_px": 37, "flow_working_point_px": (0, 0)},
    ),
    (
        "4D structure tensor, one working point, paper",
        "structure_tensor",
        {"working_point_px": 37, "flow_working_point_px": (0, 0), "divergence": "paper"},
    ),
    ("4D structure tensor, working point per pixel", "structure_tensor", {}),
    ("refined", "refined", {}),
)
COLUMNS = {"disparity": "px", "depth": "mm", "flow_x": "px", "flow_y": "px", "velocity_z": "mm/frame"}


def timed(function: Callable[[], Any], runs: int = 5) -> tuple[Any, float]:
    """Return a result and the median processor time of several runs, after one to warm up."""
    result, seconds = function(), []
    for _ in range(runs):
        start = time.process_time()
        result = function()
        seconds.append(time.process_time() - start)
    return result, float(np.median(seconds))


def compare(recording: xr.Dataset, truth: xr.Dataset) -> Iterator[list[str]]:
    """Yield the rows of the table: method, rms errors in the interior, seconds for each frame."""
    for title, method, settings in METHODS:
        found, seconds = timed(partial(st.estimate, recording, method, settings))
        interior = st.score(found.sel(t=[0]), truth, recording).regions["interior"]
        errors = [f"{interior[name]['rmse']:.2g}" if name in interior else "" for name in COLUMNS]
        yield [title, *errors, f"{seconds / found.sizes['t']:.3f}"]


def main() -> None:
    """Render the cube as its scene file says, and print the table."""
    recording, truth = st.simulate(st.load_scene(SCENE, overrides=["render.backend=raycast"]))
    print("| method |", " | ".join(f"{name}, {unit}" for name, unit in COLUMNS.items()), "| processor s per frame |")
    print("|---" * (len(COLUMNS) + 2) + "|")
    for row in compare(recording, truth):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
