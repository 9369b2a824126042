"""A second process draws the same pictures."""

from __future__ import annotations

import os
import shutil
import signal
import time
from pathlib import Path

from scenetruth.pipeline import PipelineRunner, RunDirectory, open_figure_worker
from tests.helpers.nightly import nightly


@nightly
def test_pictures_are_the_same_with_and_without_help(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    with open_figure_worker(1) as helper, PipelineRunner(RunDirectory(run), overwrite=True, helper=helper) as runner:
        assert helper is not None
        drawn: list[str] = []
        original = helper.draw

        def draw(name: str, *arguments: object) -> object:
            drawn.append(name)
            return original(name, *arguments)  # type: ignore[arg-type]

        helper.draw = draw  # type: ignore[method-assign,assignment]
        runner.report("structure_tensor")
    assert drawn
    assert (run / "report.html").read_bytes() == (finished / "report.html").read_bytes()
    pictures = sorted((finished / "figures").iterdir())
    assert [path.name for path in pictures] == sorted(path.name for path in (run / "figures").iterdir())
    for picture in pictures:
        assert picture.read_bytes() == (run / "figures" / picture.name).read_bytes(), picture.name


@nightly
def test_whatever_becomes_of_the_helper_all_pictures_are_drawn(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    with open_figure_worker(1) as helper, PipelineRunner(RunDirectory(run), overwrite=True, helper=helper) as runner:
        assert helper is not None
        assert helper._process is not None
        os.kill(helper._process.pid, signal.SIGKILL)
        runner.report("structure_tensor", ["image", "depth", "coherence"])
    assert sorted(path.name for path in (run / "figures").iterdir()) == ["coherence.png", "depth.png", "image.png"]


def test_the_helper_ends_with_its_block() -> None:
    with open_figure_worker(1) as helper:
        assert helper is not None
        assert helper._process is not None
        number = helper._process.pid
    deadline = time.monotonic() + 10
    while Path(f"/proc/{number}").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not Path(f"/proc/{number}").exists()
    with open_figure_worker(0) as none:
        assert none is None


def test_a_helper_that_runs_is_used_and_goes_on() -> None:
    with open_figure_worker(1) as first:
        assert first is not None
        with open_figure_worker(first) as again:
            assert again is first
        assert first._process is not None
        assert first._process.poll() is None
