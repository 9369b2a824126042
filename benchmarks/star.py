"""How fine a motion both methods resolve, and how noisy they are: the star of the DIC community.

Run it from the top of the repository: ``python -m benchmarks.star``; 960 x 320 pixels, 5 cameras, 9 frames, twice. With
``--small``, a cut of 160 x 120 with periods from 100 to 30 px instead of 300 to 20.

Along the middle row the sheet of scenes/star.yaml moves by 0.1 px per frame along y, at every period. The share that an
estimate leaves is found x true over true², summed over the two rows at the middle and over `SMOOTH_PX` columns. The
table tells the longest period with less than 90 % ("first"), the shortest with 90 % or more ("last"), the root of the
mean square of the flow along y of the same sheet at rest, 20 px and more from edges and from the image's, and the
product of noise and first period. A Gaussian window cut at 2 σ leaves exp(-0.77 σ² k² / 2) of a wave of wave number
k: 90 % at a period of 12 σ.
Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.beside import scene_of
from benchmarks.jobs import arguments, ends, heading, line

AT_REST = ("objects.0.deformation.0.amplitude_mm={kind: linear, rate_per_frame: 0}",)
SMALL = (
    "camera.width=160",
    "camera.height=120",
    "objects.0.mesh.size_mm=[40, 70]",
    "objects.0.deformation.0.period_mm=[20, 6]",
)
SIGMAS_PX = (6.0, 4.0)
METHODS: dict[str, dict[str, object]] = {
    "structure_tensor": {"working_point_px": 25},
    "refined": {},
    "refined, translation": {"motion": "translation"},
}
LEAST_SHARE = 0.9
SMOOTH_PX = 21
INTERIOR_PX = 20
Array = NDArray[np.float64]


def settings_of(name: str, sigma_px: float) -> tuple[str, dict[str, object]]:
    """Return a method and its settings."""
    settings = {**METHODS[name], "window_sigma_px": sigma_px}
    method = name.partition(",")[0]
    if method == "structure_tensor":
        # Cut at two standard deviations, as by default.
        settings["window_taps_px"] = 2 * round(2 * sigma_px) + 1
    return method, settings


def periods_px(scene: st.Scene) -> Array:
    """Return the period at every column, in px."""
    plain = scene.to_dict()
    (sheet,), camera = plain["objects"], plain["camera"]
    pixel_mm = sheet["pose"]["position_mm"][2] / camera["focal_length_px"]
    first, last = sheet["deformation"][0]["period_mm"]
    half = sheet["mesh"]["size_mm"][0] / 2
    x_mm = (np.arange(camera["width"]) - (camera["width"] - 1) / 2) * pixel_mm
    period_mm: Array = first + (last - first) * (x_mm + half) / (2 * half)
    return period_mm / float(pixel_mm)


def amplitude_ratio(found: xr.Dataset, truth: xr.Dataset) -> Array:
    """Return the share of the true flow that is found at every column; NaN where nothing is told."""
    middle = found.sizes["y"] // 2
    rows = slice(middle - 1, middle + 1)
    got, true = (each["flow"].isel(image_component=1, y=rows).values for each in (found, truth))
    known = np.isfinite(got) & (found["status"].isel(y=rows).values == 2)
    box = np.ones(SMOOTH_PX)
    over, under = (np.convolve(np.where(known, each, 0.0).sum(axis=0), box, "same") for each in (got * true, true**2))
    return np.where(under > 0, over / np.where(under > 0, under, 1.0), np.nan)


def crossings(periods: Array, share: Array) -> tuple[float, float]:
    """Return the longest period of which too little is left, and the shortest of which enough is."""
    inner = slice(INTERIOR_PX, -INTERIOR_PX)
    periods, share = periods[inner], share[inner]
    less, enough = periods[share < LEAST_SHARE], periods[share >= LEAST_SHARE]
    return (float(less.max()) if less.size else 0.0), (float(enough.min()) if enough.size else float("inf"))


def rows(changes: Sequence[str]) -> list[list[str]]:
    """Return the rows of all methods and windows."""
    moving, still = scene_of("star", changes), scene_of("star", [*changes, *AT_REST])
    (recording, truth), (at_rest, rest) = st.simulate(moving), st.simulate(still)
    truth, rest, periods, cells = truth.sel(t=0), rest.sel(t=0), periods_px(moving), []
    for name in METHODS:
        for sigma_px in SIGMAS_PX:
            method, settings = settings_of(name, sigma_px)
            found = st.estimate(recording, method, settings).sel(t=0)
            first, last = crossings(periods, amplitude_ratio(found, truth))
            quiet = st.estimate(at_rest, method, settings).sel(t=0)
            inner = {"y": slice(INTERIOR_PX, -INTERIOR_PX), "x": slice(INTERIOR_PX, -INTERIOR_PX)}
            away = rest["boundary_distance"].isel(inner).values >= INTERIOR_PX
            known = away & (quiet["status"].isel(inner).values == 2)
            off = quiet["flow"].isel({"image_component": 1, **inner}).values[known]
            noise = float(np.sqrt(np.mean(np.square(off))))
            told = (name, f"{sigma_px:g}", f"{first:.0f}", f"{last:.0f}", f"{noise:.2g}", f"{noise * first:.2g}")
            cells.append([*told, f"{known.sum() / away.sum():.2f}"])
    return cells


def main() -> None:
    """Print the table."""
    parser = arguments(__doc__)
    parser.add_argument("--small", action="store_true", help="a cut of 160 x 120 px")
    given = parser.parse_args()
    given.set = [*(SMALL if given.small else ()), *given.set]
    columns = ("method", "σ, px", "period at 10 % loss, px: first", "last", "noise, px", "product, px²", "known")
    print(heading(columns), flush=True)
    for _, cells in ends(rows, {"star": (given.set,)}, given):
        print("\n".join(map(line, cells)), flush=True)


if __name__ == "__main__":
    main()
