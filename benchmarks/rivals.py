"""Compare the estimator with OpenCV's stereo and optical flow on the noise cube, and print a table in Markdown."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scoring import region_masks

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"
Map = NDArray[np.float64]

# Disparities from 16 to 48 px hold the cube's 34 to 39 px.
_LOWEST_PX, _RANGE_PX = 16, 32


def stereo_sgbm(left: Any, right: Any) -> Map:
    """Semi-global matching in three directions."""
    import cv2

    block = 7
    matcher = cv2.StereoSGBM.create(
        _LOWEST_PX, _RANGE_PX, block, P1=8 * block**2, P2=32 * block**2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY
    )
    return _disparity(matcher.compute(left, right))


def stereo_bm(left: Any, right: Any) -> Map:
    """Block matching."""
    import cv2

    matcher = cv2.StereoBM.create(_RANGE_PX, 21)
    matcher.setMinDisparity(_LOWEST_PX)
    return _disparity(matcher.compute(left, right))


def _disparity(fixed: Any) -> Map:
    """Turn OpenCV's sixteenths of a pixel into px; what it could not match is below the least disparity."""
    values = fixed.astype(np.float64) / 16
    values[values < _LOWEST_PX] = np.nan
    return np.asarray(values)


def farneback(first: Any, second: Any) -> Map:
    """Farnebäck's polynomial expansion with a window like the estimator's."""
    import cv2

    flow = cv2.calcOpticalFlowFarneback(first, second, None, 0.5, 3, 25, 3, 7, 1.5, cv2.OPTFLOW_FARNEBACK_GAUSSIAN)
    return np.moveaxis(np.asarray(flow, dtype=np.float64), -1, 0)


def dis(first: Any, second: Any) -> Map:
    """Dense inverse search."""
    import cv2

    return np.moveaxis(
        np.asarray(cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None), np.float64),
        -1,
        0,
    )


def timed(function: Callable[[], Any], runs: int = 7) -> tuple[Any, float]:
    """Return a result and the median time of several runs, after one to warm up."""
    result, seconds = function(), []
    for _ in range(runs):
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return result, float(np.median(seconds))


def compare(recording: xr.Dataset, truth: xr.Dataset) -> list[tuple[str, str, str, str, str]]:
    """Return the rows of the table: method, images, disparity rms, flow endpoint error rms, time."""
    now = truth.sel(t=0)
    interior = region_masks(truth["depth"].sel(t=[0]).values, truth["mixed"].sel(t=[0]).values)["interior"][0]
    images = recording["image"]
    left, right, later = (images.sel(s=s, t=t).values for s, t in ((0, 0), (1, 0), (0, 1)))
    rows = []
    for name, method in (("StereoSGBM (3-way)", stereo_sgbm), ("StereoBM", stereo_bm)):
        found, seconds = timed(lambda method=method: method(left, right))
        rows.append((name, "2", *_error(found - now["disparity"].values, interior), "", _time(seconds)))
    for name, method in (("Farnebäck", farneback), ("DIS (medium)", dis)):
        found, seconds = timed(lambda method=method: method(left, later))
        distance = np.hypot(*(found - now["flow"].values))
        rows.append((name, "2", "", *_error(distance, interior), _time(seconds)))
    variants: dict[str, dict[str, Any]] = {
        "one working point": {"working_point_px": 37, "flow_working_point_px": (0, 0)},
        "one working point, paper": {
            "working_point_px": 37,
            "flow_working_point_px": (0, 0),
            "divergence": "paper",
        },
        "working point per pixel": {},
    }
    for name, settings in variants.items():
        maps, seconds = timed(lambda settings=settings: st.estimate(recording, **settings).sel(t=0))
        inside = interior & (maps["kind"].values == 2)
        distance = np.hypot(*(maps["flow"] - now["flow"]).values)
        errors = (*_error((maps["disparity"] - now["disparity"]).values, inside), *_error(distance, inside))
        rows.append((f"4D structure tensor, {name}", "45", *errors, _time(seconds)))
    return rows


def _error(values: Map, region: NDArray[np.bool_]) -> tuple[str]:
    chosen = values[region & np.isfinite(values)]
    return (f"{np.sqrt(np.mean(chosen**2)):.2g}",)


def _time(seconds: float) -> str:
    return f"{seconds:.3f}"


def main() -> None:
    """Render the cube as its scene file says, and print the table."""
    recording, truth = st.simulate(st.load_scene(SCENE, ["render.backend=raycast"]))
    print("| method | images | disparity, rms in px | flow, endpoint error rms in px | time in s |")
    print("|---|---|---|---|---|")
    for row in compare(recording, truth):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
