"""Trials in a process of their own, with bounds of time and memory: what hangs or grows is ended, and told."""

from __future__ import annotations

import contextlib
import json
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.helpers.scene_trial import OUTCOMES

__all__ = ["MOST_BYTES", "MOST_SECONDS", "Guarded", "serve"]

MOST_SECONDS, MOST_BYTES = 5, 1_000_000_000
"""Processor time and memory of a trial, the latter beyond what the process takes when all is imported."""
PATIENCE_S = 60
"""Time on a clock, after which a process that does not answer is ended."""


class Guarded:
    """A process that tries scene files or stores, started again when it is lost.

    Parameters
    ----------
    folder
        Where files, and those that fail, are put.
    what
        ``"scene files"``, which are text; or ``"stores"``, which are told as damage in JSON.
    outcomes
        What may become of them.
    """

    def __init__(self, folder: Path, what: str = "scene files", outcomes: tuple[str, ...] = OUTCOMES) -> None:
        self.folder, self.file = folder, folder / ("scene.yaml" if what == "scene files" else "damage.json")
        self.what, self.expected = what, outcomes
        self.outcomes: Counter[str] = Counter()
        self.failures: list[str] = []
        self.slowest_s, self.peak_bytes = 0.0, 0
        self._process: subprocess.Popen[str] | None = None

    def try_file(self, content: bytes) -> str:
        """Return what becomes of a file: as of `try_scene`, or what went wrong."""
        self.file.write_bytes(content)
        outcome = self._ask()
        if outcome in self.expected:
            self.outcomes[outcome] += 1
        else:
            self.failures.append(outcome)
            (self.folder / f"failed-{len(self.failures)}{self.file.suffix}").write_bytes(content)
        return outcome

    def _ask(self) -> str:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.helpers.guarded_trials", self.what],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        signal.signal(signal.SIGALRM, lambda number, frame: process.kill())
        signal.alarm(PATIENCE_S)
        try:
            process.stdin.write(f"{self.file}\n")
            process.stdin.flush()
            answer: dict[str, Any] = json.loads(process.stdout.readline())
        except (OSError, ValueError):
            process.kill()
            self._process = None
            return f"the process is lost, with exit code {process.wait()}"
        finally:
            signal.alarm(0)
        self.slowest_s = max(self.slowest_s, answer["seconds"])
        self.peak_bytes = max(self.peak_bytes, answer["bytes"])
        return str(answer["outcome"])

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def __str__(self) -> str:
        count = sum(self.outcomes.values()) + len(self.failures)
        told = ", ".join(f"{self.outcomes[outcome]:,} {outcome}" for outcome in self.expected)
        return (
            f"{count:,} {self.what}: {told}, {len(self.failures):,} failed; "
            f"slowest {self.slowest_s:.2f} s of processor time, "
            f"peak memory {self.peak_bytes / 1e6:.0f} MB in all, imported code included"
        )


class _TooLongError(BaseException):
    pass


def _too_long(number: int, frame: object) -> None:
    raise _TooLongError


def serve(what: str) -> None:
    """Try the files whose paths come on standard input, and answer on standard output, a line each."""
    import traceback

    trial = _scene_trial() if what == "scene files" else _store_trial()
    at_start = _memory("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (at_start + MOST_BYTES, resource.RLIM_INFINITY))
    signal.signal(signal.SIGPROF, _too_long)
    for line in sys.stdin:
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
        started = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
        try:
            outcome = trial(Path(line.rstrip("\n")))
        except _TooLongError:
            outcome = f"takes more than {MOST_SECONDS} s of processor time: {''.join(traceback.format_exc()[-600:])}"
        except BaseException:
            outcome = traceback.format_exc()[-3000:]
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        answer = {
            "outcome": outcome,
            "seconds": time.process_time() - started,
            "bytes": _memory("VmHWM"),
        }
        print(json.dumps(answer), flush=True)


def _scene_trial() -> Callable[[Path], str]:
    """Make all scenes once, so that nothing has to be imported or compiled in a trial."""
    import tempfile

    import yaml

    from tests.helpers.fuzzed_scenes import base_trees
    from tests.helpers.scene_trial import try_scene

    with tempfile.TemporaryDirectory() as made:
        for tree in base_trees():
            file = Path(made) / "warm.yaml"
            file.write_text(yaml.safe_dump(tree))
            try_scene(file)
    return try_scene


def _store_trial() -> Callable[[Path], str]:
    """Use all whole stores once, for the same reason."""
    import shutil
    import tempfile

    import scenetruth as st
    from tests.helpers.fuzzed_stores import KINDS, damaged, whole_stores
    from tests.helpers.store_trial import try_store

    folder = Path(tempfile.mkdtemp(prefix="stores-"))
    whole_stores(folder)
    others = {kind: st.load_store(folder / f"{kind}.zarr") for kind in KINDS}

    def trial(file: Path) -> str:
        damage = json.loads(file.read_text())
        target = folder / ("broken.zarr.zip" if damage["zipped"] else "broken.zarr")
        try:
            damaged(folder, damage, target)
            return try_store(target, others)
        finally:
            shutil.rmtree(target) if target.is_dir() else target.unlink(missing_ok=True)

    for kind in KINDS:
        for suffix in (".zarr", ".zarr.zip"):
            assert try_store(folder / f"{kind}{suffix}", others) == "used"
    return trial


def _memory(entry: str) -> int:
    """Return a line of the system's figures of this process, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{entry}:"):
            return 1024 * int(line.split()[1])
    return 0


if __name__ == "__main__":
    serve(sys.argv[1])
