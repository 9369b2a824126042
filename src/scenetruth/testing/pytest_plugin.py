"""The pytest plugin: fixtures, options, and a table of all accuracy assertions."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

# Nothing else of scenetruth is imported before a test requires it: every run of pytest loads this module.
from scenetruth.testing.assertion_context import OutcomeRow, use_context

if TYPE_CHECKING:
    from scenetruth.testing.recording_cache import RecordingCache

__all__ = []

_ROWS = pytest.StashKey[list[OutcomeRow]]()
_FOLDER = "scenetruth"
_ON_REPORT = "scenetruth_accuracy"
"""Attribute of a test report for its outcomes, which pytest-xdist transfers from its workers."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the command-line options."""
    group = parser.getgroup("scenetruth", "accuracy of estimates (scenetruth)")
    group.addoption(
        "--scenetruth-clear",
        action="store_true",
        help="remove the cached recordings of the fixture scenetruth_recording, and simulate them again",
    )
    group.addoption(
        "--scenetruth-report",
        action="store_true",
        help="print a table of all comparisons of assert_accuracy",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Apply the options."""
    if config.getoption("scenetruth_clear", default=False) and not hasattr(config, "workerinput"):
        folder = _cache_folder(config)
        if folder is not None:
            from scenetruth.testing.recording_cache import remove_entries

            remove_entries(folder)
    if config.getoption("scenetruth_report", default=False):
        config.stash[_ROWS] = []
        config.pluginmanager.register(_Report(config), "scenetruth-report")


@pytest.fixture(scope="session")
def scenetruth_recording(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> RecordingCache:
    """Simulate recordings of scenes with their truth: ``scenetruth_recording("cube", "camera.width=160").truth``.

    They stay in pytest's cache until the scene or scenetruth changes; ``--scenetruth-clear`` removes them.
    """
    from scenetruth.testing.recording_cache import RecordingCache

    return RecordingCache(_cache_folder(pytestconfig) or tmp_path_factory.mktemp(_FOLDER), pytestconfig.rootpath)


@pytest.fixture
def scenetruth_pictures(tmp_path: Path) -> Path:
    """Return the directory for figures of the violated limits of this test."""
    folder = tmp_path / "pictures"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Provide the context for assertions, and record their outcomes."""
    rows: list[OutcomeRow] = []
    # A test may be repeated.
    item.stash[_ROWS] = rows
    with use_context(pictures=lambda: _figure_folder(item), note=rows.extend):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Attach the outcomes to the report of the test."""
    report = yield
    rows = item.stash.get(_ROWS, [])
    if call.when == "call" and rows:
        setattr(report, _ON_REPORT, rows)
    return report


class _Report:
    """Collects outcomes and prints them at the end."""

    def __init__(self, config: pytest.Config) -> None:
        self._rows = config.stash[_ROWS]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        rows: list[OutcomeRow] = getattr(report, _ON_REPORT, [])
        self._rows += [{"test": report.nodeid, **row} for row in rows]

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        from scenetruth.testing.assertion_context import align_columns, format_multiple

        terminalreporter.section("accuracy of estimates")
        if not self._rows:
            terminalreporter.write_line("assert_accuracy was not called")
            return
        heads = ("test", "region", "quantity", "statistic", "found", "limit", "times", "")
        cells = [
            (
                *(str(row[name]) for name in heads[:-2]),
                format_multiple(row["times"]),
                "" if row["kept"] else "BROKEN",
            )
            for row in self._rows
        ]
        for line in align_columns([heads, *cells]):
            terminalreporter.write_line(line)


def _cache_folder(config: pytest.Config) -> Path | None:
    """Return the directory of the cached recordings; None without a writable cache."""
    cache = getattr(config, "cache", None)
    if cache is None:
        return None
    try:
        return Path(cache.mkdir(_FOLDER))
    except OSError:
        return None


def _figure_folder(item: pytest.Item) -> Path:
    request = getattr(item, "_request", None)
    if request is None:
        # Test items of other plug-ins have no fixtures.
        import tempfile

        return Path(tempfile.mkdtemp(prefix="scenetruth-pictures-"))
    folder: Path = request.getfixturevalue("scenetruth_pictures")
    return folder
