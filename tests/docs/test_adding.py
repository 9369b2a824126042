"""Pages on adding things, followed word by word in a copy: a module, its test and its row are all that it takes."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.helpers.nightly import NIGHTLY, nightly
from tests.test_import_rules import MAX_LINES, MAY_IMPORT, imported_packages

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "how_to").glob("add_*.md"))
MOST_LINES = 80
PYTHON = os.environ.get("SCENETRUTH_TEST_PYTHON", sys.executable)
"""The Python that follows the pages: that of an environment with an installed wheel, if it is named."""

_FILE = re.compile(
    r"^(?:Append to )?`((?:src|tests)/[\w/]+\.py)`[^\n]*:\n\n```python\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
_APPENDED = re.compile(r"^Append to `([\w/]+\.py)`, and add `\"(\w+)\"` to its `__all__`:$", re.MULTILINE)
_ROW = re.compile(
    r"^In `(docs/[\w/]+\.md)`, below the line that begins with ``(.+?) ``:\n\n    (\|.*\|)$", re.MULTILINE
)
_COMMAND = re.compile(r"^    ((?:python|scenetruth) .*)$", re.MULTILINE)
# By night only: what makes images, and the tests that look through all of the package or of a room.
_LONG = re.compile(r"scenetruth (run|render)")
_TESTS = {
    "motion": "tests/scene/test_motion.py",
    "estimator": "tests/estimators/test_registry.py",
    "effect": "tests/camera/sensor/test_chain.py",
    "exporter": "tests/exporters/test_export_writer.py",
}
_RULES = "tests/test_import_rules.py tests/test_style.py"


@dataclass(frozen=True)
class Page:
    """What a page tells to write and to run."""

    files: dict[str, str]
    appended: dict[str, str]
    rows: list[tuple[str, str, str]]
    commands: list[str]


def read(page: Path) -> Page:
    text = page.read_text(encoding="utf-8")
    found = Page(dict(_FILE.findall(text)), dict(_APPENDED.findall(text)), _ROW.findall(text), _COMMAND.findall(text))
    # Every block of the page is one of these.
    assert text.count("```python\n") == len(found.files)
    assert len(re.findall(r"^    (?! )\S", _without_code(text), re.MULTILINE)) == len(found.rows) + len(found.commands)
    return found


def _without_code(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def checkout(folder: Path) -> Path:
    """Make a copy of the repository, of links to its files: compiled code and all."""
    for name in ("tests", "docs", "examples", "scenes"):
        shutil.copytree(ROOT / name, folder / name, copy_function=os.symlink)
    # A wheel has the scenes inside, a checkout beside.
    only_in_wheels = shutil.ignore_patterns("shipped")
    shutil.copytree(package(), folder / "src" / "scenetruth", copy_function=os.symlink, ignore=only_in_wheels)
    (folder / "pyproject.toml").symlink_to(ROOT / "pyproject.toml")
    (folder / "bin").mkdir()
    for name, command in (("python", ""), ("scenetruth", "-m scenetruth")):
        script = folder / "bin" / name
        script.write_text(f'#!/bin/sh\nexec "{PYTHON}" {command} "$@"\n')
        script.chmod(0o755)
    return folder


def package() -> Path:
    """Return the folder of the package: in the repository, or where another Python has it."""
    if sys.executable == PYTHON:
        return ROOT / "src" / "scenetruth"
    words = [PYTHON, "-P", "-c", "import scenetruth; print(scenetruth.__path__[0])"]
    found = Path(subprocess.run(words, cwd="/", capture_output=True, text=True, check=True).stdout.strip())
    assert not found.is_relative_to(ROOT), f"{PYTHON} has no wheel, but the repository"
    return found


def run(command: str, folder: Path) -> None:
    # What is tried is one page, not thousands of examples of its test.
    env = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "HYPOTHESIS_"))}
    env |= {"PATH": f"{folder / 'bin'}{os.pathsep}{env['PATH']}", "PYTHONPATH": str(folder / "src")}
    words = ["bash", "-o", "pipefail", "-c", command]
    done = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"


def below(text: str, anchor: str, row: str) -> str:
    """Put a row below the one line that begins with an anchor."""
    lines = text.splitlines(keepends=True)
    (number,) = (number for number, line in enumerate(lines) if line.startswith(f"{anchor} "))
    assert row.count(" | ") == lines[number].count(" | ")
    return "".join([*lines[: number + 1], row + "\n", *lines[number + 1 :]])


def exported(text: str, name: str) -> str:
    """Add a name to ``__all__``, in its place."""
    (before,) = re.findall(r"^__all__ = (\[.*?\])", text, re.MULTILINE | re.DOTALL)
    names = sorted([*ast.literal_eval(before), name])
    listed = "".join(f'    "{each}",\n' for each in names)
    return re.sub(r"^__all__ = \[.*?\]", f"__all__ = [\n{listed}]", text, count=1, flags=re.MULTILINE | re.DOTALL)


def keeps_the_rules(module: Path, package: Path) -> None:
    """Hold a module against the rules of packages."""
    name = module.relative_to(package).parts[0]
    assert imported_packages(module) - {name} <= MAY_IMPORT[name]
    assert len(module.read_text(encoding="utf-8").splitlines()) <= MAX_LINES, f"{module.name} is full"


def test_there_is_a_page_for_each_of_the_usual_things() -> None:
    names = {page.stem.removeprefix("add_") for page in PAGES}
    assert names == {"motion", "estimator", "effect", "exporter"}
    for page in PAGES:
        assert len(page.read_text(encoding="utf-8").splitlines()) <= MOST_LINES, page.name


@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=() if page.stem == "add_effect" else nightly) for page in PAGES]
)
def test_what_a_page_tells_is_all_that_is_needed(page: Path, tmp_path: Path) -> None:
    told, folder = read(page), checkout(tmp_path / "copy")
    # One place, one test, one row: nothing else changes.
    assert [name.split("/")[0] for name in told.files] == ["src", "tests"]
    assert len(told.rows) == 1
    assert len(told.commands) > 2
    for name, text in told.files.items():
        file = folder / name
        assert file.parent.is_dir(), f"{name}: no such folder"
        assert file.exists() == (name in told.appended), f"{name} is there already, or is not: mend the page"
        if name in told.appended:
            text = f"{exported(file.read_text(encoding='utf-8'), told.appended[name])}\n\n{text}"
            file.unlink()  # it may be a link to the file of the checkout
        file.write_text(text, encoding="utf-8")
    for name, anchor, row in told.rows:
        file = folder / name
        text = file.read_text(encoding="utf-8")
        file.unlink()
        file.write_text(below(text, anchor, row), encoding="utf-8")
    for command in told.commands:
        if NIGHTLY or not _LONG.match(command):
            run(command, folder)
    if NIGHTLY:
        run(f"python -m pytest -q -p no:cacheprovider {_RULES} {_TESTS[page.stem.removeprefix('add_')]}", folder)
    keeps_the_rules(folder / next(iter(told.files)), folder / "src" / "scenetruth")
    written = " ".join(told.files)
    run(
        f"python -m ruff check -q --no-cache {written} && python -m ruff format -q --no-cache --check {written}", folder
    )
