"""Resources of this machine: memory, disk space and processors for this process, and its speed."""

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
_NO_LIMIT = 1 << 60  # in cgroup version 1, values near the largest integer mean "unlimited"


@dataclass(frozen=True)
class Machine:
    """Resources available to this process; None where unknown to the operating system.

    ``memory_bytes``: Total memory: used by the process and still available.
    ``unwritable``: The directory at the output path without write permission; empty if there is none.
    """

    memory_bytes: int | None
    disk_bytes: int | None
    processors: int
    unwritable: str = ""


def inspect_machine(output: Path) -> Machine:
    """Return the resources of this machine."""
    free = free_memory_bytes()
    pages = _read_text(_MINE / "statm").split()
    memory = free if free is None or len(pages) < 2 else free + int(pages[1]) * os.sysconf("SC_PAGE_SIZE")
    return Machine(memory, free_disk_bytes(output), processors(), unwritable_folder(output))


def processors() -> int:
    """Return the number of processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return max(len(os.sched_getaffinity(0)), 1)
    return os.cpu_count() or 1


def free_disk_bytes(output: Path) -> int | None:
    """Return the free space of the file system of an existing or future path."""
    place = Path(os.path.abspath(output))
    for folder in (place, *place.parents):
        try:
            found = os.statvfs(folder)
        except (FileNotFoundError, NotADirectoryError):
            continue
        except (OSError, AttributeError):
            return None
        # File systems without blocks, as /proc, do not report free space.
        return found.f_bavail * found.f_frsize if found.f_blocks else None
    return None


def unwritable_folder(output: Path) -> str:
    """Return the directory that prevents writing to a path; empty if writing is possible."""
    place = Path(os.path.abspath(output))
    folder = next((one for one in (place, *place.parents) if os.path.lexists(one)), None)
    if folder is None or not os.path.isdir(folder):
        return ""
    if os.access(folder, os.W_OK | os.X_OK):
        try:
            if not hasattr(os, "statvfs") or os.statvfs(folder).f_blocks:
                return ""
            # Virtual file systems report write permission for root, but reject every write.
            os.rmdir(tempfile.mkdtemp(dir=folder))
        except OSError:
            return str(folder)
        return ""
    return str(folder)


def free_memory_bytes(mine: Path = _MINE, memory: Path = _MEMORY, groups: Path = _CGROUPS) -> int | None:
    """Return the memory still available to this process, by all limits."""
    found = [
        _available(memory),
        *(_left_in(folder) for folder in _list_groups(mine, groups)),
        _left_of_address_space(mine),
    ]
    known = [value for value in found if value is not None]
    return max(min(known), 0) if known else None


def _available(memory: Path) -> int | None:
    for line in _read_text(memory).splitlines():
        name, _, rest = line.partition(":")
        if name == "MemAvailable" and rest.split():
            return int(rest.split()[0]) * 1024
    return None


def _list_groups(mine: Path, groups: Path) -> list[tuple[Path, str, str, str]]:
    """Return memory control groups: folder, file of the limit, file of the usage, key of the reclaimable pages."""
    found = []
    for line in _read_text(mine / "cgroup").splitlines():
        number, _, rest = line.partition(":")
        controllers, _, place = rest.partition(":")
        if number == "0" and not controllers:
            base, files = groups, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            base, files = groups / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        inner = Path(place.strip("/"))
        # In a container, a group may be the root, and its own path does not exist.
        found += [(base / part, *files) for part in (inner, *inner.parents)]
    return found


def _left_in(group: tuple[Path, str, str, str]) -> int | None:
    folder, limit_file, use_file, freed = group
    limit, use = _read_text(folder / limit_file).strip(), _read_text(folder / use_file).strip()
    if not limit.isdigit() or not use.isdigit() or int(limit) >= _NO_LIMIT:
        return None
    # Cached file pages count as used, but are reclaimed on demand.
    pages = [row.split()[1] for row in _read_text(folder / "memory.stat").splitlines() if row.startswith(f"{freed} ")]
    return int(limit) - int(use) + (int(pages[0]) if pages else 0)


def _left_of_address_space(mine: Path) -> int | None:
    try:
        import resource
    except ImportError:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    pages = _read_text(mine / "statm").split()
    if limit == resource.RLIM_INFINITY or not pages:
        return None
    return int(limit) - int(pages[0]) * resource.getpagesize()


def _read_text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def work_s() -> float:
    """Return the time in seconds of a small benchmark on this machine, measured once and cached."""
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
