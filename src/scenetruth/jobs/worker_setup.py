"""Preparation of worker processes: threads, memory, end with the parent, and equal versions."""

from __future__ import annotations

import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

from scenetruth.errors import MachineError, Problem
from scenetruth.memory import keep_freed_memory
from scenetruth.provenance import own_release

__all__ = [
    "collect_versions",
    "limit_threads",
    "refuse_other_versions",
    "run_with_threads",
    "start_worker",
]


_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLOSC_NTHREADS")


def start_worker(threads: int, environment: Mapping[str, str]) -> None:
    """Prepare a new process; ``environment``: Variables of its parent, which may have changed before it was forked."""
    os.environ.clear()
    os.environ.update(environment)
    # Ctrl-C is sent to every process of the terminal; the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads(threads)
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()


def limit_threads(threads: int) -> None:
    """Limit the threads of numerical libraries in this process, whether they are loaded or not."""
    for name in _VARIABLES:
        os.environ[name] = str(threads)
    # Software OpenGL uses its own threads, 0 for none.
    os.environ["LP_NUM_THREADS"] = str(threads if threads > 1 else 0)
    os.environ["ZARR_THREADING__MAX_WORKERS"] = str(threads)
    os.environ["ZARR_ASYNC__CONCURRENCY"] = str(threads)
    if "numba" in sys.modules:
        import numba

        # The compiler compares the variable with the number of threads at the first use, and raises if they differ.
        try:
            numba.config.reload_config()
        except RuntimeError:
            os.environ["NUMBA_NUM_THREADS"] = str(numba.config.NUMBA_NUM_THREADS)
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    if "numpy" in sys.modules:
        from threadpoolctl import threadpool_limits

        threadpool_limits(threads)


def run_with_threads(threads: int, work: Callable[..., Any], *arguments: Any) -> Any:
    """Perform a task with a limited number of threads in an external process."""
    # numba counts per thread.
    if getattr(_LIMITED, "threads", 0) != threads:
        limit_threads(threads)
        keep_freed_memory()
        _LIMITED.threads = threads
    return work(*arguments)


_LIMITED = threading.local()


def _end_with_parent() -> None:
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
    """Raise if the versions differ from those at the start of a job."""
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
