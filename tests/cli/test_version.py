"""What ``scenetruth --version`` says, and how late it is asked."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from unittest.mock import Mock, patch

import pytest

import scenetruth as st
from tests.cli.calling import scenetruth


@pytest.mark.parametrize(
    ("told", "note"),
    [
        ('{"url": "file:///a", "dir_info": {"editable": true}}', " (of the last pip install -e;"),
        ('{"url": "file:///a", "dir_info": {}}', "\n"),
        ('{"url": "https://example.org/a.whl", "archive_info": {}}', "\n"),
        (None, "\n"),
    ],
)
def test_an_editable_installation_says_that_its_code_may_be_newer(told: str | None, note: str) -> None:
    installation = Mock(read_text=Mock(return_value=told))
    with (
        patch.object(metadata, "distribution", return_value=installation),
        patch.object(metadata, "version", return_value="0.2.0.dev7+g1a2b3c4"),
    ):
        done = scenetruth("--version")
    assert done.returncode == 0
    assert done.stdout.startswith(f"scenetruth 0.2.0.dev7+g1a2b3c4{note}")


def test_source_files_that_nobody_installed_have_no_version() -> None:
    missing = metadata.PackageNotFoundError("scenetruth")
    with (
        patch.object(metadata, "version", side_effect=missing),
        patch.object(metadata, "distribution", side_effect=missing),
    ):
        assert st.__version__ == "0+unknown"
        assert scenetruth("--version").stdout == "scenetruth 0+unknown\n"


def test_the_version_is_asked_for_when_it_is_read() -> None:
    assert "__version__" in dir(st)
    code = (
        "from importlib import metadata\n"
        "def refuse(name):\n"
        "    raise AssertionError(name)\n"
        "metadata.version = refuse\n"
        "import scenetruth, scenetruth.cli.app"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
