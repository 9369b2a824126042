"""Processor time and memory of one estimated frame of the cube, 640 x 480 px: each method in a process with one thread.

An estimate is made twice; the second one is measured, which compiles nothing.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import scenetruth as st
from benchmarks.beside import scene_of
from benchmarks.peers.catalogue import words_of
from benchmarks.results.contestants import CONTESTANTS, PROGRAM, Contestant, submitted
from benchmarks.results.jobs import ONE_THREAD, run_batch
from scenetruth.estimators import prepare
from scenetruth.estimators.external import write_recording

__all__ = ["cost_of"]

SCENE = ("render.backend=raycast", "frames.count=5")
# A process inherits the peak memory of the one that starts it: a shell between is small.
_ALONE = ("/bin/sh", "-c", '"$@"; exit $?', "sh")


def cost_of(one: Contestant, folder: Path, peers: Path) -> dict[str, float]:
    """Return ``processor_s`` per frame and ``memory_mb``, the peak of the process, of a method; empty if it failed.

    Parameters
    ----------
    one
        The method.
    folder
        Folder of the results; the recording of the cube is kept there.
    peers
        Folder of the environments.
    """
    place = (folder / "cube").absolute()
    if not (place / "files").exists():
        recording, _ = st.simulate(scene_of("cube", SCENE))
        place.mkdir(parents=True, exist_ok=True)
        st.save_store(recording, place / "recording.zarr", overwrite=True)
        write_recording(recording, place / "files", "npy")
    with tempfile.TemporaryDirectory(prefix="results-") as work:
        if one.group == PROGRAM:
            outputs = [Path(work, name) for name in ("first", "second")]
            run_batch(
                [*_ALONE, *words_of(peers, one.key)],
                [[str(place / "files"), str(output)] for output in outputs],
                Path(work),
            )
            file = outputs[-1] / "further" / "cost.json"
            failed = (outputs[-1] / "further" / "error.txt").exists()
        else:
            file, failed = Path(work, "cost.json"), False
            words = [sys.executable, "-m", "benchmarks.results.cost", str(place / "recording.zarr"), str(file)]
            subprocess.run([*_ALONE, *words, one.key, one.spelled], env={**os.environ, **ONE_THREAD}, check=False)
        if failed or not file.exists():
            return {}
        found: dict[str, float] = json.loads(file.read_text(encoding="utf-8"))
        return found


def main() -> None:
    """Estimate twice, and write what the second took."""
    store, output, key, spelled = sys.argv[1:]
    recording = st.load_store(store, kind="recording")
    (spec,) = (one.spec for one in ([submitted(spelled)] if spelled else CONTESTANTS) if one.key == key)
    seconds = 0.0
    for _ in range(2):
        started = _processor_s()
        found = prepare(recording.load().copy(deep=True), spec.method, dict(spec.settings)).estimate()
        seconds = (_processor_s() - started) / found.sizes["t"]
    users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    memory = max(resource.getrusage(who).ru_maxrss for who in users) / 1024
    Path(output).write_text(json.dumps({"processor_s": seconds, "memory_mb": memory}), encoding="utf-8")


def _processor_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    main()
