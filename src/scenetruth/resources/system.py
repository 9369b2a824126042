"""The resources of this machine: memory, disk and processors for this process, and its speed."""

from __future__ import annotations

import os
import platform
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenetruth.cache import entry_key, load_or_compute

__all__ = ["Machine", "free_disk_bytes", "free_memory_bytes", "inspect_machine", "unwritable_folder", "work_s"]

_CGROUPS = Path("/sys/fs/cgroup")
_MEMORY = Path("/proc/meminfo")
_MINE = Path("/proc/self")
# Limits of version 1 that are as large as can be written mean that there is none.
_NO_LIMIT = 1 << 60


@dataclass(frozen=True)
class Machine:
    """What the machine has for this process; None where it does not tell.

    ``memory_bytes``: Memory that the process may have in all: what it has, and what can still be taken.
    ``disk_bytes``: Space that is free where results go.
    ``processors``: Processors that the process may run on.
    ``unwritable``: The folder, of those that results go to, in which this process may not write; empty if it may.
    """

    memory_bytes: int | None
    disk_bytes: int | None
    processors: int
    unwritable: str = ""


def inspect_machine(output: Path) -> Machine:
    """Return what the machine has."""
    free = free_memory_bytes()
    pages = _text_of(_MINE / "statm").split()
    memory = free if free is None or len(pages) < 2 else free + int(pages[1]) * os.sysconf("SC_PAGE_SIZE")
    return Machine(memory, free_disk_bytes(output), processors(), unwritable_folder(output))


def processors() -> int:
    """Return how many processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return max(len(os.sched_getaffinity(0)), 1)
    return os.cpu_count() or 1


def free_disk_bytes(output: Path) -> int | None:
    """Return how much space is free in the file system that a path is, or will be, in."""
    place = Path(os.path.abspath(output))
    for folder in (place, *place.parents):
        try:
            found = os.statvfs(folder)
        except (FileNotFoundError, NotADirectoryError):
            continue
        except (OSError, AttributeError):
            return None
        # What has no size, as /proc, is no disk, and others of that sort do not tell what they have.
        return found.f_bavail * found.f_frsize if found.f_blocks else None
    return None


def unwritable_folder(output: Path) -> str:
    """Return the folder in which results cannot be made, because this process may not write there."""
    place = Path(os.path.abspath(output))
    folder = next((one for one in (place, *place.parents) if os.path.lexists(one)), None)
    if folder is None or not os.path.isdir(folder):
        return ""
    if os.access(folder, os.W_OK | os.X_OK):
        try:
            if not hasattr(os, "statvfs") or os.statvfs(folder).f_blocks:
                return ""
            # Folders of the system say that root may write, and then let nobody.
            os.rmdir(tempfile.mkdtemp(dir=folder))
        except OSError:
            return str(folder)
        return ""
    return str(folder)


def free_memory_bytes(mine: Path = _MINE, memory: Path = _MEMORY, groups: Path = _CGROUPS) -> int | None:
    """Return how much memory this process can still take, by all that limits it."""
    found = [
        _available(memory),
        *(_left_in(folder) for folder in _groups_of(mine, groups)),
        _left_of_address_space(mine),
    ]
    known = [value for value in found if value is not None]
    return max(min(known), 0) if known else None


def _available(memory: Path) -> int | None:
    for line in _text_of(memory).splitlines():
        name, _, rest = line.partition(":")
        if name == "MemAvailable" and rest.split():
            return int(rest.split()[0]) * 1024
    return None


def _groups_of(mine: Path, groups: Path) -> list[tuple[Path, str, str, str]]:
    """Return folders of the groups that limit memory, with their files of the limit, the use and what can be freed."""
    found = []
    for line in _text_of(mine / "cgroup").splitlines():
        number, _, rest = line.partition(":")
        controllers, _, place = rest.partition(":")
        if number == "0" and not controllers:
            base, files = groups, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            base, files = groups / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        inner = Path(place.strip("/"))
        # Where a group sees itself as the topmost one, its own path is not there.
        found += [(base / part, *files) for part in (inner, *inner.parents)]
    return found


def _left_in(group: tuple[Path, str, str, str]) -> int | None:
    folder, limit_file, use_file, freed = group
    limit, use = _text_of(folder / limit_file).strip(), _text_of(folder / use_file).strip()
    if not limit.isdigit() or not use.isdigit() or int(limit) >= _NO_LIMIT:
        return None
    # Pages of files count as used, but are given up when memory is wanted.
    pages = [line.split()[1] for line in _text_of(folder / "memory.stat").splitlines() if line.startswith(f"{freed} ")]
    return int(limit) - int(use) + (int(pages[0]) if pages else 0)


def _left_of_address_space(mine: Path) -> int | None:
    try:
        import resource
    except ImportError:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    pages = _text_of(mine / "statm").split()
    if limit == resource.RLIM_INFINITY or not pages:
        return None
    return int(limit) - int(pages[0]) * resource.getpagesize()


def _text_of(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def work_s() -> float:
    """Return how long a small piece of work takes on this machine: measured once, and remembered by later processes."""
    key = entry_key("speed", platform.node(), _WORK_VERSION)
    return float(load_or_compute(key, lambda: {"seconds": np.array([_best_s()])})["seconds"][0])


_WORK_VERSION = 1
_TRIES = 7
_NUMBERS = 16_384


def _best_s() -> float:
    values, times = np.linspace(0.1, 1.0, _NUMBERS), []
    for _ in range(_TRIES):
        start = time.perf_counter()
        for _ in range(8):
            values = np.sqrt(np.sin(values) ** 2 + 0.5)
        times.append(time.perf_counter() - start)
    return min(times)
