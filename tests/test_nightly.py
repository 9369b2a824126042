"""Tests of the night are run by ``make nightly``."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
MARKS = {"nightly", "by_night", "NIGHTLY", "whole_core"}


def names_in(file: Path) -> set[str]:
    """Return the names that a file uses, without those it imports."""
    text = file.read_text(encoding="utf-8")
    marked = any(mark in text for mark in MARKS)
    return {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)} if marked else set()


def targets() -> list[Path]:
    recipe = re.search(r"^nightly: setup\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert recipe is not None
    return [ROOT / word for word in recipe[1].split() if word.startswith("tests/")]


def test_every_file_with_tests_of_the_night_is_in_the_recipe() -> None:
    run = targets()
    assert [str(target) for target in run if not target.exists()] == []
    files = [file for file in (ROOT / "tests").rglob("test_*.py") if MARKS & names_in(file)]
    assert len(files) > 50
    assert sorted(str(file) for file in files if not {file, *file.parents} & set(run)) == []


def test_no_test_waits_for_a_day_and_a_night_together() -> None:
    never = re.compile(r"^@(nightly\n@by_day|by_day\n@nightly)$", re.MULTILINE)
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    assert [file.name for file in files if never.search(file.read_text(encoding="utf-8"))] == []
    assert never.search("@by_day\n@nightly\ndef test() -> None: ...\n")
