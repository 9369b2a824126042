"""Methods side by side on the command line, parts of different runs, images without a truth, and exports."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

import scenetruth as st
from tests.helpers.command_line import names, scenetruth
from tests.helpers.nightly import NIGHTLY, nightly
from tests.helpers.page_words import without_definitions
from tests.helpers.scenes import cube
from tests.helpers.undrawn_figures import leave_undrawn

pytestmark = pytest.mark.usefixtures("undrawn_figures")

# All that there are for a method which finds nothing but flow, without error bars.
PICTURES = {"image.png", "flow.png", "error_histograms.png", "coherence.png"}
SMALL = {"camera": {"width": 96, "height": 72, "focal_length_px": 750}, "frames": {"count": 5}}


def write_scene(file: Path, **changes: object) -> Path:
    file.write_text(yaml.safe_dump(cube(**SMALL, **changes).to_dict()))
    return file


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("runs")
    scene = write_scene(place / "scene.yaml")
    both = ("--method", "structure_tensor", "--method", "opencv_flow", "--figure", "image", "--figure", "flow")
    with pytest.MonkeyPatch.context() as monkeypatch:
        leave_undrawn(monkeypatch)
        done = scenetruth("run", scene, "-o", place / "x", *both)
    assert done.returncode == 0, done.stderr
    assert "structure_tensor, region interior" in done.stdout
    assert "opencv_flow, region interior" in done.stdout
    return place / "x"


@nightly
def test_run_puts_methods_side_by_side(folder: Path) -> None:
    for name in ("estimate.zarr", "estimate.opencv_flow.zarr", "score.opencv_flow.json", "report.opencv_flow.html"):
        assert (folder / name).exists()


@nightly
def test_one_other_method_is_the_scenes_own_from_then_on(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene.yaml")
    overrides = ("--setting", "flow_window_px=15")
    done = scenetruth("run", scene, "-o", tmp_path / "x", "--method", "opencv_flow", *overrides)
    assert done.returncode == 0, done.stderr
    assert "estimate.zarr" in names(tmp_path / "x")
    assert names(tmp_path / "x" / "figures") == PICTURES
    again = st.load_scene(tmp_path / "x" / "scene.yaml")
    assert again.estimate.method == "opencv_flow"
    estimate = st.load_store(tmp_path / "x" / "estimate.zarr", kind="estimate")
    assert json.loads(estimate.attrs["settings"])["flow_window_px"] == 15


def test_score_and_report_take_every_estimate(folder: Path) -> None:
    done = scenetruth("score", folder, "--overwrite")
    assert done.returncode == 0, done.stderr
    assert "score.json" in done.stdout
    assert "score.opencv_flow.json" in done.stdout
    # By night with a second process, as users have it; by day `tests.cli.test_app` starts one. Without a choice, all
    # pictures that this method allows are drawn.
    done = scenetruth("report", folder, "--overwrite", "--method", "opencv_flow", helped=NIGHTLY)
    assert done.returncode == 0, done.stderr
    assert "report.opencv_flow.html" in done.stdout
    assert names(folder / "figures.opencv_flow") == PICTURES


def test_parts_of_different_runs_are_refused_unless_allowed(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    scene = write_scene(tmp_path / "scene.yaml", seed=99)
    assert scenetruth("render", scene, "-o", other).returncode == 0
    st.save_store(st.load_store(folder / "estimate.zarr"), other / "estimate.zarr")
    done = scenetruth("score", other)
    assert done.returncode == 2
    assert "estimate.zarr: belongs to another recording than" in done.stderr
    assert str(other / "recording.zarr") in done.stderr
    assert "--allow-mismatch" in done.stderr
    assert scenetruth("score", other, "--allow-mismatch").returncode == 0


def test_real_images_are_estimated_and_reported(tmp_path: Path) -> None:
    images = np.random.default_rng(0).integers(0, 255, (3, 3, 48, 64), dtype=np.uint8)
    st.save_store(st.make_recording(images, 700.0, 5.0), tmp_path / "recording.zarr")
    for command in (("estimate", "--setting", "working_point_px=0"), ("report", "--figure", "image")):
        done = scenetruth(command[0], tmp_path, *command[1:])
        assert done.returncode == 0, done.stderr
    assert "no ground truth" in without_definitions((tmp_path / "report.html").read_text()).lower()
    done = scenetruth("score", tmp_path)
    assert done.returncode == 2
    assert "truth.zarr: no such store" in done.stderr


def test_methods_are_listed() -> None:
    done = scenetruth("list", "methods")
    assert done.returncode == 0, done.stderr
    for name in ("structure_tensor", "opencv_stereo", "opencv_flow", "opencv_scene_flow"):
        assert name in done.stdout
    assert "cannot be used" not in done.stdout


def test_methods_whose_package_is_missing_are_marked_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    done = scenetruth("list", "methods")
    assert done.returncode == 0, done.stderr
    # The column of what they need, whose lines are folded.
    told = " ".join(" ".join(line.split("│")[3] for line in done.stdout.splitlines() if line.count("│") == 5).split())
    assert told.count("cannot be used: requires OpenCV") == 3
    assert told.count("pip install") == 3
    assert told.count("scenetruth[opencv]") == 3


def test_a_method_that_cannot_is_named_before_the_work(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene.yaml")
    wrong = scenetruth("run", scene, "-o", tmp_path / "x", "--method", "opencv_flw")
    assert wrong.returncode == 2
    assert "did you mean 'opencv_flow'?" in wrong.stderr
    single = scenetruth("run", scene, "-o", tmp_path / "x", "--method", "opencv_flow", "--set", "frames.count=1")
    assert single.returncode == 2
    assert "frames.count: 'opencv_flow' needs 2 frames (got 1)" in single.stderr
    assert not (tmp_path / "x").exists()


@nightly
def test_a_method_that_never_returns_can_be_interrupted(tmp_path: Path) -> None:
    # That a second process which draws is ended as well is tried by `tests.cli.test_app`.
    scene = write_scene(tmp_path / "scene.yaml")
    code = "import time\ndef wait(recording):\n    print('begun', flush=True)\n    time.sleep(600)\n"
    (tmp_path / "forever.py").write_text(code)
    command = [
        sys.executable,
        "-m",
        "scenetruth",
        "run",
        str(scene),
        "-o",
        str(tmp_path / "x"),
        "--method",
        "forever:wait",
        "--no-report",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "method 'forever:wait' was interrupted" in errors
    assert "Traceback" not in errors
    # The last says what was asked for, so that the same command goes on here.
    assert names(tmp_path / "x") == {"scene.yaml", "recording.zarr", "truth.zarr", ".unfinished"}


def test_code_is_named_by_the_call_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "far.py").write_text(
        "import numpy as np\n"
        "def away(recording, depth_mm: float = 1000.0):\n"
        "    return {'depth': np.full(recording['image'].isel(s=0).shape, depth_mm)}\n"
    )
    monkeypatch.chdir(tmp_path)
    scene = write_scene(tmp_path / "scene.yaml")
    given = ("--method", "far:away", "--setting", "depth_mm=70")
    done = scenetruth("run", scene, "-o", "x", *given, "--no-report")
    assert done.returncode == 0, done.stderr
    assert {"estimate.far-away.zarr", "score.far-away.json"} < names(tmp_path / "x")
    assert (st.load_store(tmp_path / "x" / "estimate.far-away.zarr", kind="estimate")["depth"] == 70).all()
    # What is written is a file as any other: it names none.
    assert st.load_scene(tmp_path / "x" / "scene.yaml").estimate.method == "structure_tensor"
    monkeypatch.setattr("scenetruth.pipeline.runner.read_scene", lambda _: {"estimate": {"method": "far:away"}})
    done = scenetruth("estimate", "x")
    assert done.returncode != 0
    assert "estimate.method: is code, which files must not specify" in done.stderr


@pytest.fixture
def run(tmp_path: Path) -> Path:
    images = np.random.default_rng(1).random((2, 2, 12, 16)).astype(np.float32)
    recording = st.make_recording(images, focal_length_px=50, baseline_mm=2)
    st.save_store(recording, tmp_path / "run" / "recording.zarr")
    estimate = st.make_estimate(depth=np.full((2, 12, 16), 80.0), flow=np.zeros((2, 2, 12, 16)), recording=recording)
    st.save_store(estimate, tmp_path / "run" / "estimate.zarr")
    return tmp_path / "run"


def test_an_estimate_is_exported(run: Path) -> None:
    out = run.parent / "out"
    method = ("--method", "structure_tensor")
    done = scenetruth("export", run, "--format", "flo", "-o", out, *method, "--flow", "instantaneous")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"wrote {out} (3 files)\n"
    assert "note: flow is instantaneous" in done.stderr
    assert names(out) == {"export.json", "flow", "images"}
    again = scenetruth("export", run, "--format", "pfm", "-o", out, *method, "--option", "image_bits=16", "--left", "0")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    again = scenetruth("export", run, "--format", "pfm", "-o", out, *method, "--option", "image_bits=16", "--overwrite")
    assert again.returncode == 0, again.stderr
    assert names(out) == {"export.json", "t+0", "t+1"}
    assert json.loads((out / "export.json").read_text())["options"]["image_bits"] == 16


def test_every_input_error_is_listed(run: Path) -> None:
    for missing in ("--format", "--output"):
        given = {"--format": "flo", "--output": str(run.parent / "out")}
        del given[missing]
        done = scenetruth("export", run, *(word for pair in given.items() for word in pair))
        assert done.returncode == 2
        assert missing in done.stderr
    words = ("--option", "left", "--option", "row=1", "--option", "every=[")
    done = scenetruth("export", run, "--format", "flo", "-o", run.parent / "out", *words)
    assert done.returncode == 2
    for problem in ("NAME=VALUE", "row is not an option", "in YAML"):
        assert problem in done.stderr
    done = scenetruth("export", run, "--format", "flo", "-o", run.parent / "out", "--option", "lft=1")
    assert done.returncode == 2
    assert "lft: is not an option" in done.stderr
    done = scenetruth("export", run, "--format", "png", "-o", run.parent / "out")
    assert "select an estimate with --method" in done.stderr


def test_formats_are_listed() -> None:
    done = scenetruth("list", "formats")
    assert done.returncode == 0
    for name in st.export_formats():
        assert name in done.stdout
    assert "flow=finite" in done.stdout


OWN = "structure_tensor"
"""The method whose files have plain names, in a run without a scene."""


def test_strain_of_an_estimate_has_its_gauge_and_its_report(run: Path) -> None:
    recording = st.load_store(run / "recording.zarr")
    still = np.zeros((3, 2, 12, 16))
    estimate = st.make_estimate(depth=np.full((2, 12, 16), 80.0), velocity=still, recording=recording)
    st.save_store(estimate, run / "estimate.zarr", overwrite=True)
    out, gauge = run.parent / "strain", ("--window", "3", "--step", "2", "--subset-px", "5", "--method", OWN)
    done = scenetruth("strain", run, "-o", out, *gauge, "--measure", "hencky")
    assert done.returncode == 0, done.stderr
    assert "virtual strain gauge 9 px, 14.4 mm" in done.stdout
    assert names(out) == {"good_practice.csv", "good_practice.json", "strain.zarr"}
    assert st.load_store(out / "strain.zarr").attrs["measure"] == "hencky"
    again = scenetruth("strain", run, "-o", out, *gauge)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    again = scenetruth("strain", run, "-o", out, *gauge, "--overwrite", "--json")
    assert json.loads(again.stdout)["score"] is None
    wide = scenetruth("strain", run, "-o", run.parent / "wide", "--window", "201", "--method", OWN)
    assert wide.returncode == 0
    assert "warning: no strain: " in wide.stderr
    assert "window of 201 points every 4 pixels, 801 pixels wide; reduce" in " ".join(wide.stderr.split())
    wrong = scenetruth("strain", run, "-o", run.parent / "x", "--window", "4", "--order", "3")
    assert wrong.returncode == 2
    for problem in ("window: must be an odd number", "order: "):
        assert problem in wrong.stderr
