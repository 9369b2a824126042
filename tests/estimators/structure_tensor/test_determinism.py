"""Same images, same bytes: freshly compiled or from the cache, on one thread or two."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path

from scenetruth.compilation import thread_count
from tests.nightly import nightly

CODE = """
import hashlib, numpy as np, scenetruth as st
images = np.random.default_rng(0).integers(0, 255, (5, 9, 64, 96), dtype=np.uint8)
maps = st.estimate(st.make_recording(images, 500.0, 5.0), working_point_px=1, tau=0.0)
print(hashlib.sha256(b"".join(maps[name].values.tobytes() for name in sorted(maps.data_vars))).hexdigest())
"""


def hashes_of(*threads: str, **environment: str) -> set[str]:
    found = set()
    for count in threads:
        own = {**os.environ, "NUMBA_NUM_THREADS": count, **environment}
        done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True, env=own)
        found.add(done.stdout)
    return found


def hash_here() -> str:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(CODE, {})
    return printed.getvalue()


def test_estimates_do_not_depend_on_threads() -> None:
    many = {hash_here()} if thread_count() > 1 else hashes_of("2")
    assert len(many | hashes_of("1")) == 1


@nightly
def test_estimates_do_not_depend_on_compilation(tmp_path: Path) -> None:
    # The first one compiles everything.
    assert len(hashes_of("2", "2", "1", NUMBA_CACHE_DIR=str(tmp_path)) | hashes_of("2")) == 1
