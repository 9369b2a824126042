"""Compare the refined method with the structure tensor: the table of docs/results/least_squares.md.

Run it from the top of the repository: ``python -m benchmarks.refined``, or with numbers of rows: ``... 0 1 2``.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st

SCENES = Path(__file__).parents[1] / "scenes"
IDEAL = ("sensor.noise_std=0", "sensor.bit_depth=16")
LATE = "frames.frame_interval_s=900"
# Scene, changes, object that is looked at.
CASES: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    ("cube, ideal", "cube", IDEAL, "cube"),
    ("cube", "cube", (), "cube"),
    ("cube, drift 1 %", "cube", ("lighting.drift_per_frame=0.01",), "cube"),
    ("cube, spotlight", "cube_spotlight", (), "cube"),
    ("relief", "relief", (), "relief"),
    ("leaf, 15 min, 0 %/h", "leaf", (LATE, "objects.0.deformation.0.rate_per_hour=0"), "leaf"),
    ("leaf, 15 min, 3 %/h", "leaf", (LATE,), "leaf"),
    ("leaf, 15 min, 6 %/h", "leaf", (LATE, "objects.0.deformation.0.rate_per_hour=0.06"), "leaf"),
    ("leaf, 1 min, 3 %/h", "leaf", (), "leaf"),
    ("soil under the leaf", "leaf", (LATE,), "soil"),
    ("rosette, 15 min", "rosette", (LATE,), ""),
    ("rosette, 1 min", "rosette", (), ""),
)
METHODS = ("structure_tensor", "refined")
# Pixels this far from edges are in the interior.
INTERIOR_PX = 20
# And these are beside outlines, on either side.
BESIDE_PX = ((2, 5), (5, 10), (10, 20))
Array = NDArray[np.float64]


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def both(values: Array) -> str:
    """Return median of the absolute values / root of their mean square."""
    return f"{np.median(np.abs(values)):.2g} / {rms(values):.2g}" if values.size else "-"


def row(found: xr.Dataset, truth: xr.Dataset, inside: NDArray[np.bool_]) -> list[str]:
    """Return what the table tells of an estimate in a region."""
    kept = inside & (found["status"].values == 2)

    def error(name: str) -> Array:
        return np.asarray((found[name].values - truth[name].values)[..., kept], dtype=np.float64)

    depth, velocity = error("depth"), error("velocity")
    scaled = [depth / found["depth_std"].values[kept], *(velocity / found["velocity_std"].values[:, kept])]
    cells = [f"{kept.sum() / inside.sum():.2f}", both(depth), f"{rms(error('disparity')):.2g}"]
    cells += [f"{rms(velocity[0]):.2g}, {rms(velocity[1]):.2g}"]
    cells += [f"{both(velocity[2])} ({velocity[2].mean():+.2g})"]
    per_hour = 360_000 / float(truth.attrs["frame_interval_s"])
    cells += [both(error("growth_rate") * per_hour) if "growth_rate" in found else "-"]
    cells += [", ".join(f"{rms(each):.2f}" for each in scaled)]
    cells += [", ".join(f"{100 * np.mean(np.abs(each) < 2):.0f}" for each in scaled)]
    cells += [f"{100 * np.mean(np.abs(scaled) > 6):.2f}"]
    return cells


def beside(found: xr.Dataset, truth: xr.Dataset, first: float, last: float) -> list[str]:
    """Return what the second table tells of the pixels so far from outlines, of all objects."""
    away = truth["boundary_distance"].values
    region = (away >= first) & (away < last) & np.isfinite(truth["depth"].values)
    known = region & (found["status"].values == 2)
    if not known.any():
        return []
    error = np.abs(found["depth"].values - truth["depth"].values)[known].astype(np.float64)
    scaled = error / found["depth_std"].values[known]
    cells = [f"{known.sum() / region.sum():.2f}", both(error), f"{100 * np.mean(error < 0.2):.0f}"]
    return [*cells, f"{100 * np.mean(scaled < 2):.0f}", f"{100 * np.mean(scaled > 6):.2f}"]


def main() -> None:
    """Print the tables, row by row."""
    warnings.simplefilter("ignore")
    chosen = [CASES[int(number)] for number in sys.argv[1:]] or CASES
    head = "scene | method | s | known | Z, mm | d, px | U_X, U_Y | U_Z, mm/frame (bias) | growth, %/h"
    head += " | error / std of Z, U_X, U_Y, U_Z | within 2, % | beyond 6, %"
    print(f"| {head} |\n|{head.count('|') * '---|'}---|")
    outlines: list[str] = []
    for label, name, changes, wanted in chosen:
        scene = st.load_scene(SCENES / f"{name}.yaml", overrides=list(changes))
        recording, truth = st.simulate(scene)
        numbers = [n for n, each in enumerate(json.loads(truth.attrs["object_names"])) if each.startswith(wanted)]
        one = truth.sel(t=0)
        inside = (one["boundary_distance"].values >= INTERIOR_PX) & np.isin(one["object_id"].values, numbers)
        for method in METHODS:
            settings = {"tau": "auto"} if method == "structure_tensor" else {}
            start = time.perf_counter()
            found = st.estimate(recording, method, settings).sel(t=0)
            seconds = time.perf_counter() - start
            print(f"| {' | '.join([label, method, f'{seconds:.1f}', *row(found, one, inside)])} |", flush=True)
            for first, last in BESIDE_PX:
                cells = beside(found, one, first, last)
                if cells:
                    outlines.append(f"| {' | '.join([label, method, f'{first:g} to {last:g}', *cells])} |")
    head = "scene | method | px from outlines | known | Z, mm | under 0.2 mm, % | within 2, % | beyond 6, %"
    print(f"\n| {head} |\n|{head.count('|') * '---|'}---|")
    print("\n".join(outlines))


if __name__ == "__main__":
    main()
