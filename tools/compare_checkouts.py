"""Compare two checkouts, at tolerance 0, in what a user can see.

    git worktree add ../before COMMIT
    python tools/compare_checkouts.py ../before . --keep /tmp/net [--parts recordings estimates] [--without prose]

Workers (comparison_worker.py) run inside each checkout with the Python of this script and make one part after the
other. A part that fails is reported, and the others are compared. Results stay in KEEP/before and KEEP/after and are
reused while the sources of their checkout stay the same. renames.yaml maps renamed names, and lists volatile ones and
changes that were decided on; comparison_adapter.py lists names of functions and classes. KEEP/report.txt holds the
complete report.

Three aspects can be left out: ``prose`` (help texts, descriptions, messages, pages, plots), ``hashes`` (of scenes,
recordings, estimates; they depend on names of fields), ``bytes`` (of files whose content is compared too).

Kernels are compiled without fast mathematics, whose roundings depend on names of modules, on the order of functions
and on what the cache held; ``--fast`` compiles them as the sources say.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from comparison_differences import ASPECTS, Comparison
from comparison_renames import TABLE, Renames

TOOLS = Path(__file__).resolve().parent
PARTS = (
    "names",
    "help",
    "lists",
    "schemas",
    "recordings",
    "truths",
    "estimates",
    "scores",
    "predictions",
    "budget",
    "sweep",
    "design",
    "pattern",
    "benchmark",
    "dataset",
    "exports",
    "run",
    "external",
    "validation",
    "runs",
)
_FORMAT = 1
"""Raise it when parts record something else, so that kept results are made again."""


class Checkout:
    """One of the two checkouts, with the folder of its results.

    Parameters
    ----------
    path
        The checkout.
    folder
        Where its results are kept.
    options
        Options of the worker.
    fast
        Whether kernels are compiled with fast mathematics, as the sources say.
    """

    def __init__(self, path: Path, folder: Path, options: list[str], *, fast: bool = False) -> None:
        self.path, self.folder, self.options, self.fast = path.resolve(), folder, options, fast
        self.folder.mkdir(parents=True, exist_ok=True)
        self._sources = {
            file.relative_to(self.path).as_posix(): file.read_bytes()
            for top in ("src/scenetruth", "scenes", "docs/_ext", "pyproject.toml")
            for file in sorted(_files(self.path / top))
            if file.is_file() and "__pycache__" not in file.parts
        }
        self.fingerprint = _hash(*self._sources, *self._sources.values(), str(_FORMAT), str(fast), *options)

    def make(self, part: str) -> Path | None:
        """Return the file of a part, made if it is missing or out of date; None if that fails."""
        target = self.folder / f"{part}.json"
        if self.read(target).get("fingerprint") == self.fingerprint:
            print(f"  {self.folder.name}: {part} is reused", flush=True)
            return target
        target.unlink(missing_ok=True)
        log = self.folder / f"{part}.log"
        worker = TOOLS / "comparison_worker.py"
        command = [sys.executable, str(worker), str(self.path), part, str(target), self.fingerprint]
        with log.open("w", encoding="utf-8") as stream:
            done = subprocess.run(
                [*command, "--renames", str(TABLE), *self.options],
                env=self._environment(),
                cwd=self.folder,
                stdout=stream,
                stderr=subprocess.STDOUT,
                check=False,
            )
        found = self.read(target)
        if done.returncode or not found:
            lines = log.read_text(encoding="utf-8", errors="replace").splitlines()[-3:]
            print(f"  {self.folder.name}: {part} FAILED, see {log}", *lines, sep="\n      ", flush=True)
            return None
        if found["failures"]:
            # The adapter may be at fault: after a change of it the part is made again.
            found["fingerprint"] = "incomplete"
            target.write_text(json.dumps(found), encoding="utf-8")
        print(f"  {self.folder.name}: {part} made in {found['seconds']} s", flush=True)
        return target

    @staticmethod
    def read(target: Path) -> dict[str, Any]:
        """Return the result of a part; empty if there is none."""
        try:
            return dict(json.loads(target.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return {}

    def _environment(self) -> dict[str, str]:
        """Return the environment of a worker: sources of the checkout, and caches that no change can outdate."""
        compiled = self._place("compiled", _hash(self._hash_of_kernels(), str(self.fast)))
        cache = self._place("cache", _hash(*self._sources.values()))
        settings = (TOOLS / "comparison_site.py").read_bytes()
        site = self._place("site", _hash(settings))
        (site / "sitecustomize.py").write_bytes(settings)
        return {
            **{name: value for name, value in os.environ.items() if name not in ("FORCE_COLOR", "SCENETRUTH_CORE")},
            "PYTHONPATH": os.pathsep.join([str(self.path / "src"), str(site)]),
            "PYTHONHASHSEED": "0",
            "COMPARISON_EXACT": "" if self.fast else "1",
            "NUMBA_CACHE_DIR": str(compiled),
            "SCENETRUTH_CACHE": str(cache),
            "XDG_CACHE_HOME": str(cache),
            "MPLBACKEND": "Agg",
            "COLUMNS": "100",
            "TERM": "dumb",
            "NO_COLOR": "1",
            "TZ": "UTC",
            "LC_ALL": "C.UTF-8",
        }

    def _place(self, name: str, key: str) -> Path:
        """Return a folder that belongs to a state of the sources; those of other states are removed."""
        above = self.folder.parent / name / self.folder.name
        for other in above.glob("*"):
            if other.name != key:
                shutil.rmtree(other, ignore_errors=True)
        (above / key).mkdir(parents=True, exist_ok=True)
        return above / key

    def _hash_of_kernels(self) -> str:
        """Return a hash of compiled modules and the modules that they import.

        Numba notices a change in the file of a kernel, but not in kernels or constants that it takes from other files.
        """
        modules = {
            ".".join(Path(name).with_suffix("").parts[1:]).removesuffix(".__init__"): text.decode()
            for name, text in self._sources.items()
            if name.startswith("src/") and name.endswith(".py")
        }
        chosen = {name for name, text in modules.items() if "numba" in text}
        for _ in range(2):
            imports = {one for name in chosen for one in re.findall(r"^from (scenetruth[\w.]*)", modules[name], re.M)}
            chosen |= imports & set(modules)
        return _hash(*sorted(chosen), *(modules[name] for name in sorted(chosen)))


def _files(place: Path) -> list[Path]:
    return [place] if place.is_file() else list(place.rglob("*"))


def _hash(*parts: str | bytes) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(part.encode() if isinstance(part, str) else part)
        found.update(b"\0")
    return found.hexdigest()[:16]


def _shortened(lines: list[str], most: int) -> Iterator[str]:
    yield from lines[:most]
    if len(lines) > most:
        yield f"... and {len(lines) - most} more lines in report.txt"


def main() -> int:
    """Make both sides, compare, print; return 1 if anything differs or failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="checkout before the change")
    parser.add_argument("after", type=Path, help="checkout after the change")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--scenes", nargs="+", metavar="NAME", help="bundled scenes; all if not given")
    parser.add_argument("--without", nargs="+", choices=ASPECTS, default=[], help="aspects that are left out")
    parser.add_argument("--set", dest="overrides", action="append", default=[], help="override of every bundled scene")
    parser.add_argument("--width", type=int, default=80, help="width of small images, px")
    parser.add_argument("--fast", action="store_true", help="compile with fast mathematics, as the sources say")
    parser.add_argument("--tolerance", type=float, default=0.0, help="of estimates, relative to values above 1")
    parser.add_argument("--keep", type=Path, default=Path("outputs/compare"), help="where results are kept")
    parser.add_argument("--lines", type=int, default=12, help="most lines printed for each part")
    parser.add_argument("--renames", action="store_true", help="list entries of renames.yaml that were not used")
    arguments = parser.parse_args()
    options = ["--width", str(arguments.width)]
    options += [word for one in arguments.overrides for word in ("--set", one)]
    options += ["--scenes", *arguments.scenes] if arguments.scenes else []
    # Results with other options do not replace those of all scenes.
    special = [*(["fast"] if arguments.fast else []), *([f"of_{_hash(*options)}"] if len(options) > 2 else [])]
    keep = arguments.keep.resolve().joinpath(*special)
    before, after = (
        Checkout(path, keep / name, options, fast=arguments.fast)
        for name, path in (("before", arguments.before), ("after", arguments.after))
    )
    renames, left_out, decided, report, differing = Renames.read(), Counter[str](), Counter[str](), [], []
    for part in arguments.parts:
        print(part, flush=True)
        one, other = before.make(part), after.make(part)
        if one is None or other is None:
            differing.append(part)
            report.append(f"{part}: not compared")
            continue
        found = Comparison(one, other, renames, frozenset(arguments.without), arguments.tolerance)
        left_out.update(found.left_out)
        decided.update(found.decided)
        differing += [part] if found.lines else []
        total = f"{part}: {found.summary()}"
        report += [total, *(f"    {line}" for line in found.lines)]
        print(f"  {found.summary()}", *_shortened(found.lines, arguments.lines), sep="\n      ", flush=True)
    if arguments.renames:
        report += [f"not used: {entry}" for entry in renames.unused()]
    (keep / "report.txt").write_text("\n".join(report) + "\n", encoding="utf-8")
    if left_out:
        print("left out by name:", ", ".join(f"{name} ({count})" for name, count in sorted(left_out.items())))
    for reason, count in sorted(decided.items()):
        print(f"decided: {reason} ({count})")
    print(f"left out by aspect: {', '.join(arguments.without) or 'nothing'}")
    print(f"{len(arguments.parts) - len(differing)} of {len(arguments.parts)} parts are equal; {keep / 'report.txt'}")
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
