"""Room on disk and in memory: nothing is given up where there is none."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from scenetruth.errors import StoreError
from scenetruth.jobs.scheduler import ResourceGuard, write_with_retry
from scenetruth.output import is_full_disk


def full() -> StoreError:
    error = StoreError("a.parquet", "the disk is full")
    error.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    return error


def test_a_full_disk_is_known_behind_other_errors() -> None:
    assert is_full_disk(OSError(errno.EDQUOT, "quota"))
    assert is_full_disk(full())
    assert not is_full_disk(OSError(errno.EACCES, "denied"))
    assert not is_full_disk(StoreError("a", "the disk is full"))


def test_what_finds_the_disk_full_is_written_when_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenetruth.jobs.scheduler.FULL_S", 0.0)
    errors = [full(), full()]

    def write() -> None:
        if errors:
            raise errors.pop()

    said: list[str] = []
    write_with_retry(write, "the catalogue", said.append)
    assert [line.split(",")[0] for line in said] == ["paused: the disk is full", "resumed"]

    def refused() -> None:
        raise OSError(errno.EACCES, "denied")

    with pytest.raises(OSError, match="denied"):
        write_with_retry(refused, "the catalogue", said.append)


@pytest.mark.parametrize(
    ("disk", "memory", "told"),
    [(1e9, 1e9, ""), (3.1e8, 1e9, "the disk is nearly full"), (1e9, 1e7, "memory is short"), (None, None, "")],
)
def test_no_sample_is_begun_without_room(
    disk: float | None, memory: float | None, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scenetruth.jobs.scheduler.free_disk_bytes", lambda folder: disk)
    monkeypatch.setattr("scenetruth.jobs.scheduler.free_memory_bytes", lambda: memory)
    assert ResourceGuard(tmp_path, 2e8, 2e7)().startswith(told)
    assert bool(ResourceGuard(tmp_path, 2e8, 2e7)()) == bool(told)
