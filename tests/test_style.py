"""Rules of style that no linter of ours knows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tests.helpers.source_facts import crowded_in

SOURCE = Path(__file__).parents[1] / "src" / "scenetruth"

MOST_PARAMETERS = 12
"""Parameters that may be given by position: more of them than this nobody can tell apart at a call."""


def crowded_functions(folder: Path) -> Iterator[str]:
    """Name the functions with more parameters than may be."""
    for file in sorted(folder.rglob("*.py")):
        for line, name, count in crowded_in(file, MOST_PARAMETERS):
            yield f"{file.relative_to(folder)}:{line} {name} takes {count}"


def test_no_function_takes_a_row_of_arguments() -> None:
    assert list(crowded_functions(SOURCE)) == []


def test_the_rule_sees_long_rows_and_lets_keywords_be(tmp_path: Path) -> None:
    names = [f"a{n}" for n in range(MOST_PARAMETERS + 1)]
    (tmp_path / "module.py").write_text(
        f"def long({', '.join(names)}): pass\n"
        f"def short({', '.join(names[:-1])}): pass\n"
        f"def named(*, {', '.join(names)}): pass\n"
        f"class Kind:\n    def method(self, {', '.join(names[:-1])}): pass\n"
        f"anonymous = lambda {', '.join(names)}: 0\n"
    )
    found = [line.split(" ", 1)[1] for line in crowded_functions(tmp_path)]
    assert sorted(found) == [f"{name} takes {MOST_PARAMETERS + 1}" for name in ("lambda", "long", "method")]


def repeated_exports(folder: Path) -> list[str]:
    """Name the modules that list their exports more than once: only the last list counts."""
    return [str(file) for file in sorted(folder.rglob("*.py")) if file.read_text().count("\n__all__ = ") > 1]


def test_modules_list_their_exports_in_one_place(tmp_path: Path) -> None:
    assert repeated_exports(SOURCE) == []
    (tmp_path / "module.py").write_text('\n__all__ = ["a"]\na = 1\n__all__ = ["b"]\n')
    assert repeated_exports(tmp_path) == [str(tmp_path / "module.py")]
