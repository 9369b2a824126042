"""How far the standard deviations of fallback values can be trusted, on stand-ins for real captures.

Run it from the top of the repository: ``python -m benchmarks.fallback [NAME ...] [--held-out] [--cache DIR]``. Wrong is
a disparity with an error of more than 0.25 px per step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import scenetruth as st
from benchmarks.jobs import arguments, ends, heading, line, number
from benchmarks.stand_in_scenes import SCENES, scene_of
from benchmarks.stand_in_sets import list_sets
from benchmarks.stand_ins import BAD_PX
from benchmarks.trust import simulated
from scenetruth.schema import STATUS_FALLBACK, STATUS_VALID

COLUMNS = ("scene", "status", "pixels, %", "wrong, %", "rms z", "median |z| / 0.67", "beyond 3, %", "beyond 6, %")


def assess(scene: dict[str, Any], cache: str | None) -> dict[str, list[float]]:
    """Return the columns of the table by status: share and wrong share, and errors in standard deviations."""
    recording, truth = simulated(scene, cache)
    estimate = st.estimate(recording, "refined").isel(t=0)
    exact = truth["disparity"].sel(t=estimate["t"]).values
    error = np.abs(estimate["disparity"].values - exact)
    z = error / estimate["disparity_std"].values
    rows: dict[str, list[float]] = {}
    for name, status in (("valid", STATUS_VALID), ("fallback", STATUS_FALLBACK)):
        where = np.isfinite(exact) & (estimate["status"].values == status)
        if where.any():
            off = z[where]
            shares = [where.sum() / np.isfinite(exact).sum(), (error[where] > BAD_PX).mean()]
            rest = [np.sqrt(np.mean(np.minimum(off, 1e3) ** 2)), np.median(off) / 0.6745]
            beyond = [100 * float(np.mean(off > limit)) for limit in (3, 6)]
            rows[name] = [*(100 * float(share) for share in shares), *map(float, rest), *beyond]
    return rows


def main() -> None:
    """Print a table with a line for each scene and status."""
    parser = arguments(__doc__)
    parser.add_argument("--held-out", action="store_true", help="the sets that are held out instead of the others")
    parser.add_argument("--cache", help="folder of simulated scenes")
    given = parser.parse_args()
    scenes = list_sets(held_out=given.held_out) | ({} if given.held_out else {name: scene_of(name) for name in SCENES})
    print(heading(COLUMNS), flush=True)
    for name, rows in ends(assess, {name: (scene, given.cache) for name, scene in scenes.items()}, given):
        for status, values in rows.items():
            print(line([name, status, *map(number, values)]), flush=True)


if __name__ == "__main__":
    main()
