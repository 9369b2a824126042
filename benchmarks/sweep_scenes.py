"""Bad pixels of the plane sweep and of its motion search on bundled scenes: tables of docs/results/plane_sweep.md.

Run it from the top of the repository: ``python -m benchmarks.sweep_scenes [disparity | motion] --kept FILE``; 640 x 480
pixels, 5 cameras, 3 frames. Bad is a disparity with an error above 0.25 px per step or a flow with an error above 0.5
px per frame, and a pixel without estimate. Distances are those to depth discontinuities. The matchers of OpenCV are
given the true range of disparities. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.beside import estimated, scene_of
from benchmarks.jobs import arguments, ends, heading, line
from benchmarks.stand_ins import SEMI_GLOBAL, Matcher, bad, matched
from scenetruth.estimators.plane_sweep import sweep_disparity, sweep_motion

Map = NDArray[np.float64]

FEW = ("frames.count=3",)
LATE = "frames.frame_interval_s=900"
FAST = "objects.0.motion.0.velocity_mm_per_frame=[1.3, -0.8, -1]"
MOTIONS = {
    "cube, moving by (1.3, -0.8, -1) mm per frame": ("cube", [FAST]),
    "cube": ("cube", []),
    "leaf, 15 min per frame": ("leaf", [LATE]),
    "rosette, 15 min per frame": ("rosette", [LATE]),
}
RANGES_PX = {"whole": (0.0, np.inf), "2 to 5 px": (2.0, 5.0), "5 to 10 px": (5.0, 10.0)}
BLOCK, PENALTY = 7, 32  # side length of the blocks in px, and the factor of the penalty that OpenCV's examples take
BAD_FLOW_PX = 0.5


def regions(truth: xr.Dataset, ranges: Mapping[str, tuple[float, float]]) -> list[NDArray[np.bool_]]:
    """Return where there is a surface at such distances from discontinuities."""
    away, known = truth["boundary_distance"].values, np.isfinite(truth["disparity"].values)
    return [known & (away >= first) & (away < last) for first, last in ranges.values()]


def stack(recording: xr.Dataset) -> NDArray[np.float32]:
    """Return grey values of shape (channel, s, t, y, x)."""
    return recording["image"].transpose("s", "t", "y", "x").values.astype(np.float32)[None]


def disparities(recording: xr.Dataset, scene: st.Scene, true: Map) -> Iterator[tuple[str, Map]]:
    """Yield method and disparity of the middle frame; NaN: none."""
    first, positions = recording.sel(t=[0]), recording["s"].values
    for name, cameras in {"`plane_sweep`": positions, "`all`, two cameras": np.array([0, 1])}.items():
        found = sweep_disparity(stack(first.sel(s=cameras))[:, :, 0], cameras, float(recording.attrs["baseline_mm"]))
        if name == "`plane_sweep`":
            yield name, np.where(found.known, found.disparity, np.nan)
            name = "`plane_sweep`, `all`"
        yield name, found.disparity
    range_px = (float(np.nanmin(true)), float(np.nanmax(true)))
    grey = np.clip(np.rint(first["image"] * (255 / first.attrs["full_scale"])), 0, 255).astype(np.uint8)
    for name, camera in {"nearest pair": 1, "outermost": int(positions.max())}.items():
        settings = Matcher(SEMI_GLOBAL, camera, BLOCK, "3-way", PENALTY)
        yield f"OpenCV's SGBM, {name}", matched(first.assign(image=grey), settings, range_px)
    tensor = estimated(recording, "structure_tensor", scene).sel(t=0)
    yield "structure tensor, 3 frames", np.where(tensor["status"].values == 2, tensor["disparity"].values, np.nan)


def disparity_rows(name: str, changes: Sequence[str]) -> list[list[str]]:
    """Return shares of bad pixels in %, by method."""
    scene = scene_of(name, [*FEW, *changes])
    recording, every = st.simulate(scene)
    truth = every.sel(t=0)
    true, places = truth["disparity"].values, regions(truth, {**RANGES_PX, "20 px and more": (20.0, np.inf)})
    rows = []
    for method, found in disparities(recording, scene, true):
        wrong = bad(found, true)
        wrong_valid = wrong & np.isfinite(found)
        rows.append([name, method, *(share(wrong, place) for place in places), share(wrong_valid, places[0])])
    return rows


def motion_row(name: str, changes: Sequence[str]) -> list[str]:
    """Return the range of the flow, shares of bad pixels in %, median errors far from discontinuities, and seconds."""
    recording, every = st.simulate(scene_of(name, [*FEW, *changes]))
    truth, images, positions = every.sel(t=0), stack(recording), recording["s"].values
    start, frames = time.process_time(), recording["t"].values
    middle, reference = int(np.flatnonzero(frames == 0)[0]), int(np.flatnonzero(positions == 0)[0])
    baseline, focal = float(recording.attrs["baseline_mm"]), float(recording.attrs["focal_length_px"])
    centre = (float(recording.attrs["principal_point_px"][0]), float(recording.attrs["principal_point_px"][1]))
    disparity = sweep_disparity(images[:, :, middle], positions, baseline).disparity
    beside = [n for n in range(len(frames)) if n != middle]
    found = sweep_motion(
        images[:, reference, middle],
        [images[:, :, n] for n in beside],
        frames[beside],
        positions,
        disparity,
        focal,
        centre,
    )
    seconds = time.process_time() - start
    y, x = np.indices(disparity.shape)
    flow = np.stack(
        [
            disparity * (found.velocity[0] - (x - centre[0]) * found.velocity[2] / focal),
            disparity * (found.velocity[1] - (y - centre[1]) * found.velocity[2] / focal),
        ]
    )
    true = truth["flow"].transpose("image_component", "y", "x").values
    error, places = np.hypot(*(flow - true)), regions(truth, {**RANGES_PX, "10 px and more": (10.0, np.inf)})
    towards = np.abs(baseline * found.velocity[2] - truth["velocity"].sel(component="Z").values)
    length = np.hypot(*true)[places[0]]
    return [
        name,
        f"{length.min():.2g} to {length.max():.2g}",
        *(share(~(error <= BAD_FLOW_PX), place) for place in places[:3]),
        f"{np.median(error[places[3]]):.2g}",
        f"{np.median(towards[places[3]]):.2g}",
        f"{seconds:.1f}",
    ]


def share(what: NDArray[np.bool_], where: NDArray[np.bool_]) -> str:
    """Return a fraction in %."""
    return f"{100 * float(what[where].mean()):.2f}"


def main() -> None:
    """Print both tables."""
    given = arguments(__doc__).parse_args()
    jobs: dict[str, Sequence[Any]] = {f"disparity {name}": (name, given.set) for name in ("rosette", "leaf", "cube")}
    print(heading(("scene", "method", *RANGES_PX, "20 px and more", "valid and wrong")))
    for _, rows in ends(disparity_rows, jobs, given):
        print("\n".join(map(line, rows)), flush=True)
    columns = ("scene", "flow, px per frame", *RANGES_PX, "median, 10 px and more, px", "of U_Z, mm", "s")
    print(f"\n{heading(columns)}")
    jobs = {f"motion {label}": (name, [*changes, *given.set]) for label, (name, changes) in MOTIONS.items()}
    for label, row in ends(motion_row, jobs, given):
        print(line([label.removeprefix("motion "), *row[1:]]), flush=True)


if __name__ == "__main__":
    main()
