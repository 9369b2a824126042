"""Interrupts that compiled code swallows still end the command."""

from __future__ import annotations

import subprocess
import sys

SWALLOWED = """
import ctypes, os, signal, time
from scenetruth.cli.console import guard

def work():
    callback = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))
    callback()  # an exception cannot leave a callback of C code
    print("went on", flush=True)
    time.sleep(60)

guard(work)
"""


def test_an_interrupt_that_c_code_swallows_comes_again() -> None:
    done = subprocess.run([sys.executable, "-c", SWALLOWED], capture_output=True, text=True, timeout=50, check=False)
    assert "went on" in done.stdout
    assert done.returncode == 130, done.stderr
    assert "error: interrupted" in done.stderr
    assert "Traceback" not in done.stderr
