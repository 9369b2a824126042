"""Accuracy of both methods on bundled scenes: the table of docs/results/accuracy.md.

Run it from the top of the repository: ``python -m benchmarks.accuracy --kept FILE``; 640 x 480 pixels, 5 cameras, 9
frames, of which one is estimated. Errors in the interior, median / RMSE, and the seconds of the second estimate, which
compiles nothing. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import scenetruth as st
from benchmarks.beside import estimated, scene_of
from benchmarks.jobs import arguments, ends, heading, line, number, pair

SCENES = {
    "cube": "`cube`: noise texture, 1 % noise, 0.66 m away",
    "leaf": "`leaf`: a leaf above soil, 0.6 m away, growing by 3 %/h",
    "rosette": "`rosette`: a plant with nine leaves",
    "rubber_sheet": "`rubber_sheet`: strain of 1e-4 per frame",
}
GROWING = ("leaf", "rosette")
QUANTITIES = ("depth", "velocity_z", "growth_rate_windowed")
COLUMNS = (
    "scene",
    "method",
    "density, %",
    "depth, mm: median / RMSE",
    "U_Z, mm per frame: median / RMSE",
    "growth, %/h: median / RMSE",
    "s",
)


def rows(name: str, changes: Sequence[str]) -> list[list[str]]:
    """Return the rows of a scene, one for each method."""
    scene = scene_of(name, changes)
    recording, truth = st.simulate(scene)
    cells: list[list[str]] = []
    # The rubber sheet has settings of its own, and the scale of its growth is that of strain.
    methods = ("refined",) if name == "rubber_sheet" else ("structure_tensor", "refined")
    for method in methods:
        for _ in range(2):
            start = time.perf_counter()
            if name == "rubber_sheet":
                found = st.estimate(recording, **scene.estimate.model_dump())
            else:
                found = estimated(recording, method, scene)
            seconds = time.perf_counter() - start
        interior = st.score(found, truth, recording).regions["interior"]
        errors = [pair(interior.get(quantity, {})) for quantity in QUANTITIES]
        if name not in GROWING:
            errors[-1] = ""
        title = "refined, with the scene's settings" if name == "rubber_sheet" else method.replace("_", " ")
        density = number(100 * float(interior["depth"]["density"] or 0))
        cells.append([SCENES[name] if not cells else "", title, density, *errors, f"{seconds:.0f}"])
    return cells


def main() -> None:
    """Print the table, scene by scene."""
    given = arguments(__doc__).parse_args()
    print(heading(COLUMNS), flush=True)
    for _, cells in ends(rows, {name: (name, given.set) for name in SCENES}, given):
        print("\n".join(map(line, cells)), flush=True)


if __name__ == "__main__":
    main()
