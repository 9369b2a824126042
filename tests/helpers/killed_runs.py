"""Runs that are killed at random moments, and what must hold afterwards."""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

import scenetruth as st

SCENE = """
camera: {width: 40, height: 32, focal_length_px: 60}
stage: {positions: 3, baseline_mm: 5}
frames: {count: 5}
render: {backend: raycast}
seed: SEED
objects:
  - name: wall
    mesh: {kind: plane, size_mm: [90, 90]}
    texture: {kind: noise, wavelength_mm: [6, 20]}
    pose: {position_mm: [0, 0, 100]}
"""

# Everything is imported and compiled once; every run is a child of this process, told by a line of its input.
PARENT = """
import os, sys, warnings
warnings.simplefilter("ignore")
os.environ["NUMBA_NUM_THREADS"] = "1"
os.environ["NUMBA_THREADING_LAYER"] = "workqueue"
from pathlib import Path
import scenetruth as st
from scenetruth.pipeline import run_scene
from scenetruth.scene import load_scene
STAGES = sys.argv[3].split(",")
run_scene(load_scene(sys.argv[1]), output=sys.argv[2], stages=STAGES)
print("ready", flush=True)
for line in sys.stdin:
    file, folder = line.rstrip("\\n").split("\\t")
    child = os.fork()
    if child:
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
        continue
    try:
        run_scene(load_scene(file), output=folder, stages=STAGES, overwrite=True)
        os._exit(0)
    except st.ScenetruthError as error:
        print(error, file=sys.stderr)
        os._exit(2)
    except BaseException:
        import traceback
        traceback.print_exc()
        os._exit(1)
"""


def digests(folder: Path) -> dict[str, str]:
    """Return a hash of every file under a final name, but for those that say how long the run took."""
    tops = [path for path in folder.iterdir() if path.name not in TIMED and not path.name.startswith(".")]
    files = [file for top in tops for file in (top.rglob("*") if top.is_dir() else [top]) if file.is_file()]
    return {file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


TIMED = ("score.json", "report.html")


class Killer:
    """Starts runs and kills them.

    Parameters
    ----------
    folder
        An empty folder to work in.
    seed
        Of the moments.
    stages
        What is run. The report, which takes longer than everything else of so small a scene, is left out if not given.
    """

    def __init__(self, folder: Path, seed: int, stages: Sequence[str] = ("render", "estimate", "score")) -> None:
        self.folder, self.stages = folder, stages
        self.own = f"{seed}"
        self.moments = np.random.default_rng(seed)
        self.scenes = []
        for number in (1, 2):
            file = folder / f"scene-{number}.yaml"
            file.write_text(SCENE.replace("SEED", str(number)))
            self.scenes.append(file)

    def __enter__(self) -> Self:
        self.parent = self._start()
        self.expected = []
        for number, scene in enumerate(self.scenes):
            start = time.monotonic()
            assert self.finish(scene, self.folder / f"expected-{self.own}-{number}") == 0
            self.duration_s = time.monotonic() - start
            self.expected.append(digests(self.folder / f"expected-{self.own}-{number}"))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.parent.kill()
        self.parent.communicate()

    def _start(self) -> subprocess.Popen[str]:
        parent = subprocess.Popen(
            [sys.executable, "-c", PARENT, self.scenes[0], self.folder / f"first-{self.own}", ",".join(self.stages)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert parent.stdout is not None
        assert parent.stdout.readline() == "ready\n"
        return parent

    def begin(self, scene: Path, folder: Path) -> int:
        """Start a run, and return the number of its process."""
        assert self.parent.stdin is not None
        assert self.parent.stdout is not None
        self.parent.stdin.write(f"{scene}\t{folder}\n")
        self.parent.stdin.flush()
        return int(self.parent.stdout.readline())

    def end(self) -> int:
        """Wait for the run, and return its exit code."""
        assert self.parent.stdout is not None
        return int(self.parent.stdout.readline())

    def finish(self, scene: Path, folder: Path) -> int:
        """Run to the end."""
        self.begin(scene, folder)
        return self.end()

    def kill_once(self, number: int, *, earlier: bool) -> str:
        """Kill one run, look at what there is, repeat it, and look again; return how far it had come."""
        place = self.folder / f"place-{number}"
        place.mkdir()
        target = place / "run"
        if earlier:
            assert self.finish(self.scenes[0], target) == 0
            (target / "thesis.txt").write_text("all my work")
        process = self.begin(self.scenes[1], target)
        time.sleep(float(self.moments.uniform(0, 1.1 * self.duration_s)))
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
        killed = self.end() != 0
        found = self.check_whole(target)
        if earlier:
            thesis = [*place.rglob("thesis.txt")]
            assert [file.read_text() for file in thesis] == ["all my work"]
        assert self.finish(self.scenes[1], target) == 0
        left = {path.name for path in place.iterdir()}
        assert left == {"run"}, left
        assert not [path for path in target.iterdir() if path.name.startswith(".")]
        if earlier:
            assert (target / "thesis.txt").read_text() == "all my work"
            (target / "thesis.txt").unlink()
        assert digests(target) == self.expected[1]
        return found if killed else "finished"

    def two_at_once(self, other: Killer, number: int, *, kill: bool) -> None:
        """Start two runs to one folder, perhaps kill the first, and look at what is left."""
        place = self.folder / f"pair-{number}"
        place.mkdir()
        target = place / "run"
        first = self.begin(self.scenes[0], target)
        time.sleep(float(self.moments.uniform(0, 0.3 * self.duration_s)))
        other.begin(other.scenes[1], target)
        time.sleep(float(self.moments.uniform(0, self.duration_s)))
        if kill:
            with contextlib.suppress(ProcessLookupError):
                os.kill(first, signal.SIGKILL)
        codes = self.end(), other.end()
        # Who comes second is refused, unless the first has ended by then.
        assert codes[0] in (0, 2, -signal.SIGKILL), codes
        assert codes[1] in (0, 2), codes
        assert kill or 0 in codes, codes
        self.check_whole(target)
        assert self.finish(self.scenes[0], target) == 0
        assert [path.name for path in place.iterdir()] == ["run"]
        assert digests(target) == self.expected[0]

    def check_whole(self, target: Path) -> str:
        """Everything under a final name is whole, and of one run."""
        if not target.exists():
            return "nothing"
        assert [verdict for verdict in st.verify(target) if verdict.problem] == []
        here = digests(target)
        here.pop("thesis.txt", None)
        for expected in self.expected:
            if here.get("scene.yaml") == expected["scene.yaml"]:
                assert here.items() <= expected.items()
                return f"{len(here)} of {len(expected)} files"
        raise AssertionError(sorted(here))
