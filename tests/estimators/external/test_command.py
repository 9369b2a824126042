"""Commands as methods: same results as functions, no sight of the truth, bounds that are kept, messages that help."""

from __future__ import annotations

import json
import pickle
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.estimators import Needs, prepare
from scenetruth.estimators.external import CommandMethod, read_results, write_recording
from tests.helpers import external_program
from tests.helpers.external_scripts import command, is_gone, wait_for
from tests.helpers.nightly import nightly

Make = Callable[..., xr.Dataset]

FAMILY = """
    def start(**options):
        code = "import time; time.sleep(60)"
        return subprocess.Popen([sys.executable, "-I", "-S", "-c", code], **options).pid

    # In our group, and in a session of its own.
    pids = [os.getpid(), start(), start(start_new_session=True)]
    with open(sys.argv[3] + ".part", "w") as file:
        file.write(" ".join(map(str, pids)))
    os.rename(sys.argv[3] + ".part", sys.argv[3])
    time.sleep(60)
"""
"""A program with two children of which one leaves its group; their ids are in the file of its third argument."""


@pytest.fixture
def recording(recording_of: Make) -> xr.Dataset:
    return recording_of(np.uint8, 0, 255)


@pytest.fixture(autouse=True)
def scratch(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder in which temporary folders are made."""
    folder = tmp_path_factory.mktemp("scratch")
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_a_program_gives_what_the_same_code_gives_as_a_function(simulated: xr.Dataset, scratch: Path) -> None:
    words = [sys.executable, str(Path(external_program.__file__)), "{recording}", "{output}"]
    method = CommandMethod(shlex.join(words), "matcher", gives=["disparity"])
    told = []
    found = st.estimate(simulated, method, progress=lambda *line: told.append(line))

    def matcher(recording: xr.Dataset) -> dict[str, Any]:
        images = recording["image"].values.astype(np.float64)
        return {
            "disparity": [
                external_program.matched(left, right) for left, right in zip(images[1], images[2], strict=True)
            ]
        }

    expected = st.estimate(simulated, matcher)
    assert np.isfinite(expected["disparity"].values).mean() > 0.5
    for name in expected.data_vars:
        np.testing.assert_array_equal(found[name].values, expected[name].values)
    assert found.attrs["method"] == "matcher"
    assert found.attrs["recording_hash"] == simulated.attrs["recording_hash"]
    assert json.loads(found.attrs["settings"])["command"] == shlex.join(words)
    assert found.attrs["run_time_s"] > 0
    # An interpreter with NumPy has some tens of MB.
    assert 5 < found.attrs["peak_memory_mb"] < 2000
    assert {line[0] for line in told} == {"images", "command"}
    assert list(scratch.iterdir()) == []


def test_a_relative_name_counts_from_where_the_method_was_made(
    recording: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command(tmp_path, CONSTANT)
    monkeypatch.chdir(tmp_path)
    method = CommandMethod(f"{sys.executable} -I mine.py {{recording}} {{output}}", "mine")
    monkeypatch.chdir("/")
    assert float(st.estimate(recording, method)["depth"].values[0, 0, 0]) == 100


def test_workers_make_their_own(recording: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command(tmp_path, CONSTANT)
    monkeypatch.chdir(tmp_path)
    line = f"{sys.executable} -I mine.py {{recording}} {{output}}"
    method = CommandMethod(
        line, "mine", images="npy", timeout_s=50, memory_mb=900, gives=["depth"], needs=Needs(cameras=2)
    )
    monkeypatch.chdir("/")
    again = pickle.loads(pickle.dumps(method))
    assert (again.name, again.gives, again.needs) == ("mine", {"depth"}, Needs(cameras=2))
    assert again.settings().model_dump() == method.settings().model_dump()
    assert float(st.estimate(recording, again)["depth"].values[0, 0, 0]) == 100


CONSTANT = """
    import json, struct
    camera = json.load(open(recording + "/camera.json"))
    width, height = camera["width_px"], camera["height_px"]
    with open(output + "/depth.pfm", "wb") as file:
        file.write(b"Pf\\n%d %d\\n-1.0\\n" % (width, height) + struct.pack("<f", 100.0) * (width * height))
"""


def test_the_program_sees_no_truth_and_no_scene(
    simulated: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever it is handed is listed: its folders, its arguments, its environment, where it runs."""
    monkeypatch.setenv("SCENETRUTH_CACHE", str(tmp_path / "run"))
    monkeypatch.setenv("PWD", str(tmp_path / "run"))
    look = """
    import json
    files = [os.path.join(path, name) for path, _, names in os.walk(os.path.dirname(recording)) for name in names]
    parts = [os.path.relpath(name, os.path.dirname(recording)) for name in files]
    told = {"files": parts, "folder": os.getcwd(), "empty": os.listdir("."), "environment": dict(os.environ)}
    told["text"] = open(recording + "/camera.json").read()
    told["output"] = os.listdir(output)
    json.dump(told, open(sys.argv[3], "w"))
    """
    method = CommandMethod(command(tmp_path, look + CONSTANT, tmp_path / "seen.json"), "looks")
    st.estimate(simulated, method)
    seen = json.loads((tmp_path / "seen.json").read_text())
    images = {f"recording/s{s:+d}_t{t:+d}.png" for s in (-1, 0, 1) for t in (-1, 0, 1)}
    assert set(seen["files"]) == {*images, "recording/camera.json", "log.txt"}
    assert (seen["output"], seen["empty"]) == ([], [])
    assert seen["environment"]["PWD"] == seen["folder"]
    assert [name for name in seen["environment"] if name.startswith("SCENETRUTH_")] == ["SCENETRUTH_PROGRAM"]
    assert str(tmp_path / "run") not in seen["environment"].values()
    for name in ("scene_hash", "recording_hash"):
        assert simulated.attrs[name] not in json.dumps(seen)
    assert "tile" not in seen["text"]


def test_images_come_in_the_form_that_was_asked_for(recording: xr.Dataset, tmp_path: Path) -> None:
    method = CommandMethod(command(tmp_path, CONSTANT), "mine", images="npy", keep_in=tmp_path / "kept")
    st.estimate(recording, method)
    st.estimate(recording, method, images="tiff")
    kept = {path.name for path in (tmp_path / "kept").glob("*/recording/*")}
    assert {"images.npy", "camera.json", "s+0_t+0.tiff"} <= kept
    assert "s+0_t+0.png" not in kept


@nightly
@pytest.mark.parametrize("escape", [False, True])
def test_time_that_is_up_ends_all_processes(escape: bool, recording: xr.Dataset, tmp_path: Path) -> None:
    code = FAMILY if not escape else FAMILY.replace("time.sleep(60)\n", "time.sleep(0.3); os._exit(0)\n")
    method = CommandMethod(command(tmp_path, code, tmp_path / "pids"), "slow", timeout_s=30 if escape else 3)
    message = "contains no results" if escape else r"exceeded timeout_s = 3 s"
    with pytest.raises(st.EstimateError, match=message):
        st.estimate(recording, method)
    pids = wait_for(tmp_path / "pids", 3, 0)
    assert len(pids) == 3
    assert all(map(is_gone, pids))


def test_an_interruption_leaves_no_process_and_no_file(recording: xr.Dataset, tmp_path: Path, scratch: Path) -> None:
    method = CommandMethod(command(tmp_path, FAMILY, tmp_path / "pids"), "slow")
    told = []

    def stop(what: str, done: int, total: int) -> None:
        told.append((what, total))
        if what == "command" and len(wait_for(tmp_path / "pids", 3)) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        st.estimate(recording, method, progress=stop)
    assert all(map(is_gone, wait_for(tmp_path / "pids", 3)))
    assert list(scratch.iterdir()) == []
    assert ("command", 600) in told


HUNGRY = """
    code = "import time; data = b'x' * 300_000_000; time.sleep(20)"
    subprocess.run([sys.executable, "-I", "-S", "-c", code])
"""


def test_memory_of_children_is_bounded(recording: xr.Dataset, tmp_path: Path) -> None:
    method = CommandMethod(command(tmp_path, HUNGRY), "hungry", memory_mb=150, timeout_s=15)
    with pytest.raises(st.EstimateError, match=r"used \d+ MB of memory, more than memory_mb = 150"):
        st.estimate(recording, method)


def test_memory_is_measured_as_it_is_used(recording: xr.Dataset, tmp_path: Path) -> None:
    """Address space that is only reserved does not count, as it would by the system's own limits."""
    use = """
    import mmap
    reserved = mmap.mmap(-1, 4_000_000_000, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    data = b"x" * 100_000_000
    time.sleep(0.6)
    """
    method = CommandMethod(command(tmp_path, use + CONSTANT), "mine", memory_mb=300)
    found = st.estimate(recording, method)
    # 100 MB and the interpreter.
    assert 100 <= found.attrs["peak_memory_mb"] < 200
    # It slept for so long; a busy machine may take longer, but not by much.
    assert 0.6 < found.attrs["run_time_s"] < 30


def test_a_failure_tells_how_to_repeat_it(recording: xr.Dataset, tmp_path: Path, scratch: Path) -> None:
    fail = "print('first line', flush=True); sys.stderr.write('cannot go on: no such lens'); sys.exit(3)"
    method = CommandMethod(command(tmp_path, fail), "mine")
    with pytest.raises(st.EstimateError) as caught:
        st.estimate(recording, method)
    told = {problem.path: problem.message for problem in caught.value.problems}
    assert told["command"] == "ended with exit code 3"
    assert "cannot go on: no such lens" in told["log"]
    log = Path(told["log"].partition(",")[0])
    assert log.read_text().splitlines()[-1] == "cannot go on: no such lens"
    again = subprocess.run(["bash", "-c", told["to repeat"]], capture_output=True, check=False)
    assert (again.returncode, again.stdout) == (3, b"first line\n")
    # Of the next failure, only the log stays.
    with pytest.raises(st.EstimateError, match="set keep_in"):
        st.estimate(recording, method)
    assert sorted(path.name for folder in scratch.iterdir() for path in folder.iterdir()) == [
        *("log.txt", "log.txt"),
        *("output", "recording", "work"),
    ]


def test_a_folder_to_keep_runs_in_keeps_them_all(recording: xr.Dataset, tmp_path: Path) -> None:
    code = "sys.exit(0 if os.path.exists(sys.argv[3]) else 1)\n"
    method = CommandMethod(command(tmp_path, code, tmp_path / "flag"), "mine", keep_in=tmp_path / "kept")
    for _ in range(2):
        with pytest.raises(st.EstimateError, match="exit code 1"):
            st.estimate(recording, method)
    (tmp_path / "flag").write_text("")
    with pytest.raises(st.EstimateError, match="contains no results"):
        st.estimate(recording, method)
    kept = sorted((tmp_path / "kept").iterdir())
    assert len(kept) == 3
    assert all((folder / "recording" / "camera.json").exists() for folder in kept)


def test_wrong_results_are_all_told_with_the_log(recording: xr.Dataset, tmp_path: Path) -> None:
    wrong = (
        CONSTANT.replace("/depth.pfm", "/depht.pfm")
        + """
    print("all is well")
    with open(output + "/velocity.pfm", "wb") as file:
        file.write(b"PF\\n%d %d\\n-1.0\\n" % (height, width) + struct.pack("<f", 1.0) * (3 * width * height))
    """
    )
    with pytest.raises(st.EstimateError) as caught:
        st.estimate(recording, CommandMethod(command(tmp_path, wrong), "mine"))
    told = str(caught.value)
    for part in ("depht.pfm", "did you mean 'depth'", "velocity.pfm", "transposed to", "all is well", "to repeat"):
        assert part in told, part


def test_a_signal_is_named(recording: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(st.EstimateError, match="was terminated by signal SIGSEGV"):
        st.estimate(recording, CommandMethod(command(tmp_path, "os.kill(os.getpid(), 11)"), "mine"))


def test_what_was_promised_must_be_there(recording: xr.Dataset, tmp_path: Path) -> None:
    method = CommandMethod(command(tmp_path, CONSTANT), "mine", gives=["depth", "flow"])
    with pytest.raises(st.EstimateError, match="flow: is declared by the method, but missing"):
        st.estimate(recording, method)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"command": "mine {recording}"}, r"command: {output} is missing"),
        ({"command": "mine"}, r"{recording} is missing; {output} is missing"),
        ({"command": "mine {recording} {outputs}"}, r"{outputs} is unknown, did you mean {output}"),
        ({"command": "mine {recording} {output} {}"}, r"{} is unknown"),
        ({"command": "mine '{recording} {output}"}, "cannot be split into words"),
        ({"command": 3}, "command: "),
        ({"name": "My-Program"}, "must be lower-case letters"),
        ({"name": "structure_tensor"}, "is that of an installed method"),
        ({"images": "jpeg"}, "images: "),
        ({"timeout_s": 0}, "timeout_s: "),
        ({"memory_mb": -5}, "memory_mb: "),
        ({"gives": ["depth", "colour"]}, "gives: must be a subset of"),
        ({"needs": Needs(grid=True)}, "one row of cameras"),
    ],
)
def test_impossible_commands_are_refused_before_any_work(changes: dict[str, Any], message: str) -> None:
    given = {"command": "mine {recording} {output}", "name": "mine", **changes}
    with pytest.raises(st.EstimateError, match=message):
        CommandMethod(given.pop("command"), given.pop("name"), **given)


