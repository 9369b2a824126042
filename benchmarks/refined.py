"""Compare the refined method with the structure tensor: tables of docs/results/least_squares.md.

Run it from the top of the repository: ``python -m benchmarks.refined --kept FILE``; 640 x 480 pixels, 5 cameras, 9
frames, of which one is estimated. Jobs are the rows of the first table (``cube, ideal``), and ``settings: SCENE``, the
rows of the last one. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.beside import METHODS, estimated, scene_of
from benchmarks.jobs import arguments, ends, heading, line, number

IDEAL = ("sensor.noise_std=0", "sensor.bit_depth=16")
LATE = "frames.frame_interval_s=900"
_RATE = "objects.0.deformation.0.rate_per_hour"
# Scene, changes, and the object that is evaluated; all objects if empty.
CASES: Mapping[str, tuple[str, tuple[str, ...], str]] = {
    "cube": ("cube", (), "cube"),
    "cube without noise": ("cube", IDEAL, "cube"),
    "cube, brightness + 1 % per frame": ("cube", ("lighting.drift_per_frame=0.01",), "cube"),
    "cube in a moving spotlight": ("cube_spotlight", (), "cube"),
    "relief": ("relief", (), "relief"),
    "leaf, 15 min per frame": ("leaf", (LATE,), "leaf"),
    "leaf, 15 min per frame, no growth": ("leaf", (LATE, f"{_RATE}=0"), "leaf"),
    "leaf, 1 min per frame": ("leaf", (), "leaf"),
    "rosette, 1 min per frame": ("rosette", (), ""),
    "rosette, 15 min per frame": ("rosette", (LATE,), ""),
}
BESIDE = ("rosette, 1 min per frame", "leaf, 15 min per frame", "cube")
"""Cases of the table of silhouettes."""
FINER = [{"window_sigma_px": 5}, {"window_sigma_px": 4}]
SETTINGS: Mapping[str, tuple[str, tuple[str, ...], Sequence[Mapping[str, Any]]]] = {
    "settings: cube": (
        "cube",
        (),
        (
            *({"window_sigma_px": sigma} for sigma in (7, 8)),
            {"motion": "rigid", "surface": "plane"},
            {"motion": "translation"},
            {"spline": "cubic"},
        ),
    ),
    "settings: leaf, 15 min, 6 % per hour": ("leaf", (LATE, f"{_RATE}=0.06"), ({"acceleration": True}, *FINER)),
    "settings: rosette, 1 min": ("rosette", (), (*FINER, {"surface": "curved"}, {"acceleration": True})),
    "settings: cube in a spotlight": ("cube_spotlight", (), (*FINER, {"acceleration": True})),
}
INTERIOR_PX = 20  # least distance of the interior from edges
BESIDE_PX = ((2, 5), (5, 10))
GOOD_MM = 0.2
FAR = 6.0
Array = NDArray[np.float64]
Cells = dict[str, list[Any]]


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def both(values: Array) -> str:
    """Return median of the absolute values / root of their mean square."""
    return f"{number(float(np.median(np.abs(values))))} / {number(rms(values))}" if values.size else "–"


def rendered(name: str, changes: Sequence[str], wanted: str) -> tuple[xr.Dataset, xr.Dataset, NDArray[np.bool_]]:
    """Return recording, truth of the estimated frame, and the interior of the objects whose names begin so."""
    recording, truth = st.simulate(scene_of(name, changes))
    numbers = [n for n, each in enumerate(json.loads(truth.attrs["object_names"])) if each.startswith(wanted)]
    now = truth.sel(t=0)
    interior = (now["boundary_distance"].values >= INTERIOR_PX) & np.isin(now["object_id"].values, numbers)
    return recording, now, interior


def row(found: xr.Dataset, truth: xr.Dataset, inside: NDArray[np.bool_]) -> list[str]:
    """Return the cells of the first table of an estimate in a region."""
    kept = inside & (found["status"].values == 2)

    def error(name: str) -> Array:
        return np.asarray((found[name].values - truth[name].values)[..., kept], dtype=np.float64)

    depth, velocity = error("depth"), error("velocity")
    scaled = [depth / found["depth_std"].values[kept], *(velocity / found["velocity_std"].values[:, kept])]
    cells = [f"{kept.sum() / inside.sum():.2f}", both(depth), both(velocity[2])]
    per_hour = 360_000 / float(truth.attrs["frame_interval_s"])
    growth = error("growth_rate") * per_hour if "growth_rate" in found and "growth_rate" in truth else np.zeros(0)
    cells += [both(growth[np.isfinite(growth)])]
    if "growth_rate_std" in found and growth.size:
        std = found["growth_rate_std"].values[kept] * per_hour
        scaled.append((growth / std)[np.isfinite(growth)])
    return [*cells, ", ".join(f"{rms(each):.2f}" for each in scaled)]


def beside(found: xr.Dataset, truth: xr.Dataset, first: float, last: float) -> list[str]:
    """Return the cells of the second table for pixels at such distances from outlines, of all objects."""
    away = truth["boundary_distance"].values
    region = (away >= first) & (away < last) & np.isfinite(truth["depth"].values)
    known = region & (found["status"].values == 2)
    if not known.any():
        return []
    error = np.abs(found["depth"].values - truth["depth"].values)[known].astype(np.float64)
    scaled = error / found["depth_std"].values[known]
    cells = [f"{known.sum() / region.sum():.2f}", both(error), f"{100 * np.mean(error < GOOD_MM):.0f}"]
    return [*cells, f"{100 * np.mean(scaled < 2):.0f}", number(100 * float(np.mean(scaled > FAR)))]


def rows(name: str, changes: Sequence[str], wanted: str) -> dict[str, Cells]:
    """Return the cells of both tables, by method."""
    recording, truth, inside = rendered(name, changes, wanted)
    made: dict[str, Cells] = {}
    for method in METHODS:
        found = estimated(recording, method, scene_of(name, changes)).sel(t=0)
        made[method] = {"interior": row(found, truth, inside)}
        made[method] |= {f"{first} to {last}": beside(found, truth, first, last) for first, last in BESIDE_PX}
    return made


def changed(name: str, changes: Sequence[str], grid: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return errors with each of some settings, the defaults first."""
    recording, truth, inside = rendered(name, changes, "")
    cells = []
    for settings in ({}, *grid):
        found = st.estimate(recording, "refined", dict(settings)).sel(t=0)
        kept = found["status"].values == 2
        error = np.asarray(found["velocity"].values - truth["velocity"].values, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            beyond = np.abs(error) > FAR * found["velocity_std"].values
        far = np.asarray(beyond.any(axis=0))[kept]
        inner = error[:, inside & kept]
        near = beside(found, truth, *BESIDE_PX[1])
        words = ", ".join(f"{key}: {value}" for key, value in settings.items()) or "default"
        values = [
            number(rms(inner[0])),
            number(rms(inner[1])),
            f"{number(float(inner[2].mean()))} / {number(rms(inner[2]))}",
        ]
        cells.append([words, *values, number(100 * float(far.mean())), near[2] if near else "–"])
    return cells


def main() -> None:
    """Print the tables."""
    given = arguments(__doc__).parse_args()
    columns = (
        "density",
        "Z, mm",
        "U_Z, mm per frame",
        "growth per point, % per hour",
        "RMS z-scores (Z, U_X, U_Y, U_Z, growth)",
    )
    print(heading(("scene", "method", *columns)), flush=True)
    made = {}
    for name, cells in ends(
        rows, {name: (scene, [*more, *given.set], wanted) for name, (scene, more, wanted) in CASES.items()}, given
    ):
        made[name] = cells
        for method in METHODS:
            title = name if method == METHODS[0] else ""
            print(line((title, method.replace("_", " "), *cells[method]["interior"])), flush=True)
    columns = ("density", "Z, mm", f"under {GOOD_MM:g} mm, %", "within 2, %", "beyond 6, %")
    print(f"\n{heading(('scene', 'px from silhouettes', 'method', *columns))}")
    for name in BESIDE:
        for first, last in BESIDE_PX:
            for method in METHODS:
                if name in made and made[name][method][f"{first} to {last}"]:
                    cells_of = made[name][method][f"{first} to {last}"]
                    print(line((name, f"{first} to {last}", method.replace("_", " "), *cells_of)), flush=True)
    columns = ("U_X", "U_Y", "bias / rms of U_Z", "U beyond 6 std, %", f"depth under {GOOD_MM:g} mm, 5 to 10 px, %")
    print(f"\n{heading(('scene', 'settings', *columns))}", flush=True)
    jobs = {name: (scene, [*more, *given.set], grid) for name, (scene, more, grid) in SETTINGS.items()}
    for name, cells in ends(changed, jobs, given):
        print("\n".join(line((name.removeprefix("settings: "), *each)) for each in cells), flush=True)


if __name__ == "__main__":
    main()
