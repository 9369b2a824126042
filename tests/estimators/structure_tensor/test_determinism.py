"""Same images, same bytes: freshly compiled or from the cache, on one thread or two."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CODE = """
import hashlib, numpy as np, scenetruth as st
images = np.random.default_rng(0).integers(0, 255, (5, 9, 64, 96), dtype=np.uint8)
maps = st.estimate(st.make_recording(images, 500.0, 5.0), working_point_px=1, tau=0.0)
print(hashlib.sha256(b"".join(maps[name].values.tobytes() for name in sorted(maps.data_vars))).hexdigest())
"""


def test_estimates_do_not_depend_on_compilation_or_threads(tmp_path: Path) -> None:
    hashes = set()
    for threads in ("2", "2", "1"):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_NUM_THREADS": threads}
        done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True, env=environment)
        hashes.add(done.stdout)
    assert len(hashes) == 1
