"""Print hashes of the variables of recording and truth of all bundled scenes, to compare versions.

Run from the top of the repository: ``python -m benchmarks.hashes``, or with further overrides of fields, such as
``render.supersampling=3``. Scenes have 2 positions, 2 frames and 120 px along their shorter side.
"""

from __future__ import annotations

import hashlib
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import scenetruth as st

SCENES = Path(__file__).parents[1] / "scenes"
SIZE_PX = 120
FEW = ("frames.count=2", "stage.positions=2", "render.backend=raycast")


def small(file: Path, overrides: Sequence[str]) -> st.Scene:
    """Return a scene with few small images."""
    scene = st.load_scene(file, overrides=[*FEW, *overrides])
    camera = scene.camera
    scale = max(min(camera.width, camera.height) / SIZE_PX, 1.0)
    changes = {"camera.width": int(camera.width / scale), "camera.height": int(camera.height / scale)}
    return st.load_scene(scene, overrides=changes | {"camera.focal_length_px": camera.focal_px / scale})


def main() -> None:
    """Print a line for each variable."""
    for file in sorted(SCENES.glob("*.yaml")):
        for dataset in st.simulate(small(file, sys.argv[1:])):
            for name, values in sorted(dataset.data_vars.items()):
                print(f"{hashlib.sha256(values.values.tobytes()).hexdigest()[:16]} {file.stem} {name}", flush=True)


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