def test_settings_of_a_call_are_checked_as_well(recording: xr.Dataset) -> None:
    method = CommandMethod(f"{sys.executable} {{recording}} {{output}}", "mine", timeout_s=5)
    assert method.settings().model_dump()["timeout_s"] == 5
    with pytest.raises(st.EstimateError, match=r"{output} is missing"):
        prepare(recording, method, command="mine {recording}")
    with pytest.raises(st.EstimateError, match="timeout_s: "):
        prepare(recording, method, timeout_s=-1)
    with pytest.raises(st.EstimateError, match="no such program"):
        prepare(recording, CommandMethod("no-such-program {recording} {output}", "mine"))


def test_no_shell_reads_the_command(recording: xr.Dataset, tmp_path: Path) -> None:
    code = "open(sys.argv[3], 'w').write(repr(sys.argv[4:]))"
    line = command(tmp_path, code, tmp_path / "words") + " '$HOME' '; touch x' '{{literal}}' *"
    with pytest.raises(st.EstimateError, match="contains no results"):
        st.estimate(recording, CommandMethod(line, "mine"))
    assert (tmp_path / "words").read_text() == repr(["$HOME", "; touch x", "{literal}", "*"])


def test_masks_reach_the_program(recording_of: Make, tmp_path: Path) -> None:
    mask = np.zeros((36, 48), dtype=bool)
    mask[4, 5] = True
    recording = recording_of(np.uint8, 0, 255, exclusion_mask=mask)
    words = command(tmp_path, CONSTANT)
    with pytest.raises(st.EstimateError, match="mask: is not supported by 'mine'"):
        st.estimate(recording, CommandMethod(words, "mine"))
    method = CommandMethod(words, "mine", keep_in=tmp_path / "kept", needs=Needs(exclusion_mask=True))
    st.estimate(recording, method)
    (camera,) = (tmp_path / "kept").glob("*/recording/camera.json")
    assert len(json.loads(camera.read_text())["exclusion_masks"]) == 9
    assert read_results(camera.parents[1] / "output", recording)["depth"].sizes["t"] == 1


