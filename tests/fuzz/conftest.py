"""The process in which the long test tries its files, and what it found."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz.guarded import Guarded

_told: list[str] = []


@pytest.fixture(scope="session")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A process with bounds; what became of all files is told at the end."""
    folder: Path = tmp_path_factory.mktemp("scenes")
    trials = Guarded(folder)
    yield trials
    trials.close()
    _told.append(f"{trials}; files that failed, if any: {folder}/failed-*.yaml")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what became of the files."""
    for line in _told:
        terminalreporter.write_line(line)
