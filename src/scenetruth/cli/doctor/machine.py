"""What Python, the machine and the terminal are."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

from scenetruth import __version__
from scenetruth.cli.doctor.finding import Finding

__all__ = ["look_at_machine", "look_at_python", "look_at_terminal"]

_LEAST_PYTHON = (3, 11)
_LEAST_BYTES = 1e9
"""Memory, and disk space, below which little can be made: a run of the noise cube takes some hundred megabytes."""


def look_at_python() -> list[Finding]:
    """Return the versions of scenetruth and of Python, and the system."""
    package = Path(__file__).resolve().parents[2]
    new_enough = sys.version_info >= _LEAST_PYTHON
    least = ".".join(map(str, _LEAST_PYTHON))
    linux = sys.platform == "linux"
    return [
        Finding("python", "scenetruth", "ok", f"{__version__}, in {package}"),
        Finding(
            "python",
            "python",
            "ok" if new_enough else "broken",
            f"{platform.python_version()}, {sys.executable}",
            "" if new_enough else f"install Python {least} or newer",
            needed=True,
        ),
        Finding(
            "python",
            "platform",
            "ok" if linux else "missing",
            platform.platform(),
            "" if linux else "use Linux, which alone is tested",
        ),
    ]


def look_at_machine() -> list[Finding]:
    """Return processors, memory and disk space, as far as this process may have them."""
    try:
        from scenetruth.cache import cache_folder
        from scenetruth.resources import machine_at
        from scenetruth.resources.machine import free_disk_bytes
    except Exception as error:  # whatever a library that cannot be loaded raises
        told = f"cannot be loaded: {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return [
            Finding("machine", "libraries", "broken", told, "pip install --force-reinstall scenetruth", needed=True)
        ]
    here, cache = Path(), cache_folder()
    machine = machine_at(here)
    found = [
        Finding("machine", "processors", "ok", f"{machine.processors} of {os.cpu_count()} for this process"),
        _amount("memory", machine.memory_bytes, "for this process, all limits counted", "end other programs"),
        _amount("disk", machine.disk_bytes, f"free at {here.absolute()}", "free some space, or work elsewhere"),
    ]
    if cache is not None:
        told = f"free at {cache}"
        found.append(_amount("disk of the cache", free_disk_bytes(cache), told, "set SCENETRUTH_CACHE elsewhere"))
    return found


def _amount(name: str, count: int | None, where: str, remedy: str) -> Finding:
    if count is None:
        return Finding("machine", name, "ok", f"unknown {where}")
    enough = count >= _LEAST_BYTES
    told = f"{count / 1e9:.1f} GB {where}"
    return Finding("machine", name, "ok" if enough else "missing", told, "" if enough else remedy)


def look_at_terminal() -> Finding:
    """Return whether the terminal shows all characters, and colours."""
    from rich.console import Console

    console = Console()
    encoding = (getattr(sys.stdout, "encoding", None) or "unknown").lower()
    full = encoding.replace("-", "") == "utf8"
    colours = console.color_system or "no"
    place = f"{colours} colours, {console.width} columns" if sys.stdout.isatty() else "no terminal"
    remedy = "" if full else "set LANG=C.UTF-8 or PYTHONUTF8=1; until then some characters are shown by their numbers"
    return Finding("terminal", "output", "ok" if full else "missing", f"{encoding}, {place}", remedy)
