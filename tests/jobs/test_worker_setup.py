"""What a worker does before its first sample."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from scenetruth.memory import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(40):
        # 500 pages; NumPy asks for huge ones where arrays are larger than 4 MB.
        np.ones(250_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

given_back = faults()
keep_freed_memory()
faults()
print(given_back, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is told by a variable to give memory back")
def test_memory_that_dask_would_give_back_is_kept() -> None:
    variables = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    told = subprocess.run([sys.executable, "-c", FAULTS], env=variables, capture_output=True, text=True, check=True)
    given_back, kept = map(int, told.stdout.split())
    assert given_back > 40 * 450
    assert kept < given_back / 10
