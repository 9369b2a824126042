"""The commands as a user runs them, in processes of their own where that matters; and the version."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import Mock, patch

import numpy as np
import pytest
import yaml

import scenetruth as st
from scenetruth.cli.app import app
from tests.helpers.command_line import in_own_process, names, scenetruth
from tests.helpers.nightly import NIGHTLY, by_night, nightly
from tests.helpers.no_gl import python_path_without_gl
from tests.helpers.scenes import SCENES, cube
from tests.helpers.shared_folders import make_once

STORES = {"recording.zarr", "truth.zarr"}
RESULTS = {"scene.yaml", *STORES, "estimate.zarr", "score.json", "score.csv", "report.html", "figures"}


PICTURES = ("--figure", "image", "--figure", "depth")
"""Those that most tests draw."""
FEW = ("--set", "frames.count=2")
"""What suffices where the number of images does not matter."""


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("scene") / "small.yaml"
    sensor, frames = {"bit_depth": 8, "noise_std": 0.01}, {"count": 5}
    plain = cube(sensor=sensor, frames=frames, estimate={"working_point_px": 9}).to_dict()
    file.write_text(yaml.safe_dump(plain))
    return file


@pytest.fixture(scope="module")
def finished(scene_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a finished run, which tests leave as it is."""

    def make(folder: Path) -> None:
        # That all pictures are drawn if none are chosen says `tests.cli.test_commands`.
        words = ("run", scene_file, "-o", folder / "one", "--save-images", "png", "--truth-views", "all", *PICTURES)
        # A process of its own loads all compiled code; the second process that draws is there by day as well.
        done = in_own_process(*words) if NIGHTLY else scenetruth(*words, helped=True)
        assert done.returncode == 0, done.stderr
        assert "Depth" in done.stdout
        assert f"page: {(folder / 'one' / 'report.html').as_uri()}" in done.stdout
        assert "\x1b" not in done.stdout + done.stderr
        assert "rendered with raycast" in done.stderr

    return make_once(tmp_path_factory, "run_by_command", make) / "one"


def test_run_does_everything_in_one_go(finished: Path) -> None:
    assert names(finished) == {*RESULTS, "images"}
    assert len(names(finished / "images")) == 25
    assert names(finished.parent) == {"one"}
    scene = st.load_scene(finished / "scene.yaml")
    assert scene.camera.width == 160


def test_score_files_agree_and_have_the_stated_keys(finished: Path) -> None:
    content = json.loads((finished / "score.json").read_text())
    edges, slopes = ("boundary_0_5", "boundary_10_20"), ("slope_0_20", "slope_70_90")
    assert {"all", "interior", "metadata", *edges, *slopes, "contrast_low", "contrast_high"} <= set(content)
    quantities = {"depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y"}
    for region in ("all", "interior"):
        assert quantities <= set(content[region])
        for quantity in quantities:
            statistics = {
                "bias",
                "rmse",
                "median_abs_error",
                "p95_abs_error",
                "relative_rmse",
                "rms_z",
                "coverage_2_std",
                "density",
                "count",
            }
            assert set(content[region][quantity]) == statistics
    assert {"versions", "scene_hash", "seed", "timings_s"} <= set(content["metadata"])
    with (finished / "score.csv").open() as file:
        assert len(list(csv.reader(file))) > 10


def scores(folder: Path) -> list[object]:
    content = json.loads((folder / "score.json").read_text())
    return [content[region] for region in ("all", "interior")]


