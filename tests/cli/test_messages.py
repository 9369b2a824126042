"""The amount of messages; and whatever stands in files and names, commands end with a message and an exit code."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import yaml

from tests.helpers.command_line import in_own_process, scenetruth
from tests.helpers.scenes import SCENES, cube

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


RED = "\x1b[31mred\x1b[0m [bold]b[/bold] :smile:"


def scene_file(folder: Path, **changes: Any) -> Path:
    plain = cube().to_dict()
    plain["camera"] |= {"width": 40, "height": 30, "focal_length_px": 313.0}
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(plain | changes))
    return file


def test_descriptions_are_printed_as_they_are_but_for_what_acts(tmp_path: Path) -> None:
    done = scenetruth("check", scene_file(tmp_path, description=RED))
    assert done.returncode == 0, done.stderr
    assert "\\x1b[31mred\\x1b[0m [bold]b[/bold] :smile:" in done.stdout
    assert "\x1b" not in done.stdout + done.stderr


def test_names_that_act_on_a_terminal_are_refused_and_told_harmlessly(tmp_path: Path) -> None:
    item = cube().to_dict()["objects"][0] | {"name": RED}
    done = scenetruth("check", scene_file(tmp_path, objects=[item]))
    assert done.returncode == 2
    assert "objects.0.name: must contain printable characters only" in done.stderr
    assert "\x1b" not in done.stderr


def test_names_with_brackets_are_printed_as_they_are(tmp_path: Path) -> None:
    item = cube().to_dict()["objects"][0] | {"name": "[red]cube[/red] [/nonsense]"}
    done = scenetruth("check", scene_file(tmp_path, objects=[item]))
    assert done.returncode == 0, done.stderr
    assert "object '[red]cube[/red] [/nonsense]'" in done.stdout


@pytest.mark.parametrize("command", ["check", "run", "render"])
def test_file_names_are_printed_harmlessly(tmp_path: Path, command: str) -> None:
    output = [] if command == "check" else ["-o", str(tmp_path / "out")]
    done = scenetruth(command, tmp_path / f"{RED}\n.yaml", *output)
    assert done.returncode == 2
    assert "\x1b" not in done.stderr
    assert "\\x1b[31mred\\x1b[0m [bold]b[/bold] :smile:\\n.yaml" in done.stderr
    assert "no such file; specify the path of a scene file" in done.stderr


@pytest.mark.parametrize("command", ["estimate", "score", "report"])
@pytest.mark.parametrize("folder", ["", "nothing", "/dev/null", "x" * 300, "a\x1bb"])
def test_folders_without_a_run(command: str, folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = scenetruth(command, folder)
    assert done.returncode == 2
    assert done.stderr.strip().startswith("error: ")
    assert "\x1b" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("output", ["", ".", "..", "/", "a/.."])
def test_outputs_without_a_name(output: str) -> None:
    done = scenetruth("run", SCENES / "cube.yaml", "-o", output, "--overwrite")
    assert done.returncode == 2
    assert "must name a directory to create" in " ".join(done.stderr.split())


COMMANDS_WITH_OUTPUT = (
    "run cube",
    "render cube",
    "dataset run cubes",
    "dataset preview cubes",
    "compare structure_tensor",
    "design sweep cube",
    "design budget cube",
    "capture import nothing",
)


@pytest.mark.parametrize("command", COMMANDS_WITH_OUTPUT)
@pytest.mark.parametrize(
    ("output", "problem"),
    [
        ("/proc/x/y", "cannot be written: no directory can be created in /proc (No such file or directory)"),
        ("file/x", "cannot be created, because {0}/file is not a directory"),
    ],
)
def test_outputs_that_cannot_be_created(
    command: str, output: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    # Neither are files read nor results looked for.
    done = scenetruth(*command.split(), "-o", output)
    assert done.returncode == 2
    assert done.stderr == f"error: {output}: {problem.format(tmp_path)}; specify another output\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe\x00", b"[" * 10**5, b"a: &a [*a]", b"seed: 2020-13-45", b"\0", b"!x y"]
)
@pytest.mark.parametrize("command", ["check", "run", "render"])
def test_files_that_are_no_scene_end_with_a_message(tmp_path: Path, command: str, content: bytes) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(content)
    done = scenetruth(command, file, *([] if command == "check" else ["-o", str(tmp_path / "out")]))
    assert done.returncode == 2
    assert done.stderr.startswith("error: 1 problem with the scene in ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (MemoryError("Unable to allocate 9 TiB"), r"error: not enough memory \(Unable to allocate 9 TiB\)"),
        (RecursionError("maximum recursion depth"), "error: an input is nested too deeply"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"), "error: a text is not valid UTF-8"),
        (PermissionError(13, "Permission denied", "a\x1bb"), r"error: a\\x1bb: Permission denied"),
    ],
)
def test_what_machines_refuse_is_told(error: Exception, message: str, tmp_path: Path) -> None:
    with mock.patch("scenetruth.resources.quick_preview.make_quick_preview", side_effect=error):
        done = scenetruth("check", SCENES / "plaid.yaml")
    assert done.returncode == 2
    assert re.search(message, done.stderr)


def test_what_nobody_foresaw_keeps_its_traceback() -> None:
    with (
        mock.patch("scenetruth.resources.quick_preview.make_quick_preview", side_effect=ZeroDivisionError("a fault")),
        pytest.raises(ZeroDivisionError),
    ):
        scenetruth("check", SCENES / "plaid.yaml")


def test_a_terminal_without_the_characters_shows_their_numbers(tmp_path: Path) -> None:
    file = scene_file(tmp_path, description="µm und Küsters")
    done = in_own_process("check", file, env={**os.environ, "PYTHONIOENCODING": "ascii", "LANG": "C"})
    assert done.returncode == 0, done.stderr
    assert "\\xb5m und K\\xfcsters" in done.stdout


def test_a_reader_that_goes_away_is_no_error() -> None:
    command = f"{sys.executable} -m scenetruth schema | head -c 10"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=100, check=False)
    assert done.stdout.startswith("{")
    assert done.stderr == ""


def test_methods_with_quotes_in_their_names() -> None:
    done = scenetruth("run", SCENES / "cube.yaml", "-o", "outputs/never", "--method", "a'b\x1b")
    assert done.returncode == 2
    assert "no such method" in done.stderr
    assert "\x1b" not in done.stderr
