"""Methods of one's own are known by what they are made of; those that are installed are not."""

from __future__ import annotations

import functools
import importlib
import shutil
import sys
import types
from collections.abc import Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import pytest

from scenetruth.estimators.code_fingerprint import compute_code_fingerprint
from scenetruth.estimators.external import CommandMethod, ResultsFolder
from scenetruth.estimators.user_code import with_imported

METHOD = """def f(recording):
    return None


class Other:
    name = "other"
"""


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.parametrize("method", ["structure_tensor", "plane_sweep"])
def test_what_is_installed_is_known_by_its_name(method: str) -> None:
    assert compute_code_fingerprint(method) == ""


def test_a_file_and_what_it_imports_beside_it_count_and_nothing_else(here: Path) -> None:
    write(
        here,
        {
            "own_a.py": "import numpy\nimport own_b\n\n" + METHOD,
            "own_b.py": "def late():\n    from own_package import part\n    return part\n",
            "own_package/__init__.py": "",
            "own_package/part.py": "from . import deep\n",
            "own_package/deep.py": "import own_a\n",
            "not_imported.py": "",
        },
    )
    parts = ["own_a.py", "own_b.py", "own_package/__init__.py", "own_package/deep.py", "own_package/part.py"]
    assert with_imported(here / "own_a.py") == [here / part for part in parts]
    known = {compute_code_fingerprint("own_a:f")}
    (here / "not_imported.py").write_text("changed = 1\n")
    assert compute_code_fingerprint("own_a:f") in known
    for part in parts:
        (here / part).write_text((here / part).read_text() + "# changed\n")
        importlib.reload(sys.modules["own_a"])
        assert compute_code_fingerprint("own_a:f") not in known
        known.add(compute_code_fingerprint("own_a:f"))
    function: Any = importlib.import_module("own_a").f
    assert {compute_code_fingerprint(function), compute_code_fingerprint(functools.partial(function))} <= known


def test_code_that_was_not_loaded_again_is_nobodys(here: Path) -> None:
    write(here, {"own_c.py": METHOD})
    first = compute_code_fingerprint("own_c:f")
    assert compute_code_fingerprint("own_c:f") == first
    write(here, {"own_c.py": METHOD + "# changed\n"})
    # The old code still runs in this process: what it gives must not be taken for that of the new file.
    outdated = {compute_code_fingerprint("own_c:f"), compute_code_fingerprint("own_c:f")}
    importlib.reload(sys.modules["own_c"])
    fresh = compute_code_fingerprint("own_c:f")
    assert len({first, fresh, *outdated}) == 4
    assert compute_code_fingerprint("own_c:f") == fresh


def test_what_is_typed_into_a_session_is_known_by_itself() -> None:
    def typed(text: str) -> Any:
        names: dict[str, Any] = {"__name__": "typed_in"}
        exec(compile(text, "<stdin>", "exec"), names)  # as a session does
        return names["f"]

    first = compute_code_fingerprint(typed("def f(recording):\n    return {1, 'a', 'b'}"))
    assert first
    assert compute_code_fingerprint(typed("\n\ndef f(recording):\n    return {1, 'a', 'b'}")) == first
    assert compute_code_fingerprint(typed("def f(recording):\n    return {1, 'a', 'c'}")) != first


def test_files_that_a_command_names_count(here: Path) -> None:
    write(here, {"program.py": "import beside_it\n", "beside_it.py": "", "config.json": "{}", "unnamed.json": "{}"})
    method = CommandMethod("python program.py --from=config.json {recording} {output}", "mine")
    known = {compute_code_fingerprint(method)}
    (here / "unnamed.json").write_text("[]")
    assert compute_code_fingerprint(method) in known
    for name in ("program.py", "beside_it.py", "config.json"):
        (here / name).write_text((here / name).read_text() + "\n")
        assert compute_code_fingerprint(method) not in known
        known.add(compute_code_fingerprint(method))
        assert compute_code_fingerprint(method) in known, "the same files are the same program"


def test_what_lies_in_a_folder_of_results_counts(here: Path) -> None:
    write(here, {"results/key/depth.npy": "1"})
    method = ResultsFolder(here / "results", "mine")
    before = compute_code_fingerprint(method)
    assert compute_code_fingerprint(method) == before
    write(here, {"results/key/depth.npy": "10"})
    assert compute_code_fingerprint(method) != before


def test_compiled_modules_and_modules_of_other_folders_count(here: Path) -> None:
    write(
        here,
        {
            "own_d.py": "import own_elsewhere\nimport own_fast\n" + METHOD,
            "other/own_elsewhere.py": "from own_folder.part import something\n",
            "other/own_folder/__init__.py": "",
            "other/own_folder/part.py": "something = 1\n",
            "other/not_imported.py": "",
        },
    )
    sys.path.insert(0, str(here / "other"))
    compiled = here / f"own_fast{EXTENSION_SUFFIXES[0]}"
    shutil.copy(str(importlib.import_module("_ctypes").__file__), compiled)
    sys.modules["own_fast"] = types.ModuleType("own_fast")
    sys.modules["own_fast"].__file__ = str(compiled)
    method: Any = importlib.import_module("own_d").f
    known = {compute_code_fingerprint(method)}
    with (here / "other/not_imported.py").open("ab") as opened:
        opened.write(b"\n")
    assert compute_code_fingerprint(method) in known
    for name in (compiled.name, "other/own_elsewhere.py", "other/own_folder/__init__.py", "other/own_folder/part.py"):
        with (here / name).open("ab") as opened:
            opened.write(b"\n")
        # The old code is loaded: no result of this process is reused.
        assert compute_code_fingerprint(method) != compute_code_fingerprint(method)
        importlib.reload(sys.modules["own_d"])
        method = sys.modules["own_d"].f
        assert compute_code_fingerprint(method) not in known
        known.add(compute_code_fingerprint(method))
        assert compute_code_fingerprint(method) in known
