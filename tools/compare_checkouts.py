"""Compare what two checkouts make of every scene: recordings and truths bit for bit, estimates to a tolerance.

    git worktree add ../before COMMIT
    python tools/compare_checkouts.py ../before . [--scenes cube leaf] [--complete] [--set PATH=VALUE] [--keep FOLDER]

Run it with the Python of an environment in which either checkout runs. What one checkout made is kept in FOLDER/before
and FOLDER/after and taken from there when it is asked for again; delete what is to be made anew.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

WORKER = """
import hashlib, json, sys, warnings
from pathlib import Path
import numpy as np
import scenetruth as st

file, target, content, *overrides = Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:]
warnings.simplefilter("ignore")
scene = st.load_scene(file, overrides=overrides)

def digests(dataset):
    found = {}
    for name, item in {**dataset.coords, **dataset.data_vars}.items():
        values = np.ascontiguousarray(item.values)
        data = json.dumps(values.tolist()).encode() if values.dtype.kind in "UO" else values.tobytes()
        sha = hashlib.sha256(data).hexdigest()[:16]
        found[name] = f"{','.join(map(str, item.dims))} {values.shape} {values.dtype} {sha}"
    return found

recording, truth = st.simulate(scene, truth_content=content)
estimate = st.estimate(recording, **scene.estimate.model_dump())
target.parent.mkdir(parents=True, exist_ok=True)
np.savez(target.with_suffix(".npz"), **{name: item.values for name, item in estimate.data_vars.items()})
target.with_suffix(".json").write_text(json.dumps({"recording": digests(recording), "truth": digests(truth)}, indent=1))
"""


def make(checkout: Path, scene: str, target: Path, content: str, overrides: list[str]) -> None:
    """Make recording, truth and estimate of a scene with one checkout, if that is not done yet."""
    if target.with_suffix(".json").exists():
        return
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    # The scene of the checkout itself: a field that was renamed is renamed there too.
    file = checkout / "scenes" / f"{scene}.yaml"
    command = [sys.executable, "-c", WORKER, file, target, content, *overrides]
    subprocess.run(command, env=environment, cwd=checkout, check=True)


def differences(before: Path, after: Path, tolerance: float) -> list[str]:
    """Return what differs between two results, a line each."""
    import numpy as np

    found = []
    one, other = (json.loads(path.with_suffix(".json").read_text()) for path in (before, after))
    for kind in one:
        found += [
            f"{kind}.{name}: {one[kind].get(name)} -> {other[kind].get(name)}"
            for name in sorted({*one[kind], *other[kind]})
            if one[kind].get(name) != other[kind].get(name)
        ]
    with np.load(before.with_suffix(".npz")) as first, np.load(after.with_suffix(".npz")) as second:
        for name in sorted({*first.files, *second.files}):
            if name not in first.files or name not in second.files:
                found.append(f"estimate.{name}: only {'before' if name in first.files else 'after'}")
                continue
            a, b = (np.asarray(item[name], dtype=np.float64) for item in (first, second))
            if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
                found.append(f"estimate.{name}: other shape, or other pixels without a value")
                continue
            worst = np.nanmax(np.abs(a - b) / np.maximum(1, np.abs(a)), initial=0.0)
            if worst > tolerance:
                found.append(f"estimate.{name}: differs by up to {worst:.3g}")
    return found


def main() -> int:
    """Compare, print, and return 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--scenes", nargs="*", help="names of scenes; all of the first checkout if not given")
    parser.add_argument("--complete", action="store_true", help="compare the complete truth")
    parser.add_argument("--set", dest="overrides", action="append", default=[], help="override a field in both")
    parser.add_argument("--tolerance", type=float, default=1e-6, help="of estimates, relative to values above 1")
    parser.add_argument("--keep", type=Path, default=Path("outputs/compare"), help="where results are kept")
    arguments = parser.parse_args()
    scenes = arguments.scenes or sorted(path.stem for path in (arguments.before / "scenes").glob("*.yaml"))
    content = "complete" if arguments.complete else "standard"
    keep, differing = arguments.keep.resolve(), 0
    for scene in scenes:
        for name, checkout in (("before", arguments.before), ("after", arguments.after)):
            make(checkout.resolve(), scene, keep / name / content / scene, content, arguments.overrides)
        found = differences(keep / "before" / content / scene, keep / "after" / content / scene, arguments.tolerance)
        differing += bool(found)
        print(f"{scene}: {'equal' if not found else ''}", *found, sep="\n    " if found else "", flush=True)
    print(f"{len(scenes) - differing} of {len(scenes)} scenes are equal")
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
