"""Code that methods call is found by what sources and scripts name; data and by-products are not code."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from scenetruth.estimators.code_dependencies import is_cached, is_code, is_system, with_called_code

ELF = b"\x7fELF then anything"


def write(folder: Path, files: dict[str, str | bytes]) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def called(folder: Path, first: str) -> set[str]:
    found = with_called_code([folder / first], folder)
    return {str(file.relative_to(folder)) for file in found} - {first}


def test_code_that_sources_and_scripts_name_is_found_and_nothing_else(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {
        "mine.py": "import other\nKEPT = ['weights.bin', 'log.csv', 'kernel.nbi', 'lib/fast.so']\nrun('sh tool.sh -x')",
        "other.py": "SOURCE = 'kernel.cu'",
        "kernel.cu": "",
        "tool.sh": 'HERE=$(dirname "$0")\n"$HERE"/bin/match "$1" && exec ${HERE}/refine $(dirname $0)/last; cat notes',
        "bin/match": ELF,
        "refine": "#!/usr/bin/env python3\n",
        "last": ELF,
        "lib/fast.so": b"any",
        "weights.bin": b"\0data",
        "log.csv": "1",
        "kernel.nbi": ELF,
        "notes": "unnamed",
        "unnamed": ELF,
    }
    write(tmp_path, files)
    found = {"other.py", "kernel.cu", "tool.sh", "bin/match", "refine", "last", "lib/fast.so"}
    assert called(tmp_path, "mine.py") == found
    # A file that is missing at first is found when it is there, though the text that names it is the same.
    (tmp_path / "last").unlink()
    assert called(tmp_path, "mine.py") == found - {"last"}
    write(tmp_path, {"last": ELF})
    assert called(tmp_path, "mine.py") == found


def test_a_program_on_the_search_path_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, {"wrap.sh": "exec own_matcher $1 | cat\n", "bin/own_matcher": ELF})
    assert called(tmp_path, "wrap.sh") == set()
    (tmp_path / "bin" / "own_matcher").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"), prepend=":")
    assert called(tmp_path, "wrap.sh") == {"bin/own_matcher"}


def test_loops_and_files_that_cannot_be_read_end_the_search(tmp_path: Path) -> None:
    write(tmp_path, {"a.sh": "sh b.sh; ./folder; sh wrong.py", "b.sh": "sh a.sh", "wrong.py": "(", "folder/c.sh": ""})
    assert called(tmp_path, "a.sh") == {"b.sh", "wrong.py"}
    assert called(tmp_path, "missing.sh") == set()


def test_kinds_of_files(tmp_path: Path) -> None:
    write(tmp_path, {"a": ELF, "b": "#!/bin/sh", "c": "text", "d.so.1": "", "e.dll": "", "f.py": "", "g.txt": "MZ"})
    assert [name for name in ["a", "b", "c", "d.so.1", "e.dll", "f.py", "g.txt"] if is_code(tmp_path / name)] == [
        *("a", "b", "d.so.1", "e.dll", "f.py", "g.txt")
    ]
    cached = ["/a/__pycache__/b.so", "/a/.cache/c/d", "/a/NUMBA_CACHE_DIR/f.so", "/a/b.nbc", "/a/b.pyc"]
    assert all(map(is_cached, cached))
    assert not any(map(is_cached, ["/a/cache.so", "/a/b.so"]))
    assert all(map(is_system, ["/usr/lib/a.so", "/lib64/b.so", "/usr/bin/python3", f"{sys.prefix}/lib/c.so"]))
    assert not any(map(is_system, ["/usr/local/lib/a.so", "/home/me/lib/b.so", "/library/c.so"]))
