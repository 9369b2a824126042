"""Freed memory is retained where it is needed again, and returned afterwards."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from scenetruth import memory

def faults(size=250_000):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(40):
        # 500 pages; NumPy asks for huge ones where arrays are larger than 4 MB.
        np.ones(size)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
"""
GLIBC = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="specific to the C library of GNU")


def count(code: str) -> list[int]:
    """Return the numbers that a process prints which returns freed memory at once."""
    variables = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    done = subprocess.run(
        [sys.executable, "-c", FAULTS + code], env=variables, capture_output=True, text=True, check=True
    )
    return [int(word) for word in done.stdout.split()]


@GLIBC
def test_memory_that_dask_would_give_back_is_kept() -> None:
    given_back, kept = count("print(faults()); memory.keep_freed_memory(); faults(); print(faults())")
    assert given_back > 40 * 450
    assert kept < given_back / 10


@GLIBC
def test_memory_is_retained_and_then_returned() -> None:
    given_back, kept, resident, after = count("""
def resident():
    return int(open("/proc/self/statm").read().split()[1])

print(faults())
with memory.retained_memory():
    faults()
    print(faults())
    # Kept apart from the end of the memory, which is returned first.
    parts = [np.ones(250_000) for _ in range(80)]
    last = np.ones(1000)
    del parts
    print(resident())
print(resident())
""")
    assert given_back > 40 * 450
    assert kept < given_back / 10
    # 80 arrays of 488 pages.
    assert resident - after > 80 * 400
