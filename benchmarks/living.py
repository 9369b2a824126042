"""What the estimator makes of the leaf and the rosette, region by region: the tables of docs/living.md.

Run it from the top of the repository: ``python -m benchmarks.living``.
"""

from __future__ import annotations

from pathlib import Path

import scenetruth as st
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings

SCENES = Path(__file__).parents[1] / "scenes"
# Frames a minute apart as the scenes have them; a quarter of an hour apart; and that in light without shadows.
CASES = (
    ("frames.frame_interval_s=60",),
    ("frames.frame_interval_s=900",),
    ("frames.frame_interval_s=900", "lighting.lights=[]", "lighting.ambient=0.8"),
)
HEADINGS = ("A: Z", "U_Z", "growth", "B: U_Z", "growth", "C: U_Z", "growth")


def scores(name: str, changes: tuple[str, ...]) -> st.Score:
    """Render, estimate and score a changed scene."""
    scene = st.load_scene(SCENES / f"{name}.yaml", list(changes))
    recording, truth = st.simulate(scene)
    chosen = (scene.estimate or StructureTensorSettings()).model_dump()
    return st.score(st.estimate(recording, **chosen), truth, recording)


def number(value: float | int | None) -> str:
    """Spell a number with two digits."""
    return "–" if value is None else f"{float(f'{value:.1e}'):g}"


def row(region: str, results: list[st.Score]) -> str | None:
    """Return median / rms error of the quantities in a region, for every case; None if it is empty."""
    first = results[0].regions.get(region)
    if first is None or not first["depth"]["count"]:
        return None
    cells = [f"`{region}`", f"{first['depth']['count']:,}", number(100 * float(first["depth"]["density"] or 0))]
    for index, result in enumerate(results):
        for quantity in ("depth", "velocity_z", "growth_rate_windowed")[index > 0 :]:
            values = result.regions.get(region, {}).get(quantity, {})
            cells.append(f"{number(values.get('median_abs'))} / {number(values.get('rms'))}")
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print both tables."""
    for name in ("leaf", "rosette"):
        results = [scores(name, changes) for changes in CASES]
        print(f"\n## {name}\n\n| region | pixels | known, % | {' | '.join(HEADINGS)} |\n|{10 * '---|'}")
        rows = (row(region, results) for region in results[0].regions)
        print("\n".join(filter(None, rows)), flush=True)


if __name__ == "__main__":
    main()