@nightly
def test_commands_one_by_one_give_the_same_as_run(finished: Path, scene_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "steps"
    assert scenetruth("render", scene_file, "-o", folder).returncode == 0
    assert names(folder) == {"scene.yaml", *STORES}
    commands = (("estimate",), ("score",), ("report", *PICTURES))
    for command, *few in commands:
        done = scenetruth(command, folder, *few)
        assert done.returncode == 0, done.stderr
    assert names(folder) == RESULTS
    assert names(folder / "figures") == names(finished / "figures") == {"image.png", "depth.png"}
    for name in names(folder / "figures"):
        assert (folder / "figures" / name).read_bytes() == (finished / "figures" / name).read_bytes()
    assert scores(folder) == scores(finished)
    for command, *few in commands:
        again = scenetruth(command, folder, *few)
        # The same estimate has the same score, and the same score the same report.
        assert again.returncode == (0 if command == "report" else 2)
        assert ("is up to date" if command == "report" else "exists already") in again.stderr
        assert scenetruth(command, folder, "--overwrite", *few[:2]).returncode == 0
    assert names(folder) == RESULTS
    for names_of in ({"image.png", "image.pdf"}, {"image.png"}):
        # What was drawn as vectors is ours too, and may be replaced.
        form = "pdf" if "image.pdf" in names_of else "png"
        done = scenetruth("report", folder, "--overwrite", "--figure-format", form, *PICTURES[:2])
        assert done.returncode == 0, done.stderr
        assert names(folder / "figures") == names_of


def test_settings_can_be_changed_after_rendering_but_not_the_scene(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    done = scenetruth("estimate", run, "--overwrite", "--setting", "window_sigma_px=4")
    assert done.returncode == 0, done.stderr
    assert json.loads(st.load_store(run / "estimate.zarr").attrs["settings"])["window_sigma_px"] == 4
    assert "score.json, score.csv, report.html, figures" in done.stderr
    assert "are out of date" in done.stderr
    done = scenetruth("estimate", run, "--overwrite", "--setting", "width")
    assert done.returncode == 2
    assert "--setting: must be NAME=VALUE" in done.stderr
    done = scenetruth("score", run, "--overwrite", "--set", "camera.width=4")
    assert done.returncode == 2
    assert "only fields of 'score' can be changed after rendering" in done.stderr
    done = scenetruth("score", run, "--overwrite", "--set", "score.interior_margin_px=5")
    assert done.returncode == 0, done.stderr
    assert json.loads((run / "score.json").read_text())["metadata"]["margin_px"] == 5
    assert "all regions, RMSE" in done.stdout
    changes = ("--set", "score.growth_window_px=9", "--set", "score.slope_classes_deg=[0, 30, 90]")
    done = scenetruth("score", run, "--overwrite", *changes)
    assert done.returncode == 0, done.stderr
    content = json.loads((run / "score.json").read_text())
    assert content["metadata"]["score_settings"]["growth_window_px"] == 9
    assert {"slope_0_30", "slope_30_90"} == {name for name in content if name.startswith("slope")}
    done = scenetruth("score", run, "--overwrite", "--set", "score.growth_window_px=0")
    assert done.returncode == 2
    assert "score.growth_window_px" in done.stderr


def test_an_existing_output_is_refused_without_overwrite(finished: Path, scene_file: Path) -> None:
    before = names(finished)
    done = scenetruth("run", scene_file, "-o", finished)
    assert done.returncode == 2
    assert "exists already" in done.stderr
    assert names(finished) == before


def test_recordings_from_elsewhere_can_be_estimated(tmp_path: Path) -> None:
    images = np.random.default_rng(0).integers(0, 255, (5, 9, 40, 48), dtype=np.uint8)
    st.save_store(st.make_recording(images, 700.0, 5.0), tmp_path / "recording.zarr")
    done = scenetruth("estimate", tmp_path, "--setting", "working_point_px=0")
    assert done.returncode == 0, done.stderr
    assert st.load_store(tmp_path / "estimate.zarr").attrs["working_point_px"] == 0


def test_truth_of_all_cameras_is_scored_at_the_reference(finished: Path) -> None:
    """That its score is that of the reference alone says `test_commands_one_by_one_give_the_same_as_run`."""
    assert st.load_store(finished / "truth.zarr")["depth"].sizes["s"] == 5


def test_truth_is_taken_from_real_poses_or_from_planned_ones(scene_file: Path, tmp_path: Path) -> None:
    stage = ("--set", "stage.errors.preset=screw_stage", "--set", "stage.time_per_position_s=0.1", *FEW)
    truths = {}
    for poses in ("actual", "nominal"):
        done = scenetruth("render", scene_file, "-o", tmp_path / poses, "--truth-poses", poses, *stage)
        assert done.returncode == 0, done.stderr
        truths[poses] = st.load_store(tmp_path / poses / "truth.zarr", kind="truth")
        assert truths[poses].attrs["truth_poses"] == poses
    difference = truths["actual"]["depth"] - truths["nominal"]["depth"]
    # 5 µm of straightness, 100 µrad on 45° faces at 700 mm.
    assert 1e-4 < float(abs(difference).median()) < 0.5
    assert truths["nominal"]["image_time_s"].equals(truths["actual"]["image_time_s"])


def test_check_tells_what_the_stage_does(scene_file: Path) -> None:
    stage = {
        "positions": "null",
        "baseline_mm": "null",
        "positions_mm": "[-10, -4, 0, 5, 12]",
        "rows": "2",
        "row_spacing_mm": "3",
        "scan": "bidirectional",
        "time_per_position_s": "0.01",
        "errors.preset": "air_bearing",
    }
    settings = [text for name, value in stage.items() for text in ("--set", f"stage.{name}={value}")]
    environment = {**os.environ, "COLUMNS": "300"}
    done = scenetruth("check", scene_file, *settings, env=environment)
    assert done.returncode == 0, done.stderr
    for text in (
        "50 of 160 x 120 px (2 rows, 3 mm apart, of 5 positions at -10, -4, 0, 5, 12 mm; 5 frames)",
        "bidirectional, 0.01 s per position; a frame needs 0.15 s of its 1 s",
        "air_bearing: repeatability 0.1 µm, backlash 0 µm, straightness 0.1 µm, pitch 2.5, yaw 2.5, roll 2.5 µrad",
    ):
        assert text in done.stdout
    plain = scenetruth("check", scene_file, env=environment)
    assert "stage errors" not in plain.stdout
    assert "stage poses" not in plain.stdout
    assert "stage axis" not in plain.stdout
    assert "5 positions, 5 mm apart" in plain.stdout


def test_check_describes_listed_poses(scene_file: Path) -> None:
    visits = "[{x_um: 1}, {}, {}, {}, {}]"
    settings = ["stage.positions=2", "stage.axis_tilt_urad=[300, -1200]"]
    settings.append(f"stage.poses=[{{x_um: 3, yaw_urad: 70, visits: {visits}}}, {{x_um: -4, z_um: 1}}]")
    words = [word for text in settings for word in ("--set", text)]
    done = scenetruth("check", scene_file, *words, env={**os.environ, "COLUMNS": "300"})
    assert done.returncode == 0, done.stderr
    assert "tilted by 300 µrad along Y and -1200 µrad along Z" in done.stdout
    # √(25 / 2) = 3.54, √(1 / 2) = 0.707, 70 / √2 = 49.5.
    rms = "RMS of x 3.54, y 0, z 0.707 µm, pitch 0, yaw 49.5, roll 0 µrad"
    assert f"2 listed, {rms}; visits of 1 listed" in done.stdout


def test_a_grid_is_rendered_and_estimated_row_by_row(scene_file: Path, tmp_path: Path) -> None:
    grid = ("--set", "stage.rows=2", "--set", "stage.row_spacing_mm=3", "--set", "frames.count=1")
    refused = scenetruth("run", scene_file, "-o", tmp_path / "run", *grid)
    assert refused.returncode == 2
    assert "stage.rows: a grid is not supported" in refused.stderr
    done = scenetruth("render", scene_file, "-o", tmp_path / "grid", *grid)
    assert done.returncode == 0, done.stderr
    assert st.load_store(tmp_path / "grid" / "recording.zarr")["image"].shape == (2, 5, 1, 120, 160)
    done = scenetruth("estimate", tmp_path / "grid")
    assert done.returncode == 2
    assert "recording.sel(s_y=0)" in done.stderr


def test_what_shows_nothing_is_found_before_work_starts(scene_file: Path, tmp_path: Path) -> None:
    size = ("--set", "camera.width=20")
    done = scenetruth(
        "run", scene_file, "-o", tmp_path / "x", "--set", "frames.count=1", "--set", "stage.positions=1", *size
    )
    assert done.returncode == 2
    assert "stage.positions: one image determines neither depth nor motion" in done.stderr
    assert "camera.width: is too small" in done.stderr
    assert names(tmp_path) == set()


def test_missing_pieces_are_named(tmp_path: Path) -> None:
    done = scenetruth("estimate", tmp_path)
    assert done.returncode == 2
    assert "recording.zarr: no such store" in done.stderr


@nightly
def test_ctrl_c_during_a_render_leaves_nothing_behind(scene_file: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-u", "-m", "scenetruth", "run", str(scene_file), "-o", str(tmp_path / "cube")]
    # So many frames that a busy machine does not finish them before it is interrupted.
    command += ["--set", "render.supersampling=16", "--set", "frames.count=60"]
    environment = {**os.environ, "FORCE_COLOR": "1"}  # draws the progress as on a terminal
    # The letters read first may end within one of several bytes.
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, errors="replace", env=environment)
    assert process.stderr is not None
    shown = ""
    while "render" not in shown:
        letter = process.stderr.read(1)
        assert letter, shown
        shown += letter
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "error: interrupted; incomplete results were removed" in errors
    assert "Traceback" not in errors
    assert names(tmp_path) == set()


@pytest.mark.parametrize(("arguments", "expected"), [*by_night((["--version"], 0)), (["check", "/proc/none.yaml"], 2)])
def test_objects_are_not_freed_at_the_end(arguments: list[str], expected: int) -> None:
    """Compiling leaves objects that take more than a second to free; threads and exit handlers end as usual."""
    code = (
        "import atexit, threading\n"
        "class Kept:\n    def __del__(self): print('freed')\n"
        "kept = Kept()\n"
        "def last():\n    threading.main_thread().join()\n    print('thread')\n    atexit.register(print, 'handler')\n"
        "from scenetruth.cli import main\n"
        "threading.Thread(target=last).start()\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == expected, done.stderr
    assert done.stdout.split()[-2:] == ["thread", "handler"]
    assert bool(done.stderr) == (expected != 0)


def test_a_full_disk_is_reported(scene_file: Path, tmp_path: Path) -> None:
    # A limit on the size of files is what a process can set for itself without root. Python would cut compiled modules
    # at the limit, too, and all later processes would fail to load them.
    code = (
        "import resource, signal, sys\n"
        "sys.dont_write_bytecode = True\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "sys.argv = ['scenetruth', *sys.argv[1:]]\n"
        "from scenetruth.cli import main\nmain()"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", "")}
    done = subprocess.run(
        [sys.executable, "-c", code, "render", str(scene_file), "-o", str(tmp_path / "x"), *FEW],
        capture_output=True,
        text=True,
        env={key: value for key, value in environment.items() if value},
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "cannot be written" in done.stderr
    assert names(tmp_path) == set()


def test_check_tells_what_lens_and_shutter_do(scene_file: Path) -> None:
    changes = {
        "camera.distortion": "{k1: -0.4}",
        "optics": "{psf: {kind: gaussian, sigma_px: 0.7}, defocus: {aperture_mm: 3, focus_distance_mm: 500}, "
        "vignetting: {coefficients: [-0.2, 0, 0]}}",
        "shutter": "{exposure_time_s: 0.25, readout_time_s: 0.125}",
    }
    overrides = [word for path, value in changes.items() for word in ("--set", f"{path}={value}")]
    done = scenetruth("check", scene_file, *overrides)
    assert done.returncode == 0, done.stderr
    text = " ".join(done.stdout.replace("│", " ").split())
    for words in (
        "px in the lower right corner",
        "gaussian, standard deviation 0.70 px",
        "means of 48 sharp images",
        "20.",
        "open for 0.25 s, last row 0.125 s after the first",
    ):
        assert words in text


def test_check_prints_what_will_be_made() -> None:
    done = scenetruth("check", SCENES / "cube.yaml", env={**os.environ, "COLUMNS": "200"})
    assert done.returncode == 0, done.stderr
    for text in (
        "45 of 640 x 480 px",
        "5016 px",
        "13.8 MB",
        "px per step",
        "texture wavelengths",
        "the scene is valid",
    ):
        assert text in done.stdout


def test_check_warns_and_names_errors(scene_file: Path) -> None:
    fine = scenetruth("check", scene_file, "--set", "objects.0.texture.wavelength_mm=[0.9, 4]")
    assert fine.returncode == 0
    assert "finer than 2 px" in fine.stderr
    behind = scenetruth("check", scene_file, "--set", "objects.0.pose.position_mm=[0, 0, -700]")
    assert behind.returncode == 2
    assert "small.yaml" in behind.stderr
    assert "behind the camera" in behind.stderr


def test_schema_is_a_json_schema_with_descriptions() -> None:
    done = scenetruth("schema")
    schema = json.loads(done.stdout)
    assert set(schema["properties"]) >= {"camera", "stage", "frames", "objects", "sensor", "render", "estimate", "seed"}
    described = [name for name, entry in schema["properties"].items() if "description" in entry]
    assert len(described) == len(schema["properties"])


@pytest.mark.skipif(find_spec("pyrender") is None, reason="needs the extra opengl")
def test_no_gl_at_all_renders_by_ray_casting_and_says_why(scene_file: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": python_path_without_gl(tmp_path)}
    # Both in one process, which would take longer to start a second time than to render.
    code = (
        "import json, sys\n"
        "from tests.helpers.command_line import scenetruth\n"
        "for words in json.loads(sys.argv[1]):\n"
        "    done = scenetruth(*words)\n"
        "    print(json.dumps([done.returncode, done.stderr]))"
    )
    commands = [
        ["render", str(scene_file), "-o", str(tmp_path / folder), *FEW, "--set", f"render.backend={backend}"]
        for folder, backend in (("out", "auto"), ("two", "pyrender"))
    ]
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(commands)],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=Path(__file__).parents[2],
    )
    (rendered, errors), (refused, reasons) = map(json.loads, done.stdout.splitlines())
    assert rendered == 0, errors
    assert "rendered with raycast" in errors
    assert "osmesa" in errors
    assert "rendered by ray casting instead" in errors
    assert refused == 2
    assert "libosmesa6" in reasons
    assert not (tmp_path / "two").exists()


def test_every_command_has_help() -> None:
    for command in app.registered_commands:
        assert command.callback is not None
        assert command.callback.__doc__


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