DOCS = Path(__file__).parents[3] / "docs" / "how_to" / "external_programs.md"


def test_the_program_of_the_docs_finds_the_shift(tmp_path: Path) -> None:
    code = DOCS.read_text().partition("## A complete program")[2].partition("```python\n")[2].partition("```")[0]
    (tmp_path / "mine.py").write_text(code)
    base = np.random.default_rng(2).integers(0, 256, (20, 60)).astype(np.uint8)
    # x_s = x_0 - 4 s
    images = np.array([[base[:, 10 + 4 * s : 50 + 4 * s]] * 2 for s in (-1, 0, 1)])
    recording = st.make_recording(images, focal_length_px=80.0, baseline_mm=5.0)
    words = [sys.executable, str(tmp_path / "mine.py"), "{recording}", "{output}"]
    found = st.estimate(recording, CommandMethod(shlex.join(words), "mine"))
    assert np.array_equal(found["disparity"].values, np.full((2, 20, 40), 4.0))
    assert np.array_equal(found["depth"].values, np.full((2, 20, 40), 100.0))


def test_the_docs_name_every_key_of_the_camera(recording: xr.Dataset, tmp_path: Path) -> None:
    write_recording(recording, tmp_path / "in")
    camera = json.loads((tmp_path / "in" / "camera.json").read_text())
    told = DOCS.read_text().partition("struct camera")[2].partition("```")[0]
    for key in [*camera, *camera["part"]]:
        assert re.search(rf"\b{key}\b", told), key
