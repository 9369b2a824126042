"""Makes one part of the comparison; runs inside a checkout, whose src is first on the path of imports."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from comparison_adapter import Scenes
from comparison_parts import PARTS, Context
from comparison_records import Records
from comparison_renames import Renames


def main() -> int:
    """Make a part, and write it to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("part", choices=list(PARTS))
    parser.add_argument("target", type=Path)
    parser.add_argument("fingerprint")
    parser.add_argument("--renames", type=Path, required=True)
    parser.add_argument("--scenes", nargs="*")
    parser.add_argument("--width", type=int, default=80)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    arguments = parser.parse_args()
    checkout = arguments.checkout.resolve()
    begin = time.perf_counter()
    import scenetruth

    source = Path(str(scenetruth.__file__)).resolve()
    if not source.is_relative_to(checkout / "src"):
        sys.exit(f"scenetruth was imported from {source}, not from {checkout / 'src'}")
    renames = Renames.read(arguments.renames)
    scenes = Scenes(checkout, renames, arguments.width, arguments.overrides)
    with tempfile.TemporaryDirectory(prefix="comparison-") as work:
        places = {work: "WORK", str(checkout): "CHECKOUT", tempfile.gettempdir() + "/scenetruth-": "WORK"}
        records = Records(places, keeps_arrays=arguments.part == "estimates")
        chosen = [name for name in scenes.names() if not arguments.scenes or name in arguments.scenes]
        PARTS[arguments.part](Context(records, scenes, chosen, renames, Path(work), checkout))
    found = {
        "fingerprint": arguments.fingerprint,
        "source": str(source.parent),
        "seconds": round(time.perf_counter() - begin, 1),
        "failures": records.failures,
        "entries": records.entries,
    }
    if records.arrays:
        np.savez(arguments.target.with_suffix(".npz"), *records.arrays)
    arguments.target.write_text(json.dumps(found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
