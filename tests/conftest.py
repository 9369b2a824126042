"""What all tests share."""

from __future__ import annotations

import atexit
import gc
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Generator, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import settings

from tests.helpers.undrawn_figures import undrawn_figures

__all__ = ["undrawn_figures"]

# Tests make every texture anew, once for all of their processes, and leave nothing outside their folders.
if "SCENETRUTH_TESTS" not in os.environ:
    os.environ["SCENETRUTH_TESTS"] = os.environ["SCENETRUTH_CACHE"] = tempfile.mkdtemp(prefix="scenetruth-tests-")
    atexit.register(shutil.rmtree, os.environ["SCENETRUTH_TESTS"], ignore_errors=True)

# What is printed is looked at as in a pipe, whatever the width of the terminal that the tests are run from.
os.environ.pop("COLUMNS", None)

# Kernels are compiled at their first call, and machines are busy: how long an example takes says nothing. There are
# half as many as usual by day, and many more by night.
settings.register_profile("without_deadlines", deadline=None, max_examples=50)
settings.register_profile("nightly", parent=settings.get_profile("without_deadlines"), max_examples=10_000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "without_deadlines"))


@pytest.fixture
def messages() -> Iterator[list[str]]:
    """What the package logs while a test runs."""
    found: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found.append(record.getMessage())

    logger, collector = logging.getLogger("scenetruth"), Collector()
    before = logger.level
    logger.addHandler(collector)
    logger.setLevel(logging.INFO)
    yield found
    logger.setLevel(before)
    logger.removeHandler(collector)


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Return the name of an argument for bytes: files may contain the second of their creation, and all processes that
    run tests must give them the same names."""
    return argname if isinstance(val, bytes) else None


class _ExamplesOnly:
    """Collects doctests of the files that contain examples: to search the others takes time and finds nothing."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(self, file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
        collectors = yield
        if b">>> " in file_path.read_bytes():
            return collectors
        return [collector for collector in collectors if not isinstance(collector, DoctestModule)]


def pytest_configure(config: pytest.Config) -> None:
    # A hook of this module itself applies to files below its folder only.
    config.pluginmanager.register(_ExamplesOnly())


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let each of the processes that run all tests import some of their files before it imports the rest.

    For its assertions a file is compiled anew where nobody has done so: each by one process, and not all by all.
    """
    # Nothing that is imported and collected is garbage.
    gc.disable()
    config, number = session.config, os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count > 1 and not sys.dont_write_bytecode and config.args == config.getini("testpaths"):
        for file in sorted(Path(__file__).parent.rglob("test_*.py"))[int(number) :: count]:
            # What cannot be imported is reported, or skipped, by the collection.
            with suppress(Exception, pytest.skip.Exception):
                import_module(".".join(file.relative_to(config.rootpath).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what importing has made, and look seldom: it takes a twelfth of the time."""
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 100)
