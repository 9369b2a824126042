"""The process in which the long test tries its files, and what it found."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz.guarded import Guarded


@pytest.fixture(scope="session")
def guarded(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[Guarded]:
    """A process with bounds; what became of all files is told at the end."""
    folder: Path = tmp_path_factory.mktemp("scenes")
    trials = Guarded(folder)
    yield trials
    trials.close()
    reporter = request.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None:
        reporter.write_line(f"\n{trials}\nfiles that failed, if any: {folder}/failed-*.yaml")
