"""What both methods make of every scene of the library: the table of all scenes in docs/results/least_squares.md.

Run it from the top of the repository: ``python -m benchmarks.gallery_methods [SCENE ...]``; twelve scenes of 640 x 480
pixels, 5 cameras, 9 frames, of which one is estimated. A try of a few seconds: ``... cube --set camera.width=160 --set
camera.height=120``. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import math

import numpy as np

import scenetruth as st
from benchmarks.beside import METHODS, SCENES, beyond, estimated, scene_of
from benchmarks.jobs import arguments, ends, heading, line, number, pair

# Regions of the score, where a scene has pixels in them.
REGIONS = ("all", "interior", "boundary_10_20", "boundary_5_10", "boundary_0_5", "occluded")
GROWTH = "growth_rate_windowed"
QUANTITIES = ("depth", "velocity_z", GROWTH)
# Rounding makes what does not grow grow by less than this, per frame.
STILL = 1e-9
COLUMNS = ("scene", "region", "method", "pixels", "density, %", "Z, mm", "U_Z, mm/frame", "growth, %/h")
SUMMARY = ("scene", "method", "valid, %", "Z, mm", "U_Z, mm per frame", "growth, % per hour", "beyond 6 std: Z, U, %")
FAR = ("Z beyond 6 std, %", "U beyond 6 std, %")


def rows(name: str, changes: list[str]) -> list[list[str]]:
    """Return the rows of a scene: each method in each region."""
    scene = scene_of(name, changes)
    recording, truth = st.simulate(scene)
    grows = "growth_rate" in truth and float(np.nanmax(np.abs(truth["growth_rate"].values))) > STILL
    quantities = QUANTITIES if grows else QUANTITIES[:2]
    made = {}
    for method in METHODS:
        found = estimated(recording, method, scene)
        made[method] = st.score(found, truth, recording).regions, beyond(found, truth)
    cells = []
    for region in REGIONS:
        for method, (scores, far) in made.items():
            depth = scores.get(region, {}).get("depth", {})
            if not depth.get("count"):
                continue
            values = [f"{depth['count']:,}", number(100 * float(depth["density"] or 0))]
            values += [pair(scores[region].get(quantity, {})) for quantity in quantities] + ["–"] * (not grows)
            cells.append([name, f"`{region}`", method, *values, *map(number, far.get(region, (math.nan, math.nan)))])
    return cells


def main() -> None:
    """Print the table, scene by scene."""
    given = arguments(__doc__).parse_args()
    print(heading((*COLUMNS, *FAR)), flush=True)
    jobs = {file.stem: (file.stem, given.set) for file in sorted(SCENES.glob("*.yaml"))}
    summary = []
    for name, cells in ends(rows, jobs, given):
        print("\n".join(map(line, cells)), flush=True)
        for method in METHODS:
            whole, interior = (
                next((cell for cell in cells if cell[1:3] == [f"`{region}`", method]), None)
                for region in ("all", "interior")
            )
            if whole is not None and interior is not None:
                title = name if method == METHODS[0] else ""
                summary.append([title, method.replace("_", " "), whole[4], *interior[5:8], ", ".join(whole[8:])])
    print(f"\n{heading(SUMMARY)}")
    print("\n".join(map(line, summary)), flush=True)


if __name__ == "__main__":
    main()
