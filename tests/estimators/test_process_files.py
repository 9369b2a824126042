"""Code that processes run is found, whatever called it, and what they write is not."""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenetruth.benchmark import compare
from scenetruth.estimators.external import CommandMethod
from scenetruth.estimators.process_files import compute_hashes, have_changed, list_process_code
from tests.helpers.external_scripts import command
from tests.helpers.nightly import nightly

linux = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")


def put_library(file: Path) -> None:
    """Write a library, or replace it by one of other contents; one in use keeps its contents."""
    content = Path(str(importlib.import_module("_ctypes").__file__)).read_bytes()
    content += b"\0" * (file.stat().st_size + 1 - len(content) if file.exists() else 0)
    file.unlink(missing_ok=True)
    file.write_bytes(content)
    set_old(file)


def set_old(file: Path) -> None:
    """Set the time of change before the start of any run."""
    old = time.time() - 100
    os.utime(file, (old, old))


@linux
def test_a_library_that_this_process_has_loaded_is_listed(tmp_path: Path) -> None:
    library, data = tmp_path / "libmine.so", tmp_path / "data.npy"
    put_library(library)
    np.save(data, np.zeros(9))
    assert library not in list_process_code()
    held = ctypes.CDLL(str(library)), np.load(data, mmap_mode="r")
    assert library in list_process_code()
    assert data not in list_process_code()
    assert not any("site-packages" in str(file) or str(file).startswith("/usr/lib/") for file in list_process_code())
    del held


REPLACING = """
import ctypes, pathlib, sys, time
from scenetruth.estimators.process_files import compute_hashes, have_changed, list_process_code
library = pathlib.Path(sys.argv[1])
held = ctypes.CDLL(str(library))
known = compute_hashes(list_process_code(), time.time(), [library])
assert str(library) in known and not have_changed(known)
content = library.read_bytes()
library.unlink()
library.write_bytes(content)
assert have_changed(compute_hashes(list_process_code(), time.time(), [library]))
"""


@linux
def test_results_of_a_library_that_was_replaced_while_in_use_are_not_reused(tmp_path: Path) -> None:
    put_library(tmp_path / "libmine.so")
    words = [sys.executable, "-c", REPLACING, str(tmp_path / "libmine.so")]
    ran = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_changed_and_missing_files_are_recognised_and_by_products_omitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [tmp_path / name for name in ("one", "two", "late", "missing")]
    for file in files[:3]:
        file.write_text("same")
        set_old(file)
    started = time.time()
    os.utime(files[2], (started + 1, started + 1))
    known = compute_hashes(files, started, [tmp_path / "mine.py"])
    assert sorted(known) == [str(file) for file in files[:2]]
    assert not have_changed(known)
    files[0].write_text("else")
    assert have_changed(known)
    files[0].unlink()
    assert have_changed(known)
    assert not have_changed(compute_hashes(files[1:], started, [tmp_path / "mine.py"]))
    # Temporary files count only if the code of the user is one.
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    inside = tmp_path / "scratch" / "compiled.so"
    inside.write_text("")
    set_old(inside)
    assert not compute_hashes([inside], started, [tmp_path / "mine.py"])
    assert compute_hashes([inside], started, [tmp_path / "scratch" / "mine.py"])


QUICK: dict[str, Any] = {"cases": ["phase_of_flow"], "levels": [0.0]}

PROGRAM = """
import json, time
import numpy as np
camera = json.load(open(recording + "/camera.json"))
np.save(output + "/depth.npy", np.full((camera["height_px"], camera["width_px"]), 720.0, dtype=np.float32))
"""


def kept_result(folder: Path) -> Path:
    (found,) = (folder / "c" / "points" / "phase_of_flow").glob("*.json")
    return found


def test_results_are_measured_again_if_the_program_behind_a_wrapper_has_changed(tmp_path: Path) -> None:
    words = command(tmp_path, PROGRAM).replace("'{recording}'", "$1").replace("'{output}'", "$2")
    (tmp_path / "program.sh").write_text(words)
    (tmp_path / "wrap.sh").write_text(f"exec sh {tmp_path}/program.sh $1 $2 > {tmp_path}/log.txt\n")
    stamps = []
    for change in ("", "", "# changed\n", ""):
        for name in ("program.sh", "mine.py"):
            with (tmp_path / name).open("a") as opened:
                opened.write(f"\n{change}" if change and name == "program.sh" else "")
            set_old(tmp_path / name)
        method = CommandMethod(f"sh {tmp_path}/wrap.sh {{recording}} {{output}}", "mine")
        found = compare(method, output=tmp_path / "c", **QUICK)
        assert not found.failures
        stamps.append(kept_result(tmp_path).stat().st_mtime_ns)
        called = json.loads(kept_result(tmp_path).read_text())["called"]
        assert {Path(name).name for name in called} == {"program.sh", "mine.py"}
    assert stamps[0] == stamps[1] < stamps[2] == stamps[3]


COMPOSED = """
import ctypes
libraries = {folder!r} + "/lib" + "mine.so"
held = ctypes.CDLL(libraries)
time.sleep(0.3)
"""


@nightly
@linux
def test_results_are_measured_again_if_a_library_under_a_composed_name_has_changed(tmp_path: Path) -> None:
    library = tmp_path / "libmine.so"
    put_library(library)
    words = command(tmp_path, COMPOSED.format(folder=str(tmp_path)) + PROGRAM)
    stamps = []
    for round_ in range(4):
        if round_ == 2:
            put_library(library)
        assert not compare(CommandMethod(words, "mine"), output=tmp_path / "c", **QUICK).failures
        stamps.append(kept_result(tmp_path).stat().st_mtime_ns)
        assert str(library) in json.loads(kept_result(tmp_path).read_text())["called"]
    assert stamps[0] == stamps[1] < stamps[2] == stamps[3]


COMPILED = """
import ctypes, numba, numpy as np
from pathlib import Path

HERE = Path(__file__).parent
LOG, BUILT = "log.txt", "libbuilt.so"


@numba.njit(cache=True)
def constant(height, width, value):
    return np.full((height, width), value)


def f(recording):
    with (HERE / LOG).open("a") as log:
        print("called", file=log)
    if not (HERE / BUILT).exists():
        (HERE / BUILT).write_bytes(Path({library!r}).read_bytes())
    ctypes.CDLL(str(HERE / BUILT))
    return {{"depth": constant(*recording["image"].shape[-2:], 720.0)}}
"""


@nightly
def test_by_products_of_a_method_do_not_count(tmp_path: Path) -> None:
    library = str(importlib.import_module("_ctypes").__file__)
    (tmp_path / "compiled.py").write_text(COMPILED.format(library=library))
    words = [
        "-m",
        "scenetruth",
        "compare",
        "compiled:f",
        "--case",
        "phase_of_flow",
        "--level",
        "0",
        "--workers",
        "1",
        "-o",
        "c",
    ]
    stamps, printed, caches = [], [], []
    for is_cold in (True, False, True):
        if is_cold:
            shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
        ran = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr
        printed.append(ran.stderr)
        stamps.append(kept_result(tmp_path).stat().st_mtime_ns)
        caches.append(sum(file.suffix in (".nbi", ".nbc") for file in (tmp_path / "__pycache__").iterdir()))
    assert caches == [2, 2, 0], "the first run compiles, the others reuse its results"
    assert len(set(stamps)) == 1
    for text in printed[1:]:
        assert "reused: 1 of 1 scenes" in text
        assert "--fresh" in text
    assert (tmp_path / "libbuilt.so").exists()
    assert (tmp_path / "log.txt").read_text() == "called\n"
