"""Makes the environments of the peers: ``python -m benchmarks.peers.setup [NAME...]``, 50 to 85 MB to fetch each.

Each peer has an environment of its own in FOLDER/env, of the versions in ``requirements``. What is there stays, unless
the requirements have changed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
import venv
from pathlib import Path

from benchmarks.peers.catalogue import HERE, PEERS, python_of

__all__ = ["make_environment"]

FOLDER = Path("outputs/peers")
INSTALLED = "installed.txt"


def make_environment(folder: Path, name: str) -> str:
    """Make an environment; return what was done.

    Parameters
    ----------
    folder
        Environments go into ``env`` below it.
    name
        Name of the environment, and of its requirements.

    Raises
    ------
    subprocess.CalledProcessError
        If something cannot be installed.
    """
    wanted = HERE / "requirements" / f"{name}.txt"
    python = python_of(folder, name)
    stamp = python.parents[1] / INSTALLED
    if stamp.exists() and stamp.read_text(encoding="utf-8") == wanted.read_text(encoding="utf-8"):
        return "is there"
    started = time.perf_counter()
    if not python.exists():
        venv.create(python.parents[1], with_pip=True)
    quiet = ["--quiet", "--disable-pip-version-check"]
    subprocess.run([python, "-m", "pip", "install", *quiet, "--requirement", wanted], check=True)
    stamp.write_text(wanted.read_text(encoding="utf-8"), encoding="utf-8")
    return f"made in {time.perf_counter() - started:.0f} s"


def main() -> None:
    """Make what is asked for, one after the other."""
    known = sorted({peer.environment for peer in PEERS.values()})
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"environments: {', '.join(known)}; all if none")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where env is made (outputs/peers)")
    given = parser.parse_args()
    if strange := sorted(set(given.names) - set(known)):
        parser.error(f"no such environment: {', '.join(strange)}; known: {', '.join(known)}")
    failed = False
    for name in given.names or known:
        try:
            print(f"{name}: {make_environment(given.folder, name)}", flush=True)
        except subprocess.CalledProcessError as error:
            failed = True
            print(f"{name}: could not be made ({error}); the others go on", file=sys.stderr, flush=True)
    if failed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
