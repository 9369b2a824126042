"""Peak memory and time of every command for many frames and for large images: ``python -m benchmarks.peaks``.

Commands run one after the other in processes of their own, as a user starts them, after `scenetruth precompile`. It
takes about twenty minutes, mostly for the method ``refined`` on large images. ``python -m benchmarks.peaks 2464`` runs
only cases whose names contain 2464.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"
CASES = {
    "640 x 480, 5 x 9 images": [],
    "640 x 480, 1 camera, 200 frames": ["stage.positions=1", "frames.count=200"],
    # A cube as large in the images as that of 640 x 480 pixels, with the texture of that in pixels.
    "2464 x 2056, 5 x 9 images": [
        "camera.width=2464",
        "camera.height=2056",
        "objects.0.mesh.size_mm=[200, 200, 200]",
        "objects.0.pose.position_mm=[0, 0, 790]",
        "render.supersampling=2",
    ],
}
STEPS = ("render", "estimate", "score", "report")
REFINED = "2464 x 2056, 5 x 9 images"
"""The case that is also estimated by the method ``refined``."""


def measured(words: list[str]) -> tuple[float, float, float]:
    """Run a command, and return seconds on a clock, seconds of processors, and its peak memory in GB."""
    started = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "scenetruth", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        msg = f"scenetruth {' '.join(words)} failed"
        raise RuntimeError(msg)
    return time.perf_counter() - started, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024 / 1e9


def main() -> None:
    """Print the table."""
    table = Table("case", "command", "s", "processor s", "peak GB")
    for name, overrides in CASES.items():
        if not any(part in name for part in sys.argv[1:] or [""]):
            continue
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "run"
            steps = [*STEPS[:2], "estimate --method refined", *STEPS[2:]] if name == REFINED else STEPS
            for step in steps:
                words = [*step.split(), str(folder)]
                if step == "render":
                    words = [step, str(SCENE), "-o", str(folder), *(w for text in overrides for w in ("--set", text))]
                clock, processor, peak = measured(words)
                table.add_row(name, step, f"{clock:.1f}", f"{processor:.1f}", f"{peak:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
