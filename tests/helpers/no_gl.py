"""Python processes for which there is no OpenGL."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

__all__ = ["fresh_workers", "python_path_without_gl"]


@contextmanager
def fresh_workers() -> Iterator[None]:
    """Start the workers of this block in the environment of this block, and later ones in that of later."""
    server: Any = forkserver.__dict__["_forkserver"]
    # Workers are forks of one process, which keeps the environment of the first test that needed it.
    server._stop()
    try:
        yield
    finally:
        server._stop()


def python_path_without_gl(folder: Path) -> str:
    """Return the ``PYTHONPATH`` of such processes; a file in a folder makes them so."""
    # PyOpenGL finds no library where ctypes finds none.
    (folder / "sitecustomize.py").write_text(
        "import ctypes.util, ctypes\n"
        "_load = ctypes.CDLL.__init__\n"
        "def refuse(self, name, *a, **k):\n"
        "    if name and any(part in str(name) for part in ('GL', 'OSMesa')):\n"
        "        raise OSError(f'{name}: not here')\n"
        "    _load(self, name, *a, **k)\n"
        "ctypes.CDLL.__init__ = refuse\n"
        "_find = ctypes.util.find_library\n"
        "ctypes.util.find_library = lambda name: None if 'GL' in name or 'OSMesa' in name else _find(name)\n"
    )
    return os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
