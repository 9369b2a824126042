"""The process in which the long test tries its files, and what it found."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.helpers.guarded_trials import Guarded
from tests.helpers.store_trial import STORE_OUTCOMES

_told: list[str] = []


@pytest.fixture(scope="session")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A process with bounds that tries scene files; what became of all is told at the end."""
    yield from _told_of(Guarded(tmp_path_factory.mktemp("scenes")))


@pytest.fixture(scope="session")
def guarded_stores(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """The same for stores."""
    yield from _told_of(Guarded(tmp_path_factory.mktemp("stores"), "stores", STORE_OUTCOMES))


def _told_of(trials: Guarded) -> Iterator[Guarded]:
    yield trials
    trials.close()
    _told.append(f"{trials}; files that failed, if any: {trials.folder}/failed-*")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what became of the files."""
    for line in _told:
        terminalreporter.write_line(line)
