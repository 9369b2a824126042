"""What the refined method makes of four images of the shipped cube: two positions, two frames.

Run it from the top of the repository: ``python -m benchmarks.same_images``; 640 x 480 pixels. Image correlation of the
same four images of the outermost positions (20 mm apart; left camera and frame 0 are the reference), pyvale's with
subsets of 31 px every 5 px, leaves 0.031 mm of depth and 0.043 mm per frame of U_Z (root of the mean square, pixels 20
px and more from edges). A window of standard deviation σ averages noise as an even one of 3.5 σ does: 31 px are 8.7.

A try of a minute: ``... 20 --small``, the middle of the cube in 256 x 75 pixels (the outermost positions see it 150 px
apart) in six textures; pixels whose window is in all images. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.beside import scene_of
from benchmarks.jobs import arguments, ends, heading, line

# Pixels this far from edges are in the interior.
INTERIOR_PX = 20
# Left and right position, frames.
PAIRS = ((-2, 2), (-1, 1), (0, 1))
FRAMES = (0, 1)
# Settings that share one rendering.
SHARED = 6
SMALL = ("camera.width=256", "camera.height=75")
SEEDS = range(6)
# Frames that are rendered: those before the first are not used.
COUNT = 3
GRID = [
    {"window_sigma_px": sigma, "motion": motion, "surface": surface}
    for sigma, motion, surface in product((6, 7, 8, 9, 10), ("growing", "rigid", "translation"), ("auto", "plane"))
]


def pair_of(recording: xr.Dataset, truth: xr.Dataset, left: int, right: int) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the images of two positions as a recording whose reference is the left one, and the truth of that one."""
    four = recording.sel(s=[left, right], t=list(FRAMES))
    places = four["stage_x_mm"].values - four["stage_x_mm"].values[0]
    four = four.assign_coords(s=[0, 1], stage_x_mm=("s", places))
    four.attrs["baseline_mm"] = float(places[1])
    return four, truth.sel(s=left, t=[FRAMES[0]])


def errors_of(found: xr.Dataset, truth: xr.Dataset, clear_px: float) -> tuple[float, NDArray[np.float64]]:
    """Return the known share of the interior, and there errors and stated deviations of Z and of U_Z, shape (4, n).

    Parameters
    ----------
    found, truth
        Estimate and truth of the left camera.
    clear_px
        How far within all images pixels must be.
    """
    inside = (truth["boundary_distance"].values >= INTERIOR_PX) & np.isfinite(truth["depth"].values)
    if clear_px > 0:
        height, width = inside.shape[1:]
        x, y = np.arange(width), np.arange(height)[:, None]
        right = x - truth["disparity"].values * found.attrs["baseline_mm"] / truth.attrs["baseline_mm"]
        inside &= (right > clear_px) & (x < width - clear_px) & (np.abs(y - height / 2) < height / 2 - clear_px)
    kept = inside & (found["status"].values == 2)
    depth = found["depth"].values - truth["depth"].values
    speed = (found["velocity"].values - truth["velocity"].values)[2]
    values = (depth, speed, found["depth_std"].values, found["velocity_std"].values[2])
    return float(kept.sum() / inside.sum()), np.array([each[kept] for each in values], dtype=np.float64)


def rows(
    left: int, right: int, grid: Sequence[dict[str, object]], changes: Sequence[str], small: bool
) -> list[list[str]]:
    """Return the rows of two positions."""
    made: list[list[tuple[float, NDArray[np.float64]]]] = [[] for _ in grid]
    for more in [f"seed={seed}" for seed in SEEDS] if small else [None]:
        changed = [f"frames.count={COUNT}", *(SMALL if small else ()), *changes, *([more] if more else ())]
        recording, truth = st.simulate(scene_of("cube", changed), truth_views="all")
        four, known = pair_of(recording, truth, left, right)
        for settings, ends_of in zip(grid, made, strict=True):
            # Of two frames, the first is estimated.
            found = st.estimate(four, "refined", settings)
            ends_of.append(errors_of(found, known, INTERIOR_PX if small else 0.0))
    cells = []
    for settings, ends_of in zip(grid, made, strict=True):
        depth, speed, depth_std, speed_std = np.concatenate([errors for _, errors in ends_of], axis=1)
        told = [f"{float(np.sqrt(np.mean(each**2))):.4f}" for each in (depth, speed)]
        scaled = [f"{float(np.sqrt(np.mean(each**2))):.2f}" for each in (depth / depth_std, speed / speed_std)]
        share = f"{np.mean([share for share, _ in ends_of]):.3f}"
        cells.append([f"{5 * (right - left)}", *settings.values(), share, *told, f"{speed.mean():+.4f}", *scaled])
    return cells


def main() -> None:
    """Print the table, base by base."""
    parser = arguments(__doc__)
    parser.add_argument("--small", action="store_true", help="the middle of the cube alone")
    given = parser.parse_args()
    columns = ("base, mm", "σ, px", "motion", "surface", "known", "Z, mm", "U_Z, mm/frame", "bias of U_Z")
    print(heading((*columns, "error / std of Z", "of U_Z")), flush=True)
    jobs = {
        f"{5 * (right - left)} mm, {part}{', small' * given.small}": (
            left,
            right,
            GRID[part : part + SHARED],
            given.set,
            given.small,
        )
        for left, right in PAIRS
        for part in range(0, len(GRID), SHARED)
    }
    for _, cells in ends(rows, jobs, given):
        print("\n".join(map(line, cells)), flush=True)


if __name__ == "__main__":
    main()
