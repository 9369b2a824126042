"""One page of peers and methods of scenetruth over the metrology suite: ``python -m benchmarks.peers.page -o FOLDER``.

Peers see the reference camera and the outermost one on the right, frames 0 and 1; of the methods of scenetruth,
``structure_tensor`` and ``refined`` see all images, those named ``..._of_four`` the same four as peers. Between their
points, peers' maps are interpolated. Peers of two images give flow, and disparity of two cameras. ``mudic`` takes part
only if it is named.

Six cases of the suite are run unless others are named, or ``--all``: every scene takes about a minute of a core, as
each program starts anew for each recording. The environments are those of `benchmarks.peers.setup`. Run it again, and
it goes on where it was.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.peers import few_images
from benchmarks.peers.catalogue import PEERS, command_of, python_of
from benchmarks.peers.setup import FOLDER

import scenetruth as st
from scenetruth.estimators import MethodSpec, Needs
from scenetruth.estimators.external import CommandMethod

METHODS: tuple[Any, ...] = (
    "structure_tensor",
    "refined",
    few_images.structure_tensor_of_four,
    few_images.refined_of_four,
    few_images.refined_of_four_wide,
    MethodSpec("opencv_scene_flow", label="farneback"),
    MethodSpec("opencv_scene_flow", {"stereo": "bm", "flow": "dis"}, label="dis"),
)
TIMEOUT_S = 300.0
CASES = ("noise", "slope", "brightness", "edge_of_depth", "waves_of_depth", "waves_of_motion")
# Its rectangle covers a seventh of these images: all that is told of common pixels would be told of that seventh.
LEFT_OUT = ("mudic",)


def peer_method(folder: Path, name: str) -> CommandMethod:
    """Return a peer as a method."""
    peer = PEERS[name]
    return CommandMethod(
        command_of(folder, name),
        name,
        timeout_s=TIMEOUT_S,
        gives=peer.gives,
        needs=Needs(cameras=peer.cameras, frames=2, channels=1),
    )


def main() -> None:
    """Compare, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", "-o", type=Path, required=True, help="folder of the page")
    parser.add_argument("--peer", action="append", choices=tuple(PEERS), help="only this one; may be repeated")
    parser.add_argument("--case", action="append", metavar="NAME", help="this case; may be repeated")
    parser.add_argument("--all", action="store_true", help="all cases of the suite")
    parser.add_argument("--suite", choices=("core", "full"), default="core")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the environments are (outputs/peers)")
    given = parser.parse_args()
    peers = given.peer or [name for name in PEERS if name not in LEFT_OUT]
    missing = sorted({PEERS[name].environment for name in peers} - _environments(given.folder))
    if missing:
        parser.error(f"no environment of {', '.join(missing)}: python -m benchmarks.peers.setup {' '.join(missing)}")
    # Peers run beside each other: each has its share of the cores, and threads that wait do not keep them busy.
    share = max(1, (os.cpu_count() or 1) // max(1, given.workers))
    os.environ.setdefault("OMP_NUM_THREADS", str(share))
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    started = time.perf_counter()
    found = st.compare(
        [*METHODS, *(peer_method(given.folder, name) for name in peers)],
        suite=given.suite,
        output=given.output,
        cases=None if given.all else given.case or CASES,
        workers=given.workers,
        progress=_Progress(),
    )
    with_all = found.ranking().to_string(float_format=lambda number: f"{number:.2g}")
    print(f"{with_all}\n{time.perf_counter() - started:.0f} s; {given.output / 'index.html'}")
    for failure in found.failures:
        print(f"no estimate: {failure}", file=sys.stderr)


def _environments(folder: Path) -> set[str]:
    return {peer.environment for peer in PEERS.values() if python_of(folder, peer.environment).exists()}


class _Progress:
    """Tells of every scene that is done."""

    def __init__(self) -> None:
        self._told = -1

    def __call__(self, what: str, done: int, total: int) -> None:
        if done != self._told:
            self._told = done
            print(f"{what}: {done} of {total}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
