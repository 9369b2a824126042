"""Preparation of worker processes: threads, memory, end with the parent, and versions that must agree."""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

from scenetruth.errors import MachineError, Problem
from scenetruth.provenance import own_release

__all__ = [
    "collect_versions",
    "keep_freed_memory",
    "limit_threads",
    "refuse_other_versions",
    "run_with_threads",
    "start_worker",
]


_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLOSC_NTHREADS")


def start_worker(threads: int) -> None:
    """Prepare a process that was started by spawning."""
    # A Ctrl-C goes to every process of the terminal: the parent decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads(threads)
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()


def limit_threads(threads: int) -> None:
    """Let the libraries that compute use so many threads in this process, whether they are loaded or not."""
    for name in _VARIABLES:
        os.environ[name] = str(threads)
    # OpenGL in software draws in threads of its own, 0 for none.
    os.environ["LP_NUM_THREADS"] = str(threads if threads > 1 else 0)
    os.environ["ZARR_THREADING__MAX_WORKERS"] = str(threads)
    os.environ["ZARR_ASYNC__CONCURRENCY"] = str(threads)
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    if "numpy" in sys.modules:
        from threadpoolctl import threadpool_limits

        threadpool_limits(threads)


def keep_freed_memory() -> None:
    """Let the C library keep memory that was freed, as it does by itself, where Dask has told it to give all back.

    Dask starts its workers with ``MALLOC_TRIM_THRESHOLD_=65536``. Then every large array is made of pages that the
    system hands out and clears anew: 356,000 of them for a noise cube of 320 x 240 px instead of 2,500, and 0.9 s more.
    """
    if "MALLOC_TRIM_THRESHOLD_" not in os.environ:
        return
    # Only glibc knows this variable, and has the function.
    adjust = getattr(ctypes.CDLL(None), "mallopt", None)
    if adjust is not None:
        # Where glibc arrives by itself: arrays up to 32 MB are kept for the next ones.
        adjust(_MMAP_THRESHOLD, 32 * 2**20)
        adjust(_TRIM_THRESHOLD, 64 * 2**20)


# Numbers of malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3


def run_with_threads(threads: int, work: Callable[..., Any], *arguments: Any) -> Any:
    """Do a piece of work with so many threads, in a process that somebody else has started."""
    # numba counts for each thread by itself.
    if getattr(_LIMITED, "threads", 0) != threads:
        limit_threads(threads)
        keep_freed_memory()
        _LIMITED.threads = threads
    return work(*arguments)


_LIMITED = threading.local()


def _end_with_parent() -> None:
    """End this process as soon as its parent has ended, however that was: a pool's workers would wait for ever."""
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


_PACKAGES = ("numpy", "scipy")


def collect_versions() -> dict[str, str]:
    """Return the versions on which results depend."""
    others = {one: version(one) for one in _PACKAGES}
    return {"python": platform.python_version(), "scenetruth": own_release(), **others}


def refuse_other_versions(versions: Mapping[str, str]) -> None:
    """Refuse to work with other versions than a job was begun with."""
    if not versions:
        return
    here = collect_versions()
    problems = [
        Problem("workers", f"{platform.node()} has {name} {here.get(name)}, and the job was begun with {one}")
        for name, one in versions.items()
        if here.get(name) != one
    ]
    if problems:
        raise MachineError(problems)
