"""How near what is foreseen comes to what is measured: peak memory, disk and time of ``scenetruth render``.
 Run it from the top of the repository, on a machine that does nothing else: ``python -m benchmarks.foresight``; names
of cases choose some of them. The figures are those from which the table in `scenetruth.resources.cost_estimate` was
fitted, by least squares of relative errors with coefficients that are not negative.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import scenetruth as st
from scenetruth.resources.cost_estimate import StageForecast, estimate_cost
from scenetruth.resources.workload import compute_workload, list_object_workloads
from scenetruth.scene.built_scene import build_scene

SCENES = Path(__file__).parents[1] / "scenes"
RAYS = "render.backend=raycast"


def _size(width: int, height: int, focal_px: int) -> tuple[str, ...]:
    return f"camera.width={width}", f"camera.height={height}", f"camera.focal_length_px={focal_px}"


_DEFOCUS = "optics.defocus={aperture_mm: 3, focus_distance_mm: 660, samples: 16}"
CASES: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "cube": ("cube", (), ()),
    "cube, rays": ("cube", (RAYS,), ()),
    "cube 4x": ("cube", (*_size(1280, 960, 10032), "frames.count=3"), ()),
    "cube 4x, rays": ("cube", (*_size(1280, 960, 10032), "frames.count=3", RAYS), ()),
    "cube 10x": ("cube", (*_size(2048, 1536, 16051), "frames.count=2"), ()),
    "cube 10x, rays": ("cube", (*_size(2048, 1536, 16051), "frames.count=2", RAYS), ()),
    "cube 1 sample": ("cube", ("render.supersampling=1", "frames.count=5"), ()),
    "cube 64 samples": ("cube", ("render.supersampling=8", "frames.count=5"), ()),
    "cube 64 samples, rays": ("cube", ("render.supersampling=8", "frames.count=5", RAYS), ()),
    "cube 40 frames, rays": ("cube", (*_size(320, 240, 2508), "frames.count=40", RAYS), ()),
    "cube, spot light": ("cube_spotlight", ("frames.count=3",), ()),
    "cube, defocus": ("cube", (*_size(320, 240, 2508), "frames.count=2", _DEFOCUS), ()),
    "cube, defocus, rays": ("cube", (*_size(320, 240, 2508), "frames.count=2", _DEFOCUS, RAYS), ()),
    "cube, blur": (
        "cube",
        (*_size(320, 240, 2508), "frames.count=3", "optics.psf={kind: gaussian, sigma_px: 0.7}"),
        (),
    ),
    "cube, rolling shutter": ("cube", (*_size(160, 120, 1254), "frames.count=1", "shutter.readout_time_s=0.1"), ()),
    "cube, ideal too, rays": ("cube", ("frames.count=3", RAYS), ("--save-radiance",)),
    "plane": ("plane", ("frames.count=3",), ()),
    "star": ("star", ("frames.count=3",), ()),
    "relief": ("relief", ("frames.count=3",), ()),
    "relief, 3.6e6 faces, rays": ("relief", ("frames.count=2", "objects.0.mesh.resolution_mm=0.1", RAYS), ()),
    "leaf": ("leaf", ("frames.count=5",), ()),
    "leaf, rays": ("leaf", ("frames.count=5", RAYS), ()),
    "leaf, fine": ("leaf", ("frames.count=3", "objects.0.mesh.resolution_mm=0.25"), ()),
    "rosette": ("rosette", ("frames.count=5",), ()),
    "rosette, rays": ("rosette", ("frames.count=5", RAYS), ()),
    "rosette 4x": ("rosette", (*_size(1280, 960, 5800), "frames.count=2"), ()),
    "rosette, 20 leaves": ("rosette", ("frames.count=3", "plants.0.leaves=20"), ()),
    "rosette, unlit": ("rosette", ("frames.count=3", "lighting={}"), ()),
    "rosette, all": ("rosette", ("frames.count=3",), ("--truth-views", "all", "--truth-content", "complete")),
}
"""Scene, changes and options of each."""
UNPAINTED = {
    "cube, to be painted": ("cube", ("frames.count=1", "stage.positions=2"), ()),
    "leaf, to be painted": ("leaf", ("frames.count=1", "stage.positions=2"), ()),
    "rosette, to be painted": ("rosette", ("frames.count=1", "stage.positions=2"), ()),
}
"""Cases without textures of an earlier run."""


@dataclass(frozen=True)
class Measured:
    """What one process took."""

    memory_bytes: float
    disk_bytes: float
    seconds: float


def measured(name: str, changes: Sequence[str], options: Sequence[str], folder: Path) -> Measured:
    """Render in a process of its own."""
    words = [word for change in changes for word in ("--set", change)]
    command = [sys.executable, "-m", "scenetruth", "render", str(SCENES / f"{name}.yaml"), "-o", str(folder)]
    start = time.perf_counter()
    process = os.posix_spawn(sys.executable, [*command, *words, *options], os.environ)
    _, status, used = os.wait4(process, 0)
    seconds = time.perf_counter() - start
    assert os.waitstatus_to_exitcode(status) == 0
    disk = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return Measured(used.ru_maxrss * (1 if sys.platform == "darwin" else 1024), disk, seconds)


def foreseen(name: str, changes: Sequence[str], options: Sequence[str]) -> StageForecast:
    """Foresee the same."""
    scene = st.load_scene(SCENES / f"{name}.yaml", overrides=list(changes))
    views = scene.stage.positions * scene.stage.rows if "all" in options else 1
    parts, problems = list_object_workloads(scene)
    assert not problems
    ideal = "--save-radiance" in options
    demand = compute_workload(scene, parts, views=views, complete="complete" in options, save_radiance=ideal)
    return estimate_cost(demand, ["render"]).stages["render"]


def main() -> None:
    """Print the table."""
    headings = ("case", "memory, MB", "/ foreseen", "disk, MB", "/ foreseen", "time, s", "/ foreseen")
    print(f"| {' | '.join(headings)} |\n|{'---|' * len(headings)}")
    wanted = sys.argv[1:]
    with tempfile.TemporaryDirectory() as temporary:
        for cases, painted in ((CASES, True), (UNPAINTED, False)):
            os.environ["SCENETRUTH_CACHE"] = f"{temporary}/cache" if painted else "off"
            for number, (case, (name, changes, options)) in enumerate(cases.items()):
                if wanted and case not in wanted:
                    continue
                if painted:
                    build_scene(st.load_scene(SCENES / f"{name}.yaml", overrides=list(changes)))
                expected = foreseen(name, changes, options)
                found = measured(name, changes, options, Path(temporary, f"{painted} {number}"))
                cells = [
                    f"{one / unit:.3g} | {one / other:.2f}"
                    for one, other, unit in (
                        (found.memory_bytes, expected.memory_bytes, 1e6),
                        (found.disk_bytes, expected.disk_bytes, 1e6),
                        (found.seconds, expected.seconds, 1.0),
                    )
                ]
                print(f"| {case} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
