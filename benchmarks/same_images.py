"""What the refined method makes of four images of the shipped cube: two positions, two frames.

Run it from the top of the repository: ``python -m benchmarks.same_images``. Digital image correlation of the outermost
positions, pyvale's with subsets of 31 px, leaves 0.031 mm of depth and 0.043 mm per frame of U_Z (root of the mean
square, pixels 20 px and more from edges).
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"
# Pixels this far from edges are in the interior.
INTERIOR_PX = 20
# Left and right position, frames.
PAIRS = ((-2, 2), (-1, 1), (0, 1))
FRAMES = (0, 1)
SETTINGS: tuple[dict[str, object], ...] = (
    {},
    {"motion": "translation"},
    {"window_sigma_px": 9, "motion": "rigid"},
    {"window_sigma_px": 9, "motion": "translation"},
)


def pair_of(recording: xr.Dataset, truth: xr.Dataset, left: int, right: int) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the images of two positions as a recording whose reference is the left one, and the truth of that one."""
    four = recording.sel(s=[left, right], t=list(FRAMES))
    places = four["stage_x_mm"].values - four["stage_x_mm"].values[0]
    four = four.assign_coords(s=[0, 1], stage_x_mm=("s", places))
    four.attrs["baseline_mm"] = float(places[1])
    return four, truth.sel(s=left, t=list(FRAMES))


def row(found: xr.Dataset, truth: xr.Dataset) -> list[str]:
    """Return the share that is known in the interior, and rms errors and error / stated std of depth and U_Z."""
    inside = (truth["boundary_distance"].values >= INTERIOR_PX) & np.isfinite(truth["depth"].values)
    kept = inside & (found["kind"].values == 2)

    def rms(values: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean(np.square(values[kept]))))

    depth = found["depth"].values - truth["depth"].values
    speed = (found["velocity"].values - truth["velocity"].values)[2]
    scaled = [rms(depth / found["depth_std"].values), rms(speed / found["velocity_std"].values[2])]
    shares = [f"{kept.sum() / inside.sum():.3f}", f"{rms(depth):.4f}", f"{rms(speed):.4f}"]
    return [*shares, f"{float(speed[kept].mean()):+.4f}", ", ".join(f"{each:.2f}" for each in scaled)]


def main() -> None:
    """Print the table, row by row."""
    warnings.simplefilter("ignore")
    recording, truth = st.simulate(st.load_scene(SCENE), truth_views="all")
    print("| base, mm | settings | known | Z, mm | U_Z, mm/frame | bias of U_Z | error / std of Z, U_Z | s |")
    print(f"|{8 * '---|'}", flush=True)
    for left, right in PAIRS:
        four, known = pair_of(recording, truth, left, right)
        for settings in SETTINGS:
            start = time.perf_counter()
            found = st.estimate(four, "refined", {"frames": "all", **settings})
            seconds = time.perf_counter() - start
            told = ", ".join(f"{name}: {value}" for name, value in settings.items()) or "default"
            base = f"{four.attrs['baseline_mm']:g}"
            print(f"| {' | '.join([base, told, *row(found, known), f'{seconds:.1f}'])} |", flush=True)


if __name__ == "__main__":
    main()
