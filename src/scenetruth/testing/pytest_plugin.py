"""The pytest plugin: fixtures, options, and a table of all accuracy assertions."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

# Nothing else of scenetruth is imported before a test asks for it: every run of pytest loads this module.
from scenetruth.testing.assertion_context import OutcomeRow, use_context

if TYPE_CHECKING:
    from scenetruth.testing.recording_cache import RecordingCache

__all__ = []

_ROWS = pytest.StashKey[list[OutcomeRow]]()
_FOLDER = "scenetruth"
_ON_REPORT = "scenetruth_accuracy"
"""Attribute of a test's report that holds its outcomes: it comes along from the workers of pytest-xdist."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer the options."""
    group = parser.getgroup("scenetruth", "accuracy of estimates (scenetruth)")
    group.addoption(
        "--scenetruth-clear",
        action="store_true",
        help="remove the recordings that the fixture scenetruth_recording has kept, and make them again",
    )
    group.addoption(
        "--scenetruth-report",
        action="store_true",
        help="print a table of everything that assert_accuracy has compared",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Do what the options ask for."""
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
    """Make recordings of scenes with their truth: ``scenetruth_recording("cube", "camera.width=160").truth``.

    They are kept in pytest's cache, from run to run, until the scene or scenetruth changes; ``--scenetruth-clear``
    removes them.
    """
    from scenetruth.testing.recording_cache import RecordingCache

    return RecordingCache(_cache_folder(pytestconfig) or tmp_path_factory.mktemp(_FOLDER), pytestconfig.rootpath)


@pytest.fixture
def scenetruth_pictures(tmp_path: Path) -> Path:
    """Return the folder where pictures go of what this test finds too inaccurate."""
    folder = tmp_path / "pictures"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Tell assertions where pictures go, and take down what they find."""
    rows: list[OutcomeRow] = []
    # A test may be run again.
    item.stash[_ROWS] = rows
    with use_context(pictures=lambda: _figure_folder(item), note=rows.extend):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Hand what was found on with the report of the test."""
    report = yield
    rows = item.stash.get(_ROWS, [])
    if call.when == "call" and rows:
        setattr(report, _ON_REPORT, rows)
    return report


class _Report:
    """Gathers outcomes, and prints them in the end."""

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
    """Return the folder of the recordings that are kept; None without a cache, or where it cannot be written."""
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
        # Tests of other plug-ins, which have no fixtures.
        import tempfile

        return Path(tempfile.mkdtemp(prefix="scenetruth-pictures-"))
    folder: Path = request.getfixturevalue("scenetruth_pictures")
    return folder
