"""Comparisons: resumable, the same by any number of processes, and clear about what cannot be."""

from __future__ import annotations

import ctypes
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.benchmark import compare
from scenetruth.benchmark.cases import BenchmarkRecord
from scenetruth.benchmark.suite import write_recordings
from scenetruth.errors import ArgumentError, EstimateError, OutputExistsError
from scenetruth.estimators import Needs, find_method
from scenetruth.estimators.external import ResultsFolder
from scenetruth.estimators.method_specs import MethodSpec, parse_method, parse_methods
from tests.helpers.command_line import scenetruth
from tests.helpers.nightly import nightly
from tests.helpers.page_words import without_definitions

QUICK: dict[str, Any] = {"cases": ["phase_of_flow"], "levels": [0.0]}


def nearest(recording: xr.Dataset, depth_mm: float = 720.0) -> dict[str, Any]:
    """Know the depth of all walls, and nothing of their motion."""
    return {
        "depth": np.full(recording["image"].isel(s=0).shape, depth_mm),
        "flow": np.zeros((2, *recording["image"].isel(s=0).shape)),
    }


def failing(recording: xr.Dataset) -> dict[str, Any]:
    msg = "no idea"
    raise ZeroDivisionError(msg)


def meddling(recording: xr.Dataset) -> dict[str, Any]:
    ctypes.memset(recording["image"].values.ctypes.data, 0, recording["image"].nbytes)
    return nearest(recording)


def test_a_method_that_writes_to_its_images_is_named_and_harms_no_other() -> None:
    together = compare([meddling, "structure_tensor"], **QUICK)
    assert len(together.failures) == 1
    assert "meddling" in together.failures[0]
    assert "modifies the recording" in together.failures[0]
    alone = compare("structure_tensor", **QUICK)
    rows = [[astuple(row) for row in found.rows if row.quantity] for found in (together, alone)]
    assert rows[0] == rows[1] != []


def test_figures_are_kept_and_not_measured_again(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    found = compare([nearest, failing], output=tmp_path / "c", **QUICK, progress=lambda *one: told.append(one))
    assert told[-1][1:] == (1, 1)
    assert found.value("flow_x", "rmse", case="phase_of_flow", method="nearest").value == 0
    assert len(found.failures) == 1
    assert "phase_of_flow at 0: failing" in found.failures[0]
    assert "no idea" in found.failures[0]
    (kept,) = (tmp_path / "c" / "points" / "phase_of_flow").glob("*.json")
    before = kept.stat().st_mtime_ns
    again = compare([nearest, failing], output=tmp_path / "c", **QUICK)
    assert kept.stat().st_mtime_ns > before, "what failed is tried again"
    first, second = ([astuple(row) for row in each.rows if row.quantity] for each in (found, again))
    assert first == second
    # A file that was not written to its end, or of another version, is made again.
    plain = json.loads(kept.read_text())
    kept.write_text(json.dumps({**plain, "key": "of another"}))
    compare([nearest, failing], output=tmp_path / "c", **QUICK)
    assert json.loads(kept.read_text())["key"] == plain["key"]
    assert {path.name for path in (tmp_path / "c").iterdir()} >= {"results.csv", "summary.csv"}
    frame = found.to_dataframe()
    fields = list(BenchmarkRecord.__dataclass_fields__)
    assert list(frame.columns) == [*fields[:2], "label", *fields[2:]]
    assert set(frame["label"]) == {"0"}
    assert len(frame) == len(found.rows)


def test_what_has_succeeded_is_only_measured_again_on_request_and_its_number_is_told(
    tmp_path: Path, messages: list[str]
) -> None:
    found = compare(nearest, output=tmp_path / "c", **QUICK)
    (kept,) = (tmp_path / "c" / "points" / "phase_of_flow").glob("*.json")
    before = kept.stat().st_mtime_ns
    again = compare(nearest, output=tmp_path / "c", **QUICK)
    assert kept.stat().st_mtime_ns == before
    assert [*map(astuple, again.rows)] == [*map(astuple, found.rows)]
    assert messages[0] == "reused: 1 of 1 scenes; 0 remaining"
    assert "--fresh" in messages[1]
    assert len(messages) == 2
    compare(nearest, output=tmp_path / "c", **QUICK, fresh=True)
    assert kept.stat().st_mtime_ns > before


def test_what_an_installed_method_refuses_is_not_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(find_method("plane_sweep")), "needs", Needs(cameras=99))
    found = compare("plane_sweep", output=tmp_path / "c", **QUICK)
    (kept,) = (tmp_path / "c" / "points" / "phase_of_flow").glob("*.json")
    before = kept.stat().st_mtime_ns
    again = compare("plane_sweep", output=tmp_path / "c", **QUICK)
    assert found.failures
    assert again.failures == found.failures
    assert kept.stat().st_mtime_ns == before


