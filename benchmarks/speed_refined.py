"""Time and memory of the method ``refined`` and of the structure tensor: ``python -m benchmarks.speed_refined``.

Each method runs in a process of its own, after a first call for the compiled kernels, on the same images of the cube of
5 x 9 images. With ``--scale 0.5``, images have half the width and height; ``--crop`` takes their middle instead, which
keeps the texture. Errors are those of the interior.
"""

from __future__ import annotations

import argparse
import json
import pickle
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import scenetruth as st

SCENE = Path(__file__).parents[1] / "scenes" / "cube.yaml"
WIDTH, HEIGHT, FOCAL_PX = 640, 480, 5016
INTERIOR_PX = 20
METHODS: dict[str, dict[str, Any]] = {"structure_tensor": {"tau": "auto"}, "refined": {}}


def simulate(scale: float, crop: float) -> tuple[Any, Any]:
    """Return recording and truth of the cube, of which only a fraction in the middle of both axes is kept."""
    changes = [f"camera.width={round(scale * WIDTH)}", f"camera.height={round(scale * HEIGHT)}"]
    changes += [f"camera.focal_length_px={scale * FOCAL_PX}"]
    recording, truth = st.simulate(st.load_scene(SCENE, overrides=changes if scale != 1.0 else []))
    sizes = {name: recording.sizes[name] for name in ("y", "x")}
    part = {name: slice(round(size * (1 - crop) / 2), round(size * (1 + crop) / 2)) for name, size in sizes.items()}
    truth = truth[["depth", "velocity", "boundary_distance"]].sel(t=0)
    return recording.isel(part).load(), truth.isel(part).load()


def measure(file: str, method: str) -> dict[str, float]:
    """Return seconds, processor seconds, peak memory and errors of a method in this process."""
    warnings.simplefilter("ignore")
    recording, truth = pickle.loads(Path(file).read_bytes())
    small = recording.isel(y=slice(96), x=slice(96))
    st.estimate(small, method, METHODS[method])
    started, processor = time.perf_counter(), time.process_time()
    found = st.estimate(recording, method, METHODS[method])
    figures = {"seconds": time.perf_counter() - started, "processor": time.process_time() - processor}
    figures["peak"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    found = found.sel(t=0)
    inside = (truth["boundary_distance"].values >= INTERIOR_PX) & (found["status"].values == 2)
    for name in ("depth", "velocity"):
        error = (found[name].values - truth[name].values)[..., inside].astype(np.float64)
        figures[name] = float(np.sqrt(np.mean(error[-1] ** 2 if name == "velocity" else error**2)))
    return figures


def main() -> None:
    """Print a line for each method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="of the images")
    parser.add_argument("--crop", type=float, default=1.0, help="fraction of width and height that is kept")
    parser.add_argument("--measure", nargs=2, metavar=("FILE", "METHOD"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        print(json.dumps(measure(*given.measure)))
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recording.pickle"
        recording, truth = simulate(given.scale, given.crop)
        pixels = recording.sizes["y"] * recording.sizes["x"]
        file.write_bytes(pickle.dumps((recording, truth)))
        del recording, truth
        print("method | s | processor s | ratio | peak GB | bytes per px | depth, mm | U_Z, mm per frame")
        first = float("nan")
        for method in METHODS:
            words = [sys.executable, "-m", "benchmarks.speed_refined", "--measure", str(file), method]
            of = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
            first = of["processor"] if method == "structure_tensor" else first
            cells = [f"{of['seconds']:.1f}", f"{of['processor']:.1f}", f"{of['processor'] / first:.1f}"]
            cells += [f"{of['peak']:.2f}", f"{1e9 * of['peak'] / pixels:.0f}", f"{of['depth']:.4g}"]
            print(" | ".join([method, *cells, f"{of['velocity']:.4g}"]), flush=True)


if __name__ == "__main__":
    main()
