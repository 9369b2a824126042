"""Time what people wait for, in one checkout or in several by turns: `python tools/time_checkouts.py ../before .`.

    git worktree add ../before COMMIT
    python tools/time_checkouts.py ../before . [--rounds 3] [--only simulate]

Run it with the Python of an environment in which all checkouts run, on a machine that does nothing else. Compiled code
and textures are kept from a first round that is not counted. Times are medians; ratios are to the first checkout.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

SIMULATE = """
import sys, time, warnings
import scenetruth as st
warnings.simplefilter("ignore")
scene = st.load_scene(sys.argv[1])
one = st.load_scene(sys.argv[1], overrides=["frames.count=1"])
st.simulate(one)
start = time.perf_counter()
recording, truth = st.simulate(scene)
print(time.perf_counter() - start)
"""
TRUTH = """
import sys, time, warnings
import scenetruth as st
warnings.simplefilter("ignore")
scene = st.load_scene(sys.argv[1])
st.make_truth(scene)
start = time.perf_counter()
st.make_truth(scene)
print((time.perf_counter() - start) / scene.frames.count)
"""
ESTIMATE = """
import sys, time, warnings
import scenetruth as st
warnings.simplefilter("ignore")
recording, _ = st.simulate(st.load_scene(sys.argv[1], overrides=["render.backend=raycast", "render.supersampling=1"]))
times = []
for _ in range(6):
    start = time.perf_counter()
    st.estimate(recording, method="structure_tensor")
    times.append(time.perf_counter() - start)
print(sorted(times[1:])[2])
"""
INSIDE = {"simulate": SIMULATE, "truth per frame": TRUTH, "estimate per pixel": ESTIMATE}
CASES = {
    "simulate cube": ("simulate", "cube"),
    "simulate leaf": ("simulate", "leaf"),
    "simulate rosette": ("simulate", "rosette"),
    "truth per frame": ("truth per frame", "cube"),
    "estimate per pixel": ("estimate per pixel", "cube"),
    "command render": ("render", "cube"),
    "command run": ("run", "cube"),
}


def seconds(checkout: Path, case: str) -> float:
    """Return how long one thing takes in a process of its own."""
    import time

    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    what, scene = CASES[case]
    file = str(checkout / "scenes" / f"{scene}.yaml")
    if what in INSIDE:
        command = [sys.executable, "-c", INSIDE[what], file]
        done = subprocess.run(command, env=environment, cwd=checkout, check=True, capture_output=True, text=True)
        return float(done.stdout)
    folder = Path(tempfile.mkdtemp())
    try:
        command = [sys.executable, "-m", "scenetruth", what, file, "-o", str(folder / "run")]
        start = time.perf_counter()
        subprocess.run(command, env=environment, cwd=checkout, check=True, capture_output=True)
        return time.perf_counter() - start
    finally:
        shutil.rmtree(folder)


def main() -> None:
    """Print a table."""
    from rich.console import Console
    from rich.table import Table

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkouts", type=Path, nargs="+")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="", help="cases whose names begin so")
    arguments = parser.parse_args()
    checkouts = [checkout.resolve() for checkout in arguments.checkouts]
    console = Console()
    table = Table("s", *map(str, arguments.checkouts), *(["ratio"] if len(checkouts) > 1 else []))
    for case in (name for name in CASES if name.startswith(arguments.only)):
        times: list[list[float]] = [[] for _ in checkouts]
        for number in range(arguments.rounds + 1):
            for checkout, found in zip(checkouts, times, strict=True):
                value = seconds(checkout, case)
                if number > 0:
                    found.append(value)
        medians = [statistics.median(found) for found in times]
        ratio = [f"{medians[0] / medians[-1]:.2f}"] if len(checkouts) > 1 else []
        table.add_row(case, *(f"{value:.3f}" for value in medians), *ratio)
        console.print(f"{case}: {' '.join(f'{value:.3f}' for value in medians)} {' '.join(ratio)}")
    console.print(table)


if __name__ == "__main__":
    main()