MINE = """import numpy as np
from beside import number


def f(recording):
    return {"depth": np.full(recording["image"].shape[-2:], number())}
"""


@nightly
def test_a_method_that_is_mended_is_measured_again(tmp_path: Path) -> None:
    beside = tmp_path / "beside.py"
    (tmp_path / "mine.py").write_text(MINE)
    words = ["compare", "mine:f", "--case", "disparity", "--level", "1.3", "--workers", "1", "-o", "c"]

    def bias() -> tuple[subprocess.CompletedProcess[str], list[float]]:
        called = [sys.executable, "-m", "scenetruth", *words]
        done = subprocess.run(called, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
        frame = pd.read_csv(tmp_path / "c" / "results.csv")
        frame = frame[(frame.quantity == "depth") & (frame.statistic == "bias")]
        return done, [round(one, 1) for one in frame.value]

    beside.write_text("def number():\n    return {}['nokey']\n")
    done, told = bias()
    assert (done.returncode, told) == (1, [])
    beside.write_text("def number():\n    return 800.0\n")
    done, told = bias()
    assert (done.returncode, told) == (0, [80.0]), done.stderr
    beside.write_text("def number():\n    return 730.0\n")
    done, told = bias()
    assert told == [10.0]
    assert "reused:" not in done.stderr
    (tmp_path / "other.py").write_text("")
    done, told = bias()
    assert told == [10.0]
    assert "reused: 1 of 1 scenes" in done.stderr


def test_values_that_have_names_are_told_by_them(tmp_path: Path) -> None:
    found = compare(nearest, suite="full", output=tmp_path / "c", cases=["gallery"], levels=["plaid"])
    assert not found.failures
    # The pattern is 100 mm away, and moves by 1 mm, 0.1 px, per frame.
    assert found.value("depth", "bias", case="gallery", method="nearest", level="plaid").value == pytest.approx(
        620, rel=1e-6
    )
    assert found.value("flow_x", "bias", case="gallery", method="nearest", level="plaid").value == pytest.approx(
        -0.1, rel=1e-6
    )
    assert (tmp_path / "c" / "points" / "gallery" / "plaid.json").exists()
    table = pd.read_csv(tmp_path / "c" / "results.csv")
    assert set(table["label"]) == {"plaid"}
    assert "growth_rate" not in set(table["quantity"])
    page = (tmp_path / "c" / "index.html").read_text(encoding="utf-8")
    assert "--suite full --case gallery --level VALUE" in page
    with pytest.raises(ArgumentError, match="must be one of cube, "):
        compare(nearest, suite="full", cases=["gallery"], levels=["ball"])


@nightly
def test_processes_find_the_same(tmp_path: Path) -> None:
    options: dict[str, Any] = {"cases": ["phase_of_flow"], "levels": [0.0, 0.25]}
    here = compare("structure_tensor", output=tmp_path / "a", **options)
    there = compare("structure_tensor", output=tmp_path / "b", **options, workers=2)
    assert not here.failures
    figures = [[row for row in one.rows if row.quantity] for one in (here, there)]
    assert figures[0] == figures[1]


def test_what_cannot_be_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(EstimateError) as error:
        compare(parse_methods(["no_such", "refined[window_sigma: 4]", "structure_tensor", "structure_tensor"]))
    assert "no_such" in str(error.value)
    assert "window_sigma_px" in str(error.value)
    assert "twice" in str(error.value)
    with pytest.raises(ArgumentError) as told:
        compare("refined", suite="huge", cases=["noize"], levels=[1])
    assert "huge" in str(told.value)
    assert "noize" in str(told.value)
    with pytest.raises(EstimateError, match="another process"):
        compare(lambda recording: {"depth": 1}, workers=2, **QUICK)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("mine")
    with pytest.raises(OutputExistsError, match="not a directory of a comparison"):
        compare(nearest, output=tmp_path / "mine", **QUICK)
    compare(nearest, output=tmp_path / "c", **QUICK)
    with pytest.raises(OutputExistsError, match="another comparison"):
        compare(["structure_tensor"], output=tmp_path / "c", **QUICK)


def test_methods_are_spelled_with_settings_and_labels() -> None:
    found = parse_methods(["refined[window_sigma_px: 4, motion: rigid]", "fine=structure_tensor[window_sigma_px: 3]"])
    assert [one.label for one in found] == ["refined[motion: rigid, window_sigma_px: 4]", "fine"]
    assert found[0].settings == {"window_sigma_px": 4, "motion": "rigid"}
    assert parse_method(found[1].spelled) == found[1]
    assert MethodSpec("refined", {"motion": "rigid"}, "mine").spelled == "mine=refined[motion: rigid]"


@nightly
def test_the_command(tmp_path: Path) -> None:
    done = scenetruth(
        "compare", "structure_tensor", "-o", tmp_path / "c", "--case", "noise", "--level", "0.005", "--workers", "1"
    )
    assert done.returncode == 0, done.stderr
    assert "Noise floor" in done.stdout
    assert st.BenchmarkResult is not None
    assert scenetruth("compare").returncode == 2
    assert "contrast" in scenetruth("list", "cases").stdout


def leaving(recording: xr.Dataset) -> dict[str, Any]:
    sys.exit(3)


def test_what_failed_is_told_line_by_line_and_where(tmp_path: Path) -> None:
    mine = f"{__name__}:failing", f"{__name__}:leaving"
    words = ["--case", "phase_of_flow", "--level", "0", "--workers", "1", "-o", str(tmp_path / "c")]
    done = scenetruth("compare", *mine, *words)
    assert done.returncode == 1
    first, *rest = [line for line in done.stderr.splitlines() if "method" in line or "no estimate" in line]
    assert first == f"no estimate: phase_of_flow at 0: {mine[0]}: 1 problem with the estimate:"
    assert rest[0].startswith(f"      - method '{mine[0]}': failed: ZeroDivisionError: no idea (")
    assert rest[0].endswith(" in failing)")
    assert "failed: it called sys.exit(3) (" in rest[2]
    page = (tmp_path / "c" / "index.html").read_text(encoding="utf-8")
    assert f'<li style="white-space: pre-wrap">phase_of_flow at 0: {mine[0]}: 1 problem' in page


def in_metres(recording: xr.Dataset) -> dict[str, Any]:
    return {"depth": nearest(recording)["depth"] / 1000}


@nightly
def test_likely_slips_are_told(tmp_path: Path) -> None:
    slipping, right = f"{__name__}:in_metres", f"{__name__}:nearest"
    words = ["--case", "phase_of_flow", "--level", "0", "--level", "0.25", "--workers", "1", "-o", str(tmp_path / "c")]
    for _ in range(2):
        done = scenetruth("compare", slipping, right, *words)
        (told,) = [line for line in done.stderr.splitlines() if "convention error:" in line]
        assert told.startswith(f"possible convention error: {slipping}: depth is in metres: ")
        assert told.endswith(" (at 2 of 2 scenes)")
    page = (tmp_path / "c" / "index.html").read_text(encoding="utf-8")
    assert "<h3>Possible convention errors</h3>" in without_definitions(page)


@nightly
def test_results_made_elsewhere_are_compared_as_if_made_here(tmp_path: Path) -> None:
    (place,) = write_recordings(tmp_path / "recordings", **QUICK, images="npy")
    assert write_recordings(tmp_path / "recordings", **QUICK, images="npy") == [place]
    told = json.loads((place / "camera.json").read_text())
    shape = (len(told["t"]), told["height_px"], told["width_px"])
    made = tmp_path / "made" / place.name
    made.mkdir(parents=True)
    np.save(made / "depth.npy", np.full(shape, 720.0))
    np.save(made / "flow.npy", np.full((2, *shape), 0.01))
    found = compare([ResultsFolder(tmp_path / "made", "elsewhere"), nearest], **QUICK)
    assert not found.failures
    # What was handed in, to float32.
    assert found.value("flow_x", "bias", case="phase_of_flow", method="elsewhere").value == pytest.approx(
        0.01, rel=1e-6
    )
    assert found.value("flow_x", "bias", case="phase_of_flow", method="nearest").value == 0
    (tmp_path / "nothing").mkdir()
    nothing = compare(ResultsFolder(tmp_path / "nothing", "elsewhere"), **QUICK)
    assert place.name in nothing.failures[0]


def test_programs_are_compared_by_the_command(tmp_path: Path) -> None:
    program = tmp_path / "zero.py"
    program.write_text(
        "import json, sys, numpy as np\n"
        "told = json.load(open(sys.argv[1] + '/camera.json'))\n"
        "np.save(sys.argv[2] + '/flow.npy', np.zeros((2, len(told['t']), told['height_px'], told['width_px'])))\n"
    )
    words = f"zero={sys.executable} {program} {{recording}} {{output}}"
    place = ["--case", "phase_of_flow", "--level", "0", "--workers", "1"]
    done = scenetruth("compare", "--command", words, "-o", tmp_path / "c", *place)
    assert done.returncode == 0, done.stderr
    assert "zero" in done.stdout
    refused = scenetruth("compare", "--command", "no label", "-o", tmp_path / "d", *place)
    assert refused.returncode == 2
    assert "LABEL=" in refused.stderr


CASES = ["--case", "phase_of_flow", "--case", "phase_of_disparity", "--case", "slope"]


def command(folder: Path) -> list[str]:
    words = [sys.executable, "-m", "scenetruth", "compare", "structure_tensor", "plane_sweep", "-o", str(folder)]
    return [*words, *CASES, "--workers", "2"]


def figures(folder: Path) -> pd.DataFrame:
    frame = pd.read_csv(folder / "results.csv")
    # Times and memory are those of the run.
    return frame[frame["quantity"].notna()].reset_index(drop=True)


@nightly
def test_a_killed_comparison_goes_on(tmp_path: Path) -> None:
    generator = random.Random(1)
    for _ in range(4):
        run = subprocess.Popen(command(tmp_path / "killed"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(generator.uniform(4.0, 12.0))
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
    for name in ("killed", "calm"):
        subprocess.run(command(tmp_path / name), check=True, capture_output=True)
    pd.testing.assert_frame_equal(figures(tmp_path / "killed"), figures(tmp_path / "calm"))
    points = tmp_path / "killed" / "points"
    assert [path for path in points.rglob("*") if path.suffix not in (".json", ".npz") and path.is_file()] == []


def test_mistakes_do_not_hide_each_other() -> None:
    """Of methods, cases, levels, seeds and workers."""
    with pytest.raises(ArgumentError) as caught:
        compare(["refind", "refined[window: 3]"], cases=["noise", "nois"], seeds=0, suite="fast", workers=0)
    paths = [problem.path for problem in caught.value.problems]
    assert paths[-4:] == ["suite", "cases", "seeds", "workers"]
    assert len(paths) == 6
    with pytest.raises(ArgumentError) as caught:
        compare("refind", cases=["noise"], levels=["high"])
    assert len(caught.value.problems) == 2
