"""Directories that cannot be written are rejected, with the reason, before any work."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.output import check_output, check_writable


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
@pytest.mark.parametrize("check", [check_writable, check_output])
def test_virtual_file_systems_are_refused(check: object) -> None:
    assert callable(check)
    with pytest.raises(st.StoreError, match=r"/proc/x: cannot be written: no directory can be created in /proc"):
        check("/proc/x")


def test_files_are_no_directories(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(st.StoreError, match="exists, and is not a directory"):
        check_writable(file)
    with pytest.raises(st.StoreError, match=f"because {file} is not a directory"):
        check_writable(file / "below")


def test_directories_without_permission_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    check_writable(tmp_path / "there")
    # As on a disk that is mounted for reading: root has all permissions otherwise.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(st.StoreError, match="is a directory that is not writable"):
        check_writable(tmp_path / "there")
    with pytest.raises(st.StoreError, match=f"because {tmp_path} is not writable"):
        check_writable(tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
