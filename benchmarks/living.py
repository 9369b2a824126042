"""What both methods make of the leaf and the rosette, region by region: the tables of docs/results/plant_scenes.md.

Run it from the top of the repository: ``python -m benchmarks.living [leaf | rosette]``; 640 x 480 pixels, 5 cameras, 9
frames, of which one is estimated, in three cases each. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import scenetruth as st
from benchmarks.beside import METHODS, estimated, scene_of
from benchmarks.jobs import arguments, ends, heading, line, number, pair

Regions = Mapping[str, Mapping[str, Mapping[str, float | int | None]]]
# Frames a minute apart as the scenes have them; a quarter of an hour apart; and that in light without shadows.
CASES = {
    "A": ("frames.frame_interval_s=60",),
    "B": ("frames.frame_interval_s=900",),
    "C": ("frames.frame_interval_s=900", "lighting.lights=[]", "lighting.ambient=0.8"),
}
NAMES = ("leaf", "rosette")
HEADINGS = ("region", "method", "pixels", "density, %", "A: Z", "U_Z", "growth", "B: U_Z", "growth", "C: U_Z", "growth")
QUANTITIES = ("depth", "velocity_z", "growth_rate_windowed")


def scores(name: str, changes: Sequence[str]) -> dict[str, Regions]:
    """Render a changed scene; estimate and score it by each method."""
    scene = scene_of(name, changes)
    recording, truth = st.simulate(scene)
    return {method: st.score(estimated(recording, method, scene), truth, recording).regions for method in METHODS}


def row(region: str, method: str, cases: Sequence[dict[str, Regions]]) -> str | None:
    """Return median / rms error of the quantities in a region, for every case; None if it is empty."""
    depth = cases[0][method].get(region, {}).get("depth", {})
    if not depth.get("count"):
        return None
    cells = [f"`{region}`", method, f"{depth['count']:,}", number(100 * float(depth["density"] or 0))]
    for index, case in enumerate(cases):
        cells += [pair(case[method].get(region, {}).get(quantity, {})) for quantity in QUANTITIES[index > 0 :]]
    return line(cells)


def main() -> None:
    """Print both tables."""
    given = arguments(__doc__).parse_args()
    jobs = {f"{name} {case}": (name, [*changes, *given.set]) for name in NAMES for case, changes in CASES.items()}
    made: dict[str, list[dict[str, Regions]]] = {}
    for job, regions in ends(scores, jobs, given):
        name = job.split()[0]
        made.setdefault(name, []).append(regions)
        if len(made[name]) == len(CASES):
            cases = made[name]
            print(f"\n## {name}\n\n{heading(HEADINGS)}")
            told = [row(region, method, cases) for region in cases[0][METHODS[0]] for method in METHODS]
            print("\n".join(filter(None, told)), flush=True)


if __name__ == "__main__":
    main()
