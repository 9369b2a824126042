"""The amount of messages: --quiet, --verbose, and help by -h."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.calling import scenetruth

SMALL = ("plaid", "--set", "frames.count=1", "--set", "stage.positions=3")


def test_quiet_prints_results_only(tmp_path: Path) -> None:
    done = scenetruth("render", *SMALL, "-o", tmp_path / "a", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    done = scenetruth("render", *SMALL, "-o", tmp_path / "b")
    assert done.stdout.startswith(f"wrote {tmp_path / 'b'}")
    assert "rendered with" in done.stderr
    assert "run time" not in done.stderr


def test_verbose_prints_run_times(tmp_path: Path) -> None:
    done = scenetruth("render", *SMALL, "-o", tmp_path / "a", "-v")
    assert done.returncode == 0, done.stderr
    assert "run time: " in done.stderr


def test_quiet_and_verbose_exclude_each_other() -> None:
    done = scenetruth("list", "scenes", "-q", "-v")
    assert done.returncode == 2
    assert "exclude each other" in " ".join(done.stderr.split())


@pytest.mark.parametrize("words", [("-h",), ("run", "-h"), ("dataset", "-h"), ("dataset", "run", "-h")])
def test_short_option_of_help(words: tuple[str, ...]) -> None:
    done = scenetruth(*words)
    assert done.returncode == 0
    assert "Usage:" in done.stdout


def test_check_as_json() -> None:
    done = scenetruth("check", "plaid", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["valid"]
    assert content["images"] == 45
    assert {"render", "estimate"} <= set(content["stages"])


def test_the_seed_of_a_scene(tmp_path: Path) -> None:
    assert scenetruth("render", *SMALL, "-o", tmp_path / "a", "--seed", "7").returncode == 0
    assert "seed: 7" in (tmp_path / "a" / "scene.yaml").read_text()
