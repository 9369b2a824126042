"""What both methods make of every scene of the library, region by region.

Run it from the top of the repository: ``python -m benchmarks.gallery_methods [SCENE ...]``; twelve scenes of 640 x 480
pixels, 5 cameras, 9 frames, of which one is estimated. A try of a few seconds: ``... cube --set camera.width=160 --set
camera.height=120``. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import numpy as np
from benchmarks.beside import METHODS, SCENES, beyond, estimated, scene_of
from benchmarks.jobs import arguments, ends, heading, line, number, pair

import scenetruth as st

# The regions of the score that are told, where a scene has pixels in them.
REGIONS = ("all", "interior", "boundary_10_20", "boundary_5_10", "boundary_0_5", "occluded")
GROWTH = "growth_rate_windowed"
QUANTITIES = ("depth", "velocity_z", GROWTH)
# Rounding makes what does not grow grow by less than this, per frame.
STILL = 1e-9
COLUMNS = ("scene", "region", "method", "pixels", "known, %", "Z, mm", "U_Z, mm/frame", "growth, %/h")
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
            told = [f"{depth['count']:,}", number(100 * float(depth["density"] or 0))]
            told += [pair(scores[region].get(quantity, {})) for quantity in quantities] + ["–"] * (not grows)
            cells.append([name, f"`{region}`", method, *told, *map(number, far[region])])
    return cells


def main() -> None:
    """Print the table, scene by scene."""
    given = arguments(__doc__).parse_args()
    print(heading((*COLUMNS, *FAR)), flush=True)
    jobs = {file.stem: (file.stem, given.set) for file in sorted(SCENES.glob("*.yaml"))}
    for _, cells in ends(rows, jobs, given):
        print("\n".join(map(line, cells)), flush=True)


if __name__ == "__main__":
    main()
