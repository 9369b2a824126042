"""Options have the names of the arguments of the Python functions, and the shell completes what there is."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

import scenetruth as st
from scenetruth.cli.app import app
from scenetruth.cli.bundled_files import SCENES, file_completer, method_names
from scenetruth.cli.options import choose_band
from scenetruth.estimators import list_methods

ARGUMENTS = {
    "run": "scene methods overrides truth_views truth_poses truth_content save_radiance save_images limits output "
    "overwrite allow_mismatch figures",
    "render": "scene overrides truth_views truth_poses truth_content save_radiance save_images limits output overwrite",
    "estimate": "run methods settings",
    "score": "run overrides allow_mismatch",
    "strain": "run output method measure window step order weights subset_px since overwrite allow_mismatch",
    "report": "run figures figure_formats allow_mismatch",
    "export": "path format output method row overwrite workers scheduler",
    "verify": "path regenerate seed",
    "compare": "methods suite cases levels seeds limits output workers scheduler fresh",
    "capture init": "folder focal_length_px baseline_mm",
    "capture check": "capture",
    "capture import": "capture output overwrite correct undistort calibration geometry",
    "dataset check": "recipe overrides limits",
    "dataset preview": "recipe overrides samples output overwrite workers scheduler",
    "dataset run": "recipe output overrides partition retries threads scheduler max_tasks_per_worker extend limits "
    "workers",
    "dataset estimate": "dataset method settings retries threads scheduler workers",
    "dataset catalogue": "dataset",
    "dataset card": "dataset version date url overwrite",
    "dataset webdataset": "dataset output maps samples_per_shard",
    "design predict": "scene method model settings overrides limits output overwrite",
    "design budget": "scene method calibration simulated_share overrides region seeds limits output workers scheduler",
    "design sweep": "scenes vary methods overrides sobol_points seeds limits output workers scheduler",
    "design optimise": "specification overrides seeds limits output workers scheduler",
    "design pattern": "scene type size_mm seed reference_images mm_per_px encoding window_sigma_px",
}
"""Arguments of the Python functions: those of the public signatures that a command line can give."""

ALWAYS = {"quiet", "verbose", "help", "json"}
SPELLED = {"set": "overrides", "option": "options", "figure_format": "figure_formats"}
"""Options whose names differ from those of the arguments."""

ONLY_OPTIONS = {
    "run": {"band", "settings", "seed", "report", "figure_formats"},
    "render": {"band", "seed"},
    "estimate": {
        "overwrite",
        "limits",
        "command",
        "command_name",
        "command_images",
        "command_timeout_s",
        "command_memory_mb",
        "command_uses_mask",
        "command_keep",
    },
    "score": {"methods", "region", "overwrite", "limits"},
    "report": {"methods", "overwrite", "limits"},
    "export": {"left", "flow", "options"},
    "compare": {"settings", "commands", "command_timeout_s", "command_memory_mb", "results", "write_recordings"},
    "design predict": {"band", "region"},
    "design budget": {"band", "settings", "focal_length_percent", "principal_point_px", "baseline_percent"},
    "design sweep": {"settings", "region"},
    "design pattern": {
        "output",
        "overwrite",
        "overrides",
        "focal_length_px",
        "distance_mm",
        "light",
        "dot_px",
        "dot_mm",
        "coverage",
        "spacing",
        "wavelength_px",
        "wavelength_mm",
        "contrast",
        "boards",
        "page",
        "margin_mm",
    },
}
"""Options without an argument: of stages of a run directory, of parts of an argument, of `**kwargs`."""


def commands() -> Iterator[tuple[str, Any]]:
    def visit(words: tuple[str, ...], command: Any) -> Iterator[tuple[str, Any]]:
        inner = getattr(command, "commands", None)
        if inner is None:
            yield " ".join(words), command
        for name, each in (inner or {}).items():
            yield from visit((*words, name), each)

    yield from visit((), typer.main.get_command(app))


COMMANDS = dict(commands())


def names(command: Any) -> set[str]:
    """Return the names that arguments of a function have for all parameters of a command."""
    found = set()
    for parameter in command.params:
        name = parameter.name
        if parameter.param_type_name == "option":
            name = max(parameter.opts, key=len).removeprefix("--").replace("-", "_")
            name = SPELLED.get(name, name)
            if name in ALWAYS:
                continue
            if getattr(parameter, "multiple", False) and not name.endswith("s") and name != "vary":
                name += "s"
        found.add(name)
    return found


@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_options_have_the_names_of_arguments(name: str) -> None:
    options, arguments = names(COMMANDS[name]), set(ARGUMENTS[name].split())
    only_options = {
        "command" if one == "commands" and "commands" not in options else one for one in ONLY_OPTIONS.get(name, ())
    }
    assert options - arguments == only_options
    assert not arguments - options


def test_the_commands_are_those_of_the_reference() -> None:
    alone = {name for name in COMMANDS if " " not in name}
    assert alone == {
        *("run", "render", "estimate", "score", "report", "verify", "check", "list", "init", "schema", "precompile"),
        *("doctor", "export", "compare", "strain"),
    }
    groups = {group: {name.split()[1] for name in COMMANDS if name.startswith(f"{group} ")} for group in GROUPS}
    assert groups == GROUPS


GROUPS = {
    "capture": {"init", "check", "calibrate", "import", "run", "simulate", "twin"},
    "dataset": {"check", "preview", "run", "sample", "status", "estimate", "catalogue", "card", "webdataset"},
    "design": {"predict", "budget", "sweep", "optimise", "pattern"},
    "validation": {"paper-figure2", "emva1288", "rendering"},
}
OUTPUT_REQUIRED = {
    *("run", "render", "export", "strain", "compare", "capture import", "capture calibrate", "capture run"),
    *("capture simulate", "capture twin"),
    *("dataset preview", "dataset run", "dataset sample", "dataset webdataset"),
    *("design sweep", "design optimise", "design pattern", *(f"validation {name}" for name in GROUPS["validation"])),
}


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_the_common_options_and_a_short_summary(name: str) -> None:
    command = COMMANDS[name]
    spelled = {text for parameter in command.params for text in (*parameter.opts, *parameter.secondary_opts)}
    assert {"--quiet", "-q", "--verbose", "-v"} <= spelled
    assert len(command.help) < 90
    assert command.help.endswith(".")
    for parameter in command.params:
        assert parameter.help, f"{name} {parameter.name}"
        assert all(text == text.lower() and "_" not in text for text in parameter.opts if text.startswith("-"))
    outputs = [parameter for parameter in command.params if "--output" in parameter.opts]
    assert [parameter.required for parameter in outputs] == (
        [True] if name in OUTPUT_REQUIRED else [False] * len(outputs)
    )


def test_one_option_has_one_help_text() -> None:
    """Options are declared once; where a command needs another meaning, the declaration has another name."""
    texts: dict[str, set[str]] = {}
    for command in COMMANDS.values():
        for parameter in command.params:
            texts.setdefault(max(parameter.opts, key=len), set()).add(parameter.help)
    assert {name for name, several in texts.items() if len(several) > 1 and name.startswith("--")} == {
        *(
            "--output",
            "--method",
            "--seed",
            "--seeds",
            "--command",
            "--distance-mm",
            "--type",
            "--calibration",
            "--focal-length-px",
        ),
    }


def test_a_band_is_chosen_by_its_name_and_else_the_bands_are_listed() -> None:
    scene = st.load_scene("cube", overrides=["camera.bands=[red, nir_850]"])
    assert choose_band(scene, None) is scene
    assert choose_band(scene, "nir_850").camera.bands == ()
    with pytest.raises(st.ArgumentError, match=r"--band: is not one of the bands of the camera \(red, nir_850\)"):
        choose_band(scene, "blue")
    with pytest.raises(st.ArgumentError, match=r"--band: .*\(none: it is grey\)"):
        choose_band(st.load_scene("cube"), "red")


def test_methods_are_those_that_are_installed() -> None:
    assert method_names("") == sorted(entry.name for entry in list_methods())
    assert method_names("opencv_s") == ["opencv_scene_flow", "opencv_stereo"]
    assert method_names("nothing") == []


def test_shipped_names_and_files_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inner").mkdir()
    for name in ("cutter.yaml", "cut.txt", "inner/cup.yml"):
        (tmp_path / name).touch()
    complete = file_completer(SCENES)
    assert complete("cu") == ["cube", "cube_spotlight", "cutter.yaml"]
    assert complete("inner/c") == ["inner/cup.yml"]
    assert complete("no/c") == []
    assert set(complete("")) == {*SCENES.files(), "cutter.yaml"}


def test_the_shell_is_told() -> None:
    # What the script of bash that `--show-completion` prints sets before it asks.
    asked = {"_SCENETRUTH_COMPLETE": "complete_bash", "COMP_WORDS": "scenetruth check seed", "COMP_CWORD": "2"}
    code = "import sys; sys.argv[0] = 'scenetruth'; from scenetruth.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **asked}, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["seedling"], done.stderr
