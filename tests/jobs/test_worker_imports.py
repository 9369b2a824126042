"""Workers share imported modules, and nothing that a fork would break."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

from scenetruth.jobs import worker_imports
from tests.helpers.nightly import nightly

PROBE = """
import gc, sys, threading
import scenetruth.jobs.worker_imports
from numba.np.ufunc import parallel
print(threading.active_count(), parallel._is_initialized, gc.isenabled(), gc.get_freeze_count() > 100_000)
print("scenetruth.simulation" in sys.modules, "dask" in sys.modules, "matplotlib" in sys.modules)
"""


def test_every_shared_module_exists() -> None:
    # What cannot be imported is not reported.
    assert [name for name in worker_imports._MODULES if find_spec(name) is None] == []


@nightly
def test_no_thread_is_started_before_workers_are_forked() -> None:
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "False", "True", "True", "True", "False", "False"]
