"""Files that processes use are found, whatever called them."""

from __future__ import annotations

import ctypes
import importlib
import json
import shutil
import sys
from pathlib import Path

import pytest

from scenetruth.benchmark import compare
from scenetruth.estimators.external import CommandMethod
from scenetruth.estimators.process_files import compute_hashes, have_changed, list_process_files
from tests.helpers.external_scripts import command

linux = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")


@linux
def test_a_library_that_this_process_has_loaded_is_listed(tmp_path: Path) -> None:
    library = tmp_path / "libmine.so"
    shutil.copy(str(importlib.import_module("_ctypes").__file__), library)
    assert library not in list_process_files()
    ctypes.CDLL(str(library))
    assert library in list_process_files()
    assert not any("site-packages" in str(file) or str(file).startswith("/usr/lib/") for file in list_process_files())


def test_changed_and_missing_files_are_recognised(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one", "two")]
    for file in files:
        file.write_text("same")
    known = compute_hashes([*files, tmp_path / "missing"])
    assert sorted(known) == [str(file) for file in files]
    assert not have_changed(known)
    files[0].write_text("else")
    assert have_changed(known)
    files[0].unlink()
    assert have_changed(known)
    assert not have_changed(compute_hashes(files[1:]))


CODE = """
import json, time
import numpy as np
# The name is composed, so that no text of this file names it.
weights = open({folder!r} + "/" + "weights" + ".bin")
log = open({folder!r} + "/" + "log" + ".txt", "a")
time.sleep(0.4)
camera = json.load(open(recording + "/camera.json"))
np.save(output + "/depth.npy", np.full((camera["height_px"], camera["width_px"]), 720.0, dtype=np.float32))
"""


@linux
def test_results_are_measured_again_if_a_file_that_the_program_had_open_has_changed(tmp_path: Path) -> None:
    (tmp_path / "weights.bin").write_text("first")
    words = command(tmp_path, CODE.format(folder=str(tmp_path)))
    stamps = []
    for content in ("first", "first", "second"):
        (tmp_path / "weights.bin").write_text(content)
        found = compare(CommandMethod(words, "mine"), output=tmp_path / "c", cases=["phase_of_flow"], levels=[0.0])
        assert not found.failures
        (kept,) = (tmp_path / "c" / "points" / "phase_of_flow").glob("*.json")
        stamps.append(kept.stat().st_mtime_ns)
        called = json.loads(kept.read_text())["called"]
        assert str(tmp_path / "weights.bin") in called
        assert str(tmp_path / "log.txt") not in called
    assert stamps[0] == stamps[1] < stamps[2]
