"""What the machine has, by all that limits a process."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from scenetruth.resources import system
from scenetruth.resources.system import free_disk_bytes, free_memory_bytes, inspect_machine, unwritable_folder, work_s

MB = 1 << 20


def told(folder: Path, files: dict[str, str]) -> tuple[Path, Path, Path]:
    """Write what a system tells of a process, its memory and its groups; return the three places."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / "self", folder / "meminfo", folder / "groups"


def free_mb(folder: Path, **files: str) -> int | None:
    found = free_memory_bytes(*told(folder, {name.replace("__", "/"): text for name, text in files.items()}))
    return None if found is None else found // MB


FREE = {"meminfo": "MemTotal: 9000 kB\nMemAvailable:   8192000 kB\n"}


def test_what_the_machine_has_left_is_what_there_is_without_groups(tmp_path: Path) -> None:
    assert free_mb(tmp_path, **FREE) == 8000
    assert free_mb(tmp_path, **FREE, self__cgroup="0::/some/where\n") == 8000


@pytest.mark.parametrize("place", ["inner", "elsewhere"])
def test_the_limits_of_all_groups_around_count(tmp_path: Path, place: str) -> None:
    files = told(
        tmp_path,
        {
            **FREE,
            "self/cgroup": f"0::/outer/{place}\n",
            "groups/outer/memory.max": f"{900 * MB}\n",
            "groups/outer/memory.current": f"{500 * MB}\n",
            "groups/outer/memory.stat": f"anon 5\ninactive_file {100 * MB}\n",
            "groups/outer/inner/memory.max": f"{300 * MB}",
            "groups/outer/inner/memory.current": f"{250 * MB}",
            "groups/memory.max": "max\n",
            "groups/memory.current": "7\n",
        },
    )
    assert free_memory_bytes(*files) == (50 if place == "inner" else 500) * MB


def test_groups_of_the_first_version_are_read_too(tmp_path: Path) -> None:
    files = {
        **FREE,
        "self__cgroup": "5:cpu:/\n4:memory,blkio:/box\n0::/\n",
        "groups__memory__box__memory.limit_in_bytes": str(700 * MB),
        "groups__memory__box__memory.usage_in_bytes": str(600 * MB),
        "groups__memory__memory.limit_in_bytes": str(9223372036854771712),
        "groups__memory__memory.usage_in_bytes": "4096",
    }
    assert free_mb(tmp_path, **files) == 100


def test_a_limit_that_is_passed_leaves_nothing(tmp_path: Path) -> None:
    files = {"self__cgroup": "0::/\n", "groups__memory.max": "1000", "groups__memory.current": "2000"}
    assert free_mb(tmp_path, **FREE, **files) == 0


def test_where_nothing_is_told_nothing_is_known(tmp_path: Path) -> None:
    assert free_memory_bytes(*told(tmp_path, {})) is None


def test_the_disk_is_that_of_the_nearest_folder_there_is(tmp_path: Path) -> None:
    free = shutil.disk_usage(tmp_path).free
    found = free_disk_bytes(tmp_path / "not" / "yet" / "there")
    assert found is not None
    # Others write at the same time.
    assert abs(found - free) < 0.1 * free


def test_folders_of_the_system_have_no_disk_and_take_nothing(tmp_path: Path) -> None:
    """Also from root, who is told that it may write there."""
    if not Path("/proc/self").exists():
        pytest.skip("this system tells of itself in another way")
    here = inspect_machine(Path("/proc/results/of/mine"))
    assert here.unwritable == "/proc"
    assert here.disk_bytes is None
    assert inspect_machine(tmp_path / "not" / "yet").unwritable == ""
    assert list(tmp_path.iterdir()) == []


def test_where_one_may_not_write_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Root may write anywhere: what the system says is told for it.
    monkeypatch.setattr(os, "access", lambda place, mode: Path(place) != tmp_path)
    assert unwritable_folder(tmp_path / "deep" / "results") == str(tmp_path)
    (tmp_path / "deep").mkdir()
    assert unwritable_folder(tmp_path / "deep" / "results") == ""
    (tmp_path / "file").touch()
    # That a file is in the way is told by whoever makes the folder.
    assert unwritable_folder(tmp_path / "file" / "results") == ""


def test_this_machine_has_something(tmp_path: Path) -> None:
    here = inspect_machine(tmp_path)
    assert here.processors >= 1
    assert here.memory_bytes is None or here.memory_bytes > 0


def test_the_speed_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCENETRUTH_CACHE", str(tmp_path))
    first = work_s()
    assert 1e-5 < first < 1
    monkeypatch.setattr(system, "_best_s", lambda: 77.0)
    assert work_s() == first
    monkeypatch.setenv("SCENETRUTH_CACHE", "off")
    assert work_s() == 77.0
